"""Helpers shared by the tests of authority."""

from __future__ import annotations

import pytest

from companion.events import Firmware
from tests.companion.gate.flying import (
    ARDUPILOT,
    Flying,
    config,
)

BOTH = pytest.mark.parametrize("firmware", Firmware)
USES = pytest.mark.parametrize("use", ["guard", "fly"])


def flying(use="fly", firmware=ARDUPILOT, **flight):
    return Flying(config(use, **flight), firmware).taken()
