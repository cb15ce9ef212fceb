"""The ArduRemoteID backend against the stand-in module, in virtual time, with each of its traps set."""

from __future__ import annotations

import contextlib
from collections import Counter
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.radio.arduremoteid.module_messages import Module
from companion.radio.arduremoteid.module_radio import RATES, ArduRemoteIdTransport
from companion.radio.radio import Health
from companion.remote_id.messages import (
    Authentication,
    BasicId,
    IdType,
    Location,
    Message,
    OperatorId,
    SelfId,
    Status,
    System,
    UaType,
)
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from sitl_mocks.remote_id_module.module import ModuleOptions, RemoteIdModule

STORED = {"UAS_TYPE": 2.0, "UAS_ID_TYPE": 1.0}
OURS = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="ABCD123456789")
UTC_S = 1_767_225_600.0


class Wire:
    """A link and a clock of its own: waiting lets the module live."""

    def __init__(self, options: ModuleOptions | None) -> None:
        self.now_s = 0.0
        self.module = None if options is None else RemoteIdModule(options)
        self.extra = b""
        self.closed = False
        self.cut = False

    def clock(self) -> float:
        return self.now_s

    def wait(self, timeout_s: float) -> None:
        self.now_s += timeout_s

    def receive(self, now_s: float) -> bytes:
        data, self.extra = self.extra, b""
        if self.module is not None:
            self.module.advance(now_s)
            answer = self.module.drain()
            data += b"" if self.cut else answer
        return data

    def send(self, data: bytes) -> None:
        if self.module is not None and not self.cut:
            self.module.receive(data, self.now_s)

    def close(self) -> None:
        self.closed = True


class Bench:
    """The backend, opened."""

    def __init__(self, **options: Any) -> None:
        params = {**STORED, **options.pop("params", {})}
        self.wire = Wire(ModuleOptions(params=params, **options))
        self.radio = ArduRemoteIdTransport(self.wire, 7, self.wire.clock, "serial:/dev/ttyACM0:57600")
        self.on_air: set[tuple[str, type[Message]]] = set()

    @property
    def module(self) -> RemoteIdModule:
        assert self.wire.module is not None
        return self.wire.module

    def health(self) -> Health:
        return self.radio.health(self.wire.now_s)

    def air(self) -> dict[str, Any]:
        return {entry.transport: entry for entry in self.module.on_air(self.wire.now_s)}

    def wait(self, seconds: float) -> None:
        """The loop runs; nothing is broadcast."""
        for _ in range(round(seconds / 0.05)):
            self.wire.now_s += 0.05
            assert self.radio.heard(self.wire.now_s) == []

    def fly(
        self, seconds: float, *transports: str, more: tuple[Message, ...] = (), dated: bool = True
    ) -> None:
        """The loop at 20 Hz, and a broadcast a second on each transport."""
        for tick in range(round(seconds / 0.05)):
            self.wait(0.05)
            if tick % 20 == 0:
                for transport in transports:
                    self.radio.broadcast(
                        transport, (*messages(self.wire.now_s, dated), *more), self.wire.now_s
                    )
            self.on_air |= {(t, type(m)) for t, entry in self.air().items() for m in entry.messages}


def messages(now_s: float, dated: bool = True) -> tuple[Message, ...]:
    return (
        OURS,
        Location(
            status=Status.AIRBORNE,
            lat_deg=47.3,
            lon_deg=8.5,
            timestamp_s=round(now_s % 3600, 1) if dated else None,
        ),
        System(
            operator_lat_deg=47.3,
            operator_lon_deg=8.5,
            timestamp_utc_s=UTC_S + int(now_s) if dated else None,
        ),
    )


def kinds(bench: Bench, transport: str) -> set[type[Message]]:
    return {kind for on, kind in bench.on_air if on == transport}


# ---------------------------------------------------------------- the traps


