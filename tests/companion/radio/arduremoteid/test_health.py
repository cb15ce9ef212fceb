"""What the ArduRemoteID radio tells of a module that is not well."""

from __future__ import annotations

import pytest

from companion.remote_id.messages import (
    BasicId,
    Location,
    SelfId,
    System,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from tests.companion.radio.arduremoteid.bench import OURS, Bench, kinds


def test_the_modules_own_reason_is_told() -> None:
    bench = Bench()
    for _ in range(160):
        bench.wait(0.05)
        bench.radio.broadcast(BLE4, (OURS, Location(timestamp_s=5.0), System()), bench.wire.now_s)
    health = bench.health()
    assert not health.ok
    assert health.confirmed == frozenset()
    assert health.can_send == {BLE4, BLE5}
    assert "module refuses: LOC OP_LOC (Location, operator position)" in health.text


def test_without_utc_the_system_is_missing_on_the_air_and_that_is_told() -> None:
    bench = Bench()
    bench.fly(8.0, BLE5, dated=False)
    assert kinds(bench, BLE5) == {BasicId, Location}
    assert not bench.health().ok
    assert "does not send System messages while the time is unknown" in bench.health().text
    bench.fly(3.0, BLE5)
    assert bench.health().ok
    assert System in kinds(bench, BLE5)


def test_a_module_told_to_agree_to_everything_confirms_nothing() -> None:
    bench = Bench(params={"OPTIONS": 1.0})
    bench.fly(8.0, BLE5)
    assert bench.health().confirmed is None
    assert any("OPTIONS 1" in text for text in bench.health().missing)


def test_data_that_stops_is_refused_by_the_module() -> None:
    bench = Bench()
    bench.fly(8.0, BLE5)
    bench.wait(5.0)
    assert bench.health().confirmed == frozenset()
    assert "module refuses: LOC SYS" in bench.health().text


def test_a_module_that_falls_silent_cannot_send() -> None:
    bench = Bench()
    bench.fly(8.0, BLE5)
    bench.wire.cut = True
    bench.fly(2.0, BLE5)
    assert bench.health().can_send == {BLE4, BLE5}
    bench.fly(3.0, BLE5)
    health = bench.health()
    assert not health.ok
    assert health.can_send == health.confirmed == frozenset()
    assert "module silent for" in health.text
    bench.wire.cut = False
    bench.fly(3.0, BLE5)
    assert bench.health().ok
    assert bench.health().confirmed == {BLE4, BLE5}


@pytest.mark.parametrize("boot_s", [0.5, 4.0])
@pytest.mark.parametrize("noise", [False, True])
def test_a_restart_in_flight_is_recognised_and_the_module_fed_again(boot_s: float, noise: bool) -> None:
    bench = Bench(boot_s=boot_s, noise=noise)
    bench.fly(8.0, BLE5, more=(SelfId(description_type=0, text="survey"),))
    asked = bench.module.received["PARAM_REQUEST_READ"]
    bench.module.flash["BT4_RATE"] = 3.0  # changed by somebody, seen only after a restart
    bench.module.reboot(bench.wire.now_s)
    bench.fly(boot_s - 0.1, BLE5)
    assert bench.health().ok == (boot_s < 3.0)  # silent for too long, or not yet
    bench.fly(4.0, BLE5)
    assert bench.radio._module.restarts == 1
    health = bench.health()
    assert (health.ok, health.confirmed) == (True, {BLE4, BLE5}), health.text
    assert SelfId(description_type=0, text="survey") in bench.air()[BLE5].messages
    assert bench.module.received["PARAM_REQUEST_READ"] > asked
    assert bench.module.param_sets == []


def test_a_restart_without_its_banner_shows_in_the_sequence_numbers() -> None:
    bench = Bench()
    bench.fly(60.0, BLE5)  # far from 0
    before = bench.radio._module.restarts
    bench.module.reboot(bench.wire.now_s)
    bench.wire.cut = True
    bench.fly(1.2, BLE5)
    bench.wire.cut = False
    bench.fly(4.0, BLE5)
    assert bench.radio._module.restarts == before + 1


def test_a_restart_that_continues_the_sequence_numbers_shows_in_its_banner() -> None:
    bench = Bench(noise=True)
    bench.module._writer.encoder.seq = 242  # ends near 255, so that 0 comes next
    bench.fly(1.5, BLE5)
    before = bench.radio._module.restarts
    bench.module.reboot(bench.wire.now_s)
    bench.fly(4.0, BLE5)
    assert bench.radio._module.restarts == before + 1


def test_after_a_silence_the_parameters_are_read_again() -> None:
    bench = Bench()
    bench.wait(1.0)
    bench.wire.cut = True
    bench.wait(4.0)
    bench.module.flash["BT4_RATE"] = bench.module._params["BT4_RATE"] = 0.0
    bench.wire.cut = False
    bench.wait(3.0)
    assert bench.health().can_send == {BLE5}
    assert bench.radio._module.restarts == 0


def test_a_transport_that_a_restart_lost_is_told() -> None:
    bench = Bench()
    bench.radio.configure({WIFI_BEACON: 2, BLE5: 1})
    bench.fly(6.0, WIFI_BEACON, BLE5)
    bench.module.flash["WIFI_BCN_RATE"] = 0.0
    bench.module.reboot(bench.wire.now_s)
    bench.fly(6.0, WIFI_BEACON, BLE5)
    health = bench.health()
    assert not health.ok
    words = (
        "no longer on the air: wifi (WIFI_BCN_RATE 0); "
        "restart the companion, on the ground, to switch it on again"
    )
    assert words in health.text
    assert health.can_send == health.confirmed == {BLE4, BLE5}
    assert len(bench.module.param_sets) == 1


def test_one_that_a_locked_module_lost_is_not_promised_to_come_back() -> None:
    bench = Bench()
    bench.radio.configure({WIFI_BEACON: 2})
    bench.fly(6.0, WIFI_BEACON)
    bench.module.flash.update(WIFI_BCN_RATE=0.0, LOCK_LEVEL=1.0)
    bench.module.reboot(bench.wire.now_s)
    bench.fly(6.0, WIFI_BEACON)
    assert "(WIFI_BCN_RATE 0); the module is locked, so it cannot be switched on again" in bench.health().text


@pytest.mark.parametrize(("wifi", "channel"), [(0.0, None), (1.0, 11)])
def test_wifi_channel(wifi: float, channel: int | None) -> None:
    bench = Bench(params={"WIFI_BCN_RATE": wifi, "WIFI_CHANNEL": 11.0, "LOCK_LEVEL": 1.0})
    assert bench.radio.wifi_channel == channel
    assert bench.radio.hears == bench.radio.own_addresses == frozenset()
