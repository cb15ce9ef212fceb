"""Skip marks for tests that need an optional package. The package is not imported to find out."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

rerun = pytest.mark.skipif(find_spec("rerun") is None, reason="rerun is not installed")