TRAPS: dict[str, dict[str, Any]] = {
    "plain": {},
    "noise": {"noise": True},
    "slow start": {"boot_s": 5.0},
    "lossy": {"lose_every": 3},
    "own system id": {"params": {"MAVLINK_SYSID": 99.0}},
    "locked": {"params": {"LOCK_LEVEL": 1.0}},
    "nothing stored": {"params": {"UAS_TYPE": 0.0, "UAS_ID_TYPE": 0.0}},
    "loud": {"params": {"OPTIONS": 4.0}},
    "shy": {"params": {"BCAST_POWERUP": 0.0}},
    "old": {"without": frozenset(("OPTIONS", "MAVLINK_SYSID"))},
    "all": {
        "noise": True,
        "boot_s": 5.0,
        "lose_every": 3,
        "without": frozenset(("MAVLINK_SYSID",)),
        "params": {
            "MAVLINK_SYSID": 99.0, "LOCK_LEVEL": 1.0, "UAS_TYPE": 0.0, "UAS_ID_TYPE": 0.0,
            "OPTIONS": 4.0, "BCAST_POWERUP": 0.0,
        },
    },
}  # fmt: skip


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
        (None, b"", "nothing comes at all: check power, wiring"),
        (None, b"\x12\x83garbage" * 20, "what comes is no MAVLink: check the baud rate"),
        (ModuleOptions(deaf=True), b"", "check the wire from here to its receive pin"),
        (ModuleOptions(boot_s=100.0), b"", "nothing comes at all"),
        (ModuleOptions(deaf=True, params={"MAVLINK_SYSID": 7}), b"", "answers for none of its rates"),
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
    with pytest.raises(ConfigError, match=r"other components \(1\), none from 236"):
        ArduRemoteIdTransport(wire, 7, wire.clock, "x")


def test_a_transport_that_the_firmware_does_not_have() -> None:
    bench = Bench(without=frozenset(("WIFI_BCN_RATE", "LOCK_LEVEL")))
    assert bench.radio.capabilities == {BLE4, BLE5}  # without the lock's word nothing is written
    with pytest.raises(ConfigError, match="cannot send on 'wifi'; it can on: ble4, ble5, nan"):
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
    with pytest.raises(ConfigError, match=f"ble4: {rate} messages a second; the module sends 1 to 5"):
        bench.radio.configure({BLE4: rate})
    assert bench.module.param_sets == []


def test_a_probe_refuses_like_the_real_thing_and_changes_nothing() -> None:
    bench = Bench(params={"BT5_RATE": 0.0, "BT4_RATE": 3.0})
    before = bench.radio.capabilities
    assert bench.radio.configure({BLE4: 2, BLE5: 1, WIFI_BEACON: 2}, probe=True) == (
        "BT4_RATE stays at 3",
        "would set BT5_RATE to 1 (it is 0): it comes on the air when the module is power-cycled",
        "would set WIFI_BCN_RATE to 2 (it is 0)",
    )
    with pytest.raises(ConfigError, match="sends 1 to 5"):
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
        ConfigError, match=r"keeps WIFI_BCN_RATE at 0, wanted 2; it says \"Parameters locked\""
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


# ---------------------------------------------------------------- feeding


def test_each_message_is_fed_once_for_all_transports() -> None:
    bench = Bench()
    bench.radio.configure({BLE4: 1, BLE5: 1, WIFI_BEACON: 1, WIFI_NAN: 1})
    before = Counter(bench.module.received)
    bench.fly(10.0, BLE4, BLE5, WIFI_BEACON, WIFI_NAN)
    fed = bench.module.received - before
    assert {
        name: fed[f"OPEN_DRONE_ID_{name}"] for name in ("BASIC_ID", "LOCATION", "SYSTEM")
    } == dict.fromkeys(("BASIC_ID", "LOCATION", "SYSTEM"), 10)
    # Empty ones of the others, every 5 s from 2 s on.
    assert fed["OPEN_DRONE_ID_SELF_ID"] == fed["OPEN_DRONE_ID_OPERATOR_ID"] == 2
    sent = sum(n for name, n in fed.items() if name.startswith("OPEN_DRONE_ID"))
    assert bench.health().frames_sent == sent
    assert 9 <= fed["HEARTBEAT"] <= 11


