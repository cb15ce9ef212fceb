"""A TAP device as the air, and the Wi-Fi radio on it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import WifiTransport
from tests.integration.wifi.parts import OWN, Tap


@pytest.fixture
def tap() -> Iterator[Tap]:
    tap = Tap()
    tap.set_up(True)
    yield tap
    tap.close()


@pytest.fixture
def radio(tap: Tap) -> Iterator[WifiTransport]:
    transport = WifiTransport(WifiRadio(inject=tap.name, monitor=tap.name), OWN)
    yield transport
    transport.close()
