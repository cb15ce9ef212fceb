"""Alias: importing `dmuca.channel` gives the module `sitl_mocks.channel`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sitl_mocks.channel import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("sitl_mocks.channel")
