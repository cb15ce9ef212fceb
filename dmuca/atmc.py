"""Alias: importing `dmuca.atmc` gives the module `companion.atmc`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from companion.atmc import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("companion.atmc")
