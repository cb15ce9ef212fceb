"""The ArduRemoteID radio opens and configures a module, with each of its traps set."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.radio.arduremoteid.module_radio import ArduRemoteIdTransport
from companion.remote_id.messages import (
    BasicId,
    Location,
    System,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from sitl_mocks.remote_id_module.module import ModuleOptions
from tests.companion.radio.arduremoteid.bench import TRAPS, Bench, Wire, kinds

# ---------------------------------------------------------------- the traps


@pytest.mark.parametrize("trap", TRAPS)
def test_it_gets_on_the_air_and_stays_there(trap: str) -> None:
    bench = Bench(**TRAPS[trap])
    assert bench.health().ok
    assert bench.health().can_send == {BLE4, BLE5}
    assert bench.health().confirmed == frozenset()
    bench.radio.configure({BLE4: 1, BLE5: 1})
    bench.fly(40.0, BLE4, BLE5)
    health = bench.health()
    assert (health.ok, health.confirmed) == (True, frozenset((BLE4, BLE5))), health.text
    assert kinds(bench, BLE4) == kinds(bench, BLE5) == {BasicId, Location, System}
    assert bench.module.param_sets == []
    assert bench.module.catastrophes == []
    now = bench.air()[BLE5].messages
    assert [m.uas_id for m in now if isinstance(m, BasicId)] == ["ABCD123456789"]
    assert [m.timestamp_s for m in now if isinstance(m, Location)] == [
        pytest.approx(bench.wire.now_s % 3600, abs=2.2)
    ]


@pytest.mark.parametrize("trap", sorted(set(TRAPS) - {"locked", "all"}))
def test_what_is_off_is_switched_on_once_and_read_back(trap: str) -> None:
    bench = Bench(**TRAPS[trap])
    assert bench.radio.capabilities == {BLE4, BLE5, WIFI_BEACON, WIFI_NAN}
    bench.radio.configure({WIFI_BEACON: 3, WIFI_NAN: 1, BLE5: 1})
    assert sorted(set(bench.module.param_sets)) == [("WIFI_BCN_RATE", 3.0), ("WIFI_NAN_RATE", 1.0)]
    assert len(bench.module.param_sets) == 2 or trap == "lossy"
    assert bench.module.flash["WIFI_BCN_RATE"] == 3.0
    assert bench.module.flash["BT5_RATE"] == 1.0
    bench.fly(10.0, WIFI_BEACON, WIFI_NAN, BLE5)
    health = bench.health()
    assert health.confirmed == {BLE4, BLE5, WIFI_BEACON, WIFI_NAN}, health.text
    assert "also on the air, and cannot be switched off here: ble4 (BT4_RATE 1)" in health.text
    assert kinds(bench, WIFI_BEACON) == kinds(bench, WIFI_NAN) == {BasicId, Location, System}
    # A second start finds all as it should be.
    sets = len(bench.module.param_sets)
    again = ArduRemoteIdTransport(bench.wire, 7, bench.wire.clock, "x")
    again.configure({WIFI_BEACON: 3, WIFI_NAN: 1, BLE5: 1})
    assert len(bench.module.param_sets) == sets


# ---------------------------------------------------------------- opening


@pytest.mark.parametrize(
    ("options", "extra", "words"),
    [
        (None, b"", "no data at all; check power, wiring"),
        (None, b"\x12\x83garbage" * 20, "the data is not MAVLink; check the baud rate"),
        (ModuleOptions(deaf=True), b"", "check the wire from here to its receive pin"),
        (ModuleOptions(boot_s=100.0), b"", "no data at all"),
        (ModuleOptions(deaf=True, params={"MAVLINK_SYSID": 7}), b"", "does not report its rates"),
    ],
)
def test_without_a_module_it_says_what_to_look_at(
    options: ModuleOptions | None, extra: bytes, words: str
) -> None:
    wire = Wire(options)
    wire.extra = extra
    with pytest.raises(ConfigError, match=words) as error:
        ArduRemoteIdTransport(wire, 7, wire.clock, "serial:/dev/ttyACM0:57600")
    assert str(error.value).startswith("serial:/dev/ttyACM0:57600: ")
    assert wire.closed


def test_an_autopilot_is_no_module() -> None:
    wire = Wire(None)
    wire.extra = MavlinkWriter(1, 1).pack(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
    with pytest.raises(ConfigError, match=r"components 1, not from 236"):
        ArduRemoteIdTransport(wire, 7, wire.clock, "x")


def test_a_transport_that_the_firmware_does_not_have() -> None:
    bench = Bench(without=frozenset(("WIFI_BCN_RATE", "LOCK_LEVEL")))
    assert bench.radio.capabilities == {BLE4, BLE5}  # without the lock's word nothing is written
    with pytest.raises(ConfigError, match="cannot send on 'wifi'; allowed: ble4, ble5, nan"):
        bench.radio.configure({WIFI_BEACON: 1})
    with pytest.raises(ConfigError, match="locked"):
        bench.radio.configure({WIFI_NAN: 1})
    assert bench.module.param_sets == []


# ---------------------------------------------------------------- configuring


def test_a_locked_module_is_left_alone_and_named() -> None:
    bench = Bench(params={"LOCK_LEVEL": 1.0, "WIFI_BCN_RATE": 1.0})
    assert bench.radio.capabilities == {BLE4, BLE5, WIFI_BEACON}
    words = (
        r"locked \(LOCK_LEVEL 1\) with WIFI_BCN_RATE = 1, WIFI_NAN_RATE = 0, wanted WIFI_BCN_RATE = 2, "
        r"WIFI_NAN_RATE = 1: choose .*ble4 \(BT4_RATE 1\), ble5 \(BT5_RATE 1\), wifi \(WIFI_BCN_RATE 1\)"
        ".*signed"
    )
    with pytest.raises(ConfigError, match=words):
        bench.radio.configure({WIFI_BEACON: 2, WIFI_NAN: 1})
    assert bench.module.param_sets == []
    bench.radio.configure({WIFI_BEACON: 1})
    assert any("locked" in text and "WIFI_NAN_RATE" in text for text in bench.health().missing)


@pytest.mark.parametrize("rate", [0, -1, 6, 10])
def test_rates_that_the_module_does_not_have(rate: int) -> None:
    bench = Bench()
    with pytest.raises(ConfigError, match=f"ble4: {rate} messages a second; allowed: 1 to 5"):
        bench.radio.configure({BLE4: rate})
    assert bench.module.param_sets == []


def test_a_probe_refuses_like_the_real_thing_and_changes_nothing() -> None:
    bench = Bench(params={"BT5_RATE": 0.0, "BT4_RATE": 3.0})
    before = bench.radio.capabilities
    assert bench.radio.configure({BLE4: 2, BLE5: 1, WIFI_BEACON: 2}, probe=True) == (
        "BT4_RATE stays at 3",
        "would set BT5_RATE to 1 (it is 0); it starts when the module is power-cycled",
        "would set WIFI_BCN_RATE to 2 (it is 0)",
    )
    with pytest.raises(ConfigError, match="allowed: 1 to 5"):
        bench.radio.configure({WIFI_BEACON: 8}, probe=True)
    assert bench.module.param_sets == []
    assert bench.radio.capabilities == before
    assert bench.health().ok
    assert bench.radio.configure({WIFI_BEACON: 2}) == ("set WIFI_BCN_RATE to 2 (was 0)",)
    locked = Bench(params={"LOCK_LEVEL": 1.0})
    with pytest.raises(ConfigError, match="the module is locked"):
        locked.radio.configure({BLE4: 2}, probe=True)


def test_a_module_that_locks_behind_our_back_is_quoted() -> None:
    bench = Bench()
    bench.module._params["LOCK_LEVEL"] = 1.0
    with pytest.raises(
        ConfigError, match=r"keeps WIFI_BCN_RATE at 0, wanted 2; it reports \"Parameters locked\""
    ):
        bench.radio.configure({WIFI_BEACON: 2})


def test_a_lost_answer_does_not_wear_the_flash_again() -> None:
    bench = Bench()
    module, taken = bench.module, bench.module.receive

    def receive(data: bytes, now_s: float) -> None:
        sets = len(module.param_sets)
        taken(data, now_s)
        if len(module.param_sets) > sets:
            module.drain()  # the answer is lost

    module.receive = receive  # type: ignore[method-assign]
    bench.radio.configure({WIFI_BEACON: 2})
    assert module.flash_writes == [("WIFI_BCN_RATE", 2.0)]


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["OPTIONS", "BT4_RATE", "WIFI_CHANNEL", "LOCK_LEVEL"])
def test_parameters_that_are_no_numbers_are_left_out(name: str, value: float) -> None:
    bench = Bench()
    before = dict(bench.radio._module.params)
    bench.wire.extra = MavlinkWriter(7, 236).pack(
        mavlink.MAVLink_param_value_message(name.encode(), value, 9, 19, 0)
    )
    bench.wait(0.05)
    assert bench.radio._module.params == before
    assert bench.health().ok


def test_nothing_is_written_once_it_sends() -> None:
    bench = Bench()
    bench.fly(2.0, BLE4)
    with pytest.raises(ConfigError, match="cannot be changed once the module is sending"):
        bench.radio.configure({WIFI_BEACON: 2})
    bench.radio.configure({BLE4: 1})
    assert bench.module.param_sets == []


def test_bluetooth_switched_on_waits_for_a_power_cycle() -> None:
    bench = Bench(params={"BT4_RATE": 0.0})
    bench.radio.configure({BLE4: 1, BLE5: 2})
    bench.fly(8.0, BLE4, BLE5)
    health = bench.health()
    assert not health.ok
    assert "power-cycle the module: ble4 (BT4_RATE 1) was switched on" in health.text
    assert health.can_send == health.confirmed == {BLE5}
    assert any("BT5_RATE was 1" in text for text in health.missing)
    assert BLE4 not in bench.air()
    bench.module.reboot(bench.wire.now_s)
    bench.fly(8.0, BLE4, BLE5)
    health = bench.health()
    assert (health.ok, health.confirmed) == (True, {BLE4, BLE5}), health.text
    assert not any("BT5_RATE" in text for text in health.missing)
    assert bench.air()[BLE4].interval_s == pytest.approx(1 / 7)