def test_what_changed_goes_at_once_and_what_did_not_does_not() -> None:
    bench = Bench()
    first = Location(lat_deg=1.0, lon_deg=2.0, timestamp_s=1.0)
    now = bench.wire.now_s
    for message, ahead_s in ((first, 0.0), (first, 0.05), (Location(timestamp_s=2.0), 0.06), (first, 0.07)):
        bench.radio.broadcast(BLE4, (message,), now + ahead_s)
    assert bench.module.received["OPEN_DRONE_ID_LOCATION"] == 3
    bench.radio.broadcast(BLE4, (first,), now + 0.16)
    assert bench.module.received["OPEN_DRONE_ID_LOCATION"] == 4


def test_a_given_self_id_is_kept_and_never_replaced_by_an_empty_one() -> None:
    bench = Bench()
    bench.fly(2.0, BLE5, more=(SelfId(description_type=0, text="survey"),))
    bench.fly(30.0, BLE5)
    assert SelfId(description_type=0, text="survey") in bench.air()[BLE5].messages
    assert not any(isinstance(m, OperatorId) for m in bench.air()[BLE5].messages)
    assert bench.health().confirmed == {BLE4, BLE5}


def test_authentication_is_not_fed_and_said_to_be_missing() -> None:
    bench = Bench()
    page = Authentication(auth_type=1, page=0, data=b"abc", last_page=0, length=3, timestamp_utc_s=UTC_S)
    bench.fly(3.0, BLE5, more=(page,))
    assert bench.module.received["OPEN_DRONE_ID_AUTHENTICATION"] == 0
    assert any("Authentication is not sent" in text for text in bench.health().missing)


def test_the_full_hour_goes_on_the_air() -> None:
    bench = Bench()
    bench.wire.now_s = 10.0
    for _ in range(30):
        bench.wait(0.1)
        bench.radio.broadcast(BLE5, (Location(lat_deg=1.0, lon_deg=2.0, timestamp_s=0.0),), bench.wire.now_s)
    (location,) = (m for m in bench.air()[BLE5].messages if isinstance(m, Location))
    assert location.timestamp_s == 3600.0


def test_bad_messages_and_transports_are_refused_and_nothing_goes_out() -> None:
    bench = Bench(params={"LOCK_LEVEL": 1.0})
    before = Counter(bench.module.received)
    with pytest.raises(ValueError, match="'wifi'; allowed: ble4, ble5"):
        bench.radio.broadcast(WIFI_BEACON, messages(1.0), bench.wire.now_s)
    with pytest.raises(ValueError, match="speed_mps"):
        bench.radio.broadcast(BLE4, (OURS, Location(speed_mps=1e9)), bench.wire.now_s)
    assert bench.module.received == before
    assert bench.health().frames_sent == 0


def test_what_it_is_left_with_has_no_position() -> None:
    bench = Bench()
    bench.fly(5.0, BLE5)
    bench.radio.close()
    assert bench.wire.closed
    bench.wire.now_s += 5.0
    (location,) = (m for m in bench.air()[BLE5].messages if isinstance(m, Location))
    assert location == Location(status=Status.REMOTE_ID_SYSTEM_FAILURE)


def test_one_that_never_sent_leaves_the_module_alone() -> None:
    bench = Bench()
    bench.wait(5.0)
    bench.radio.close()
    assert not any(name.startswith("OPEN_DRONE_ID") for name in bench.module.received)


# ---------------------------------------------------------------- health


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
    assert "leaves System out while the time is unknown" in bench.health().text
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
        "no longer on: wifi (WIFI_BCN_RATE 0): restart the companion, on the ground, to switch it on again"
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
    assert "(WIFI_BCN_RATE 0): its lock does not let it be switched on again" in bench.health().text


