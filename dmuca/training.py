"""Alias: importing `dmuca.training` gives the module `ground_tools.atmc`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ground_tools.atmc import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("ground_tools.atmc")
