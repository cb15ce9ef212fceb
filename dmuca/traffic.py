"""Alias: importing `dmuca.traffic` gives the module `companion.traffic`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from companion.traffic import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("companion.traffic")