@pytest.mark.parametrize(("wifi", "channel"), [(0.0, None), (1.0, 11)])
def test_wifi_channel(wifi: float, channel: int | None) -> None:
    bench = Bench(params={"WIFI_BCN_RATE": wifi, "WIFI_CHANNEL": 11.0, "LOCK_LEVEL": 1.0})
    assert bench.radio.wifi_channel == channel
    assert bench.radio.hears == bench.radio.own_addresses == frozenset()


# ---------------------------------------------------------------- whatever happens


@pytest.mark.parametrize("name", ["LOCK_LEVEL", "TO_DEFAULTS", "OPTIONS", "WIFI_POWER", "WIFI_CHANNEL"])
def test_nothing_but_rates_can_be_set(name: str) -> None:
    wire = Wire(ModuleOptions())
    module = Module(wire, 7)
    with pytest.raises(ValueError, match="only rates are set"):
        module.set(name, 1.0)
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="above 0"):
            module.set("BT4_RATE", rate)


ACTIONS = st.one_of(
    st.tuples(st.just("broadcast"), st.sampled_from(sorted(RATES)), st.integers(0, 63)),
    st.tuples(st.just("wait"), st.floats(0.05, 4.0)),
    st.tuples(st.just("reboot")),
    st.tuples(st.just("cut")),
    st.tuples(st.just("bytes"), st.binary(max_size=300)),
    st.tuples(st.just("configure"), st.dictionaries(st.sampled_from(sorted(RATES)), st.integers(0, 6))),
)
ALL = (*messages(5.0), SelfId(description_type=0, text="s"), OperatorId(operator_id_type=0, operator_id="o"))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(TRAPS)), st.lists(ACTIONS, max_size=25))
def test_in_any_order_of_things_the_module_is_never_ruined(trap: str, actions: list[tuple[Any, ...]]) -> None:
    bench = Bench(**TRAPS[trap])
    started = False
    for action, *arguments in actions:
        if action == "broadcast":
            transport, mask = arguments
            chosen = tuple(m for bit, m in enumerate(ALL) if mask >> bit & 1)
            try:
                bench.radio.broadcast(transport, chosen, bench.wire.now_s)
                started = True
            except ValueError:
                assert transport not in bench.radio.capabilities
        elif action == "wait":
            bench.wait(arguments[0])
        elif action == "reboot":
            bench.module.reboot(bench.wire.now_s)
        elif action == "cut":
            bench.wire.cut = not bench.wire.cut
        elif action == "bytes":
            bench.wire.extra = arguments[0]
        else:
            writes = len(bench.module.param_sets)
            with contextlib.suppress(ConfigError):
                bench.radio.configure(arguments[0])
            assert not started or len(bench.module.param_sets) == writes
        health = bench.health()
        assert health.can_send <= bench.radio.capabilities
        assert health.confirmed is None or health.confirmed <= health.can_send
    assert bench.module.catastrophes == []
    assert {name for name, _ in bench.module.param_sets} <= set(RATES.values())
    assert all(1.0 <= value <= 5.0 for _, value in bench.module.param_sets)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.tuples(st.sampled_from((0, 1, 22, 253, 12918, 12901)), st.binary(max_size=60)), max_size=12)
)
def test_frames_of_any_content_are_survived_and_kept_small(frames: list[tuple[int, bytes]]) -> None:
    bench = Bench()
    writer = MavlinkWriter(1, 236)
    for message_id, payload in frames:
        bench.wire.extra += writer.pack_payload(message_id, payload or b"\0")
    bench.wait(0.1)
    bench.radio.broadcast(BLE4, messages(1.0), bench.wire.now_s)
    health = bench.health()
    assert health.text.isascii()
    assert health.text.isprintable()
    assert len(health.text) < 500
    module = bench.radio._module
    assert len(module.raw) <= 512
    assert len(module.params) <= 9
