"""The backend and `sitl-mocks module` as processes apart: a real serial line (pseudo terminal), real UDP."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import pytest

from companion.errors import ConfigError
from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.remote_id.messages import BasicId, IdType, Location, Status, System, UaType
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from companion.runtime.radios import open_radio
from tests.integration.conftest import PATIENCE_S

OURS = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.GLIDER, uas_id="1581F5BKD229B00A")


@pytest.mark.parametrize("link", ["serial", "udpin:127.0.0.1:0"])
def test_a_module_is_opened_configured_fed_and_confirms(start: Callable[..., Any], link: str) -> None:
    child = start("sitl_mocks.cli", "module", "--link", link, "--noise", "--boot", "0.5")
    name = child.wait_for(r"link (\S+)\nready").group(1)
    radio = open_radio(ArduRemoteIdRadio(link=name, system_id=7), OURS.uas_id)
    try:
        assert radio.capabilities >= {BLE4, BLE5, WIFI_BEACON}
        radio.configure({BLE5: 1, WIFI_BEACON: 2})
        end_s = time.monotonic() + PATIENCE_S
        while radio.health(time.monotonic()).confirmed != {BLE4, BLE5, WIFI_BEACON}:
            now_s = time.monotonic()
            assert now_s < end_s, radio.health(now_s).text
            assert radio.heard(now_s) == []
            radio.broadcast(BLE5, messages(now_s), now_s)
            radio.broadcast(WIFI_BEACON, messages(now_s), now_s)
            time.sleep(0.05)
        health = radio.health(time.monotonic())
        assert health.ok
        assert "also on the air" in health.text
        # The boot loader's garbage, where it was heard, holds four bytes that begin a frame.
        assert health.bad_frames in (0, 4)
    finally:
        radio.close()
    assert child.end() == 0
    left = json.loads(child.output.splitlines()[-1])
    assert left["param_sets"] == [["WIFI_BCN_RATE", 2.0]]
    assert left["catastrophes"] == []
    assert left["on_air"]["wifi"] == left["on_air"]["ble5"] == ["Location", "System", "BasicId"]


def messages(now_s: float) -> tuple[BasicId | Location | System, ...]:
    utc_s = 1_767_225_600.0 + now_s
    location = Location(
        status=Status.AIRBORNE, lat_deg=47.3, lon_deg=8.5, timestamp_s=round(utc_s % 3600.0, 1)
    )
    system = System(operator_lat_deg=47.3, operator_lon_deg=8.5, timestamp_utc_s=float(int(utc_s)))
    return OURS, location, system


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("serial:/dev/no-such-port:57600", "link: serial:/dev/no-such-port:57600"),
        ("usb:1", "link: 'usb:1': "),
    ],
)
def test_a_port_that_is_not_there_is_named(link: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as error:
        open_radio(ArduRemoteIdRadio(link=link), "x")
    assert "vehicle" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--param", "NOPE=1"], "'NOPE'; allowed: LOCK_LEVEL"),
        (["--param", "BT4_RATE=x"], "'x' is not a number"),
        (["--link", "tcp:127.0.0.1:1"], "allowed: serial, udpin:HOST:PORT"),
    ],
)
def test_wrong_options_are_named(start: Callable[..., Any], arguments: list[str], words: str) -> None:
    child = start("sitl_mocks.cli", "module", *arguments)
    assert child.process.wait(PATIENCE_S) == 2
    assert words in child.output
