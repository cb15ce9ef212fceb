"""Alias: importing `dmuca.avoidance` gives the module `companion.avoidance`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from companion.avoidance import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("companion.avoidance")
