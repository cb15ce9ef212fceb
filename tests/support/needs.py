"""Marks of tests that need an optional package, which no worker loads before such a test runs."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

rerun = pytest.mark.skipif(find_spec("rerun") is None, reason="rerun is not installed")
