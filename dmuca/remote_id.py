"""Alias: importing `dmuca.remote_id` gives the module `companion.remote_id`."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from companion.remote_id import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("companion.remote_id")
