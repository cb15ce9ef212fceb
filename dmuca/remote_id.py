"""`dmuca.remote_id` is `companion.remote_id`, also where it is imported by that name."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from companion.remote_id import *  # noqa: F403
else:
    sys.modules[__name__] = importlib.import_module("companion.remote_id")
