"""The simulated ArduRemoteID module behaves as the firmware's sources specify."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.remote_id.frames import parse_frame
from companion.remote_id.messages import BasicId, Location, OperatorId, SelfId, System
from sitl_mocks.remote_id_module.module import ModuleOptions, RemoteIdModule

ANY = bytes(20)
STORED = {"UAS_TYPE": 2, "UAS_ID_TYPE": 1}


class Bench:
    """A client of the module; time passes in steps of 0.05 s."""

    def __init__(self, **options: Any) -> None:
        params = options.pop("params", {})
        self.module = RemoteIdModule(ModuleOptions(params={**STORED, **params}, **options))
        self.now_s = 0.0
        self.said: list[Any] = []
        self.raw = b""
        self._reader = MavlinkReader()
        self._writer = MavlinkWriter(7, 191)

    def run(self, seconds: float) -> list[Any]:
        """Let time pass; returns the messages that the module sent."""
        found: list[Any] = []
        for _ in range(round(seconds / 0.05)):
            self.now_s = round(self.now_s + 0.05, 3)
            self.module.advance(self.now_s)
            found += self.collect()
        return found

    def collect(self) -> list[Any]:
        data = self.module.drain()
        self.raw += data
        messages = self._reader.feed(data)
        self.said += messages
        return messages

    def send(self, *messages: Any) -> list[Any]:
        for message in messages:
            self.module.receive(self._writer.pack(message), self.now_s)
        return self.collect()

    def start(self) -> Bench:
        """Wait until the module has started and uses our system id."""
        self.run(1.1)
        self.send(heartbeat())
        return self

    def param(self, name: str) -> float:
        (answer,) = self.send(mavlink.MAVLink_param_request_read_message(7, 236, name.encode(), -1))
        return float(answer.param_value)

    def set(self, name: str, value: float, kind: int = 9) -> list[Any]:
        return self.send(mavlink.MAVLink_param_set_message(7, 236, name.encode(), value, kind))

    def air(self) -> dict[str, Any]:
        return {entry.transport: entry for entry in self.module.on_air(self.now_s)}

    def feed(self, seconds: float, **fields: Any) -> None:
        """Send all five messages once per second."""
        for _ in range(round(seconds)):
            self.send(*data(self.now_s, **fields))
            self.run(1.0)


def heartbeat(kind: int = 18) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, 8, 0, 0, 4, 3)


def location(now_s: float, **fields: Any) -> Any:
    given = {"latitude": 473000000, "longitude": 85000000, "timestamp": 100.0 + now_s, **fields}
    latitude, longitude, timestamp = (given.pop(n) for n in ("latitude", "longitude", "timestamp"))
    message = mavlink.MAVLink_open_drone_id_location_message(
        0, 0, ANY, 2, 9000, 500, 0, latitude, longitude, 100, 100, 0, 50, 0, 0, 0, 0, timestamp, 0
    )
    for name, value in given.items():
        setattr(message, name, value)
    return message


def system(now_s: float, **fields: Any) -> Any:
    given = {"operator_latitude": 473000000, "operator_longitude": 85000000, "timestamp": 240_000_000}
    given = {**given, "timestamp": given["timestamp"] + int(now_s), **fields}
    return mavlink.MAVLink_open_drone_id_system_message(
        0, 0, ANY, 0, 0, given["operator_latitude"], given["operator_longitude"], 1, 0, -1000, -1000, 0, 0,
        400, given["timestamp"],
    )  # fmt: skip


def basic_id(text: bytes = b"OURS12345678", ua_type: int = 2) -> Any:
    return mavlink.MAVLink_open_drone_id_basic_id_message(0, 0, ANY, 1, ua_type, text.ljust(20, b"\0"))


def self_id(text: bytes = b"") -> Any:
    return mavlink.MAVLink_open_drone_id_self_id_message(0, 0, ANY, 0, text)


def operator_id(text: bytes = b"") -> Any:
    return mavlink.MAVLink_open_drone_id_operator_id_message(0, 0, ANY, 0, text)


def data(now_s: float, **fields: Any) -> list[Any]:
    return [
        fields.get("basic", basic_id(b"ABCD123456789")),
        location(now_s, **fields.get("location", {})),
        system(now_s, **fields.get("system", {})),
        self_id(),
        operator_id(),
    ]


def statuses(messages: list[Any]) -> list[tuple[int, str]]:
    return [(m.status, m.error) for m in messages if m.get_type() == "OPEN_DRONE_ID_ARM_STATUS"]


def test_it_is_silent_until_a_heartbeat_that_is_no_ground_stations_gives_it_a_system_id() -> None:
    bench = Bench()
    assert bench.run(0.9) == []
    assert bench.raw == b""
    bench.run(3.0)
    assert bench.raw.startswith(b"ArduRemoteID version 1.14")
    assert bench.raw.count(b"Waiting for heartbeat\n") == 2
    bench.send(heartbeat(mavlink.MAV_TYPE_GCS))
    assert bench.run(2.0) == []
    # Parameters it answers all the same, from system 0.
    (answer,) = bench.send(mavlink.MAVLink_param_request_read_message(7, 236, b"BT4_RATE", -1))
    assert (answer.get_srcSystem(), answer.get_srcComponent()) == (0, 236)
    bench.send(heartbeat())
    found = bench.run(3.0)
    beats = [m for m in found if m.get_type() == "HEARTBEAT"]
    assert len(beats) == len(statuses(found)) == 3
    assert {(m.type, m.autopilot, m.get_srcSystem(), m.get_srcComponent()) for m in beats} == {
        (34, 8, 7, 236)
    }


def test_a_stored_system_id_goes_before_any_heartbeat() -> None:
    bench = Bench(params={"MAVLINK_SYSID": 42})
    assert {m.get_srcSystem() for m in bench.run(3.0)} == {42}
    bench.send(heartbeat())
    assert {m.get_srcSystem() for m in bench.run(2.0)} == {42}


def test_the_list_of_parameters_counts_one_too_few_and_tells_the_hidden_one() -> None:
    bench = Bench().start()
    bench.send(mavlink.MAVLink_param_request_list_message(7, 236))
    values = [m for m in bench.run(3.0) if m.get_type() == "PARAM_VALUE"]
    assert {m.param_count for m in values} == {19}
    assert {m.param_type for m in values} == {9}
    assert [m.param_index for m in values] == [*range(20), 65535]
    assert values[-1].param_id == "DONE_INIT"
    assert not {"UAS_ID", "WIFI_PASSWORD"} & {m.param_id for m in values}
    assert not bench.send(mavlink.MAVLink_param_request_read_message(7, 236, b"UAS_ID", -1))
    assert not bench.send(mavlink.MAVLink_param_request_read_message(7, 236, b"", 20))


def test_every_set_is_taken_without_a_check_and_wears_the_flash() -> None:
    bench = Bench().start()
    assert [m.param_value for m in bench.set("BT4_RATE", -3.0)] == [-3.0]
    assert [m.param_value for m in bench.set("BT4_RATE", -3.0)] == [-3.0]
    assert [m.param_value for m in bench.set("WIFI_CHANNEL", 300.0)] == [44.0]
    assert [m.param_value for m in bench.set("CAN_NODE", float("nan"))] == [0.0]
    assert bench.module.flash_writes == [
        ("BT4_RATE", -3.0), ("BT4_RATE", -3.0), ("WIFI_CHANNEL", 44.0), ("CAN_NODE", 0.0),
    ]  # fmt: skip
    assert bench.set("BT4_RATE", 2.0, kind=1) == []
    assert bench.set("UAS_ID", 2.0) == []
    assert len(bench.module.flash_writes) == 4


def test_a_locked_module_tells_the_old_value_and_says_so() -> None:
    bench = Bench(params={"LOCK_LEVEL": 1}).start()
    text, value = bench.set("WIFI_BCN_RATE", 2.0)
    assert (text.severity, text.text) == (mavlink.MAV_SEVERITY_ERROR, "Parameters locked")
    assert value.param_value == 0.0
    assert bench.module.flash_writes == []
    assert [m.get_type() for m in bench.set("LOCK_LEVEL", 0.0)] == ["STATUSTEXT", "PARAM_VALUE"]
    assert bench.param("LOCK_LEVEL") == 1.0
    assert [m.param_value for m in bench.set("LOCK_LEVEL", 2.0)] == [2.0]
    assert len(bench.module.catastrophes) == 2


def test_defaults_erase_the_flash_and_restart() -> None:
    bench = Bench(params={"WIFI_BCN_RATE": 3}).start()
    bench.set("TO_DEFAULTS", 1.0)
    assert bench.module.starts == 2
    assert bench.module.flash["WIFI_BCN_RATE"] == 0.0
    assert bench.module.catastrophes == ["PARAM_SET TO_DEFAULTS = 1"]


def test_it_arms_on_fresh_data_and_names_what_grows_old() -> None:
    bench = Bench().start()
    assert statuses(bench.run(1.0)) == [(1, "LOC SELF_ID OP_ID SYS LOC OP_LOC ")]
    bench.feed(5.0)
    assert statuses(bench.said)[-1] == (0, "")
    # Only Location and System go on.
    for _ in range(23):
        bench.send(location(bench.now_s), system(bench.now_s))
        bench.run(1.0)
    assert bench.module.refusal(bench.now_s) == "SELF_ID OP_ID "
    bench.feed(2.0)
    bench.run(2.5)
    assert bench.module.refusal(bench.now_s) == "LOC SYS "


@pytest.mark.parametrize(
    ("fields", "refusal"),
    [
        ({"location": {"latitude": 0, "longitude": 0}}, "LOC "),
        ({"system": {"operator_latitude": 0, "operator_longitude": 0}}, "OP_LOC "),
        ({"location": {"direction": 36500}}, "bad LOC  data"),
        ({"location": {"altitude_geodetic": 40000.0}}, "bad LOC  data"),
        ({"location": {"horizontal_accuracy": 14}}, "bad LOC  data"),
        ({"system": {"timestamp": 0}}, ""),
        ({"system": {"timestamp": 5}}, "SYS "),
    ],
)
def test_what_it_refuses(fields: dict[str, Any], refusal: str) -> None:
    bench = Bench().start()
    bench.feed(5.0, **fields)
    assert bench.module.refusal(bench.now_s) == refusal


def test_without_a_stored_basic_id_it_stores_the_first_that_it_gets_for_good() -> None:
    bench = Bench(params={"UAS_TYPE": 0, "UAS_ID_TYPE": 0, "LOCK_LEVEL": 1}).start()
    bench.feed(3.0, basic=basic_id(ua_type=0))
    assert bench.module.refusal(bench.now_s) == "ID "
    assert bench.module.flash_writes == []
    bench.feed(3.0, basic=basic_id())
    assert bench.module.flash_writes == [("UAS_TYPE", 2.0), ("UAS_ID_TYPE", 1.0), ("UAS_ID", "OURS12345678")]
    assert statuses(bench.said)[-1] == (0, "")
    bench.module.reboot(bench.now_s)
    bench.run(1.2)
    bench.send(heartbeat(), *data(bench.now_s, basic=basic_id(b"OTHER")))
    bench.run(2.0)
    ids = [m.uas_id for m in bench.air()["ble5"].messages if isinstance(m, BasicId)]
    assert ids == ["OURS12345678", "OTHER"]


def test_options_that_change_its_word() -> None:
    forced = Bench(params={"OPTIONS": 1}).start()
    assert statuses(forced.run(1.0)) == [(0, "")]
    unsaved = Bench(params={"OPTIONS": 2}).start()
    unsaved.feed(3.0, basic=basic_id())
    assert unsaved.module.flash_writes == []
    assert [m.uas_id for m in unsaved.air()["ble5"].messages if isinstance(m, BasicId)] == ["OURS12345678"]
    loud = Bench(params={"OPTIONS": 4}).start()
    loud.feed(1.0)
    assert b"MAVLink: got OPEN_DRONE_ID_LOCATION\n" in loud.raw


def test_messages_of_all_kinds_go_out_on_all_transports() -> None:
    bench = Bench(params={"WIFI_BCN_RATE": 2, "WIFI_NAN_RATE": 2, "BT4_RATE": 2}).start()
    legacy = set()
    for _ in range(4):
        fields = data(bench.now_s)[:3]
        bench.send(*fields, self_id(b"survey"), operator_id(b"CHE87astrdge12k8"))
        for _ in range(20):
            bench.run(0.05)
            legacy |= {type(m) for m in bench.air()["ble4"].messages}
    everything = {BasicId, Location, SelfId, System, OperatorId}
    assert legacy == everything
    air = bench.air()
    assert {t: {type(m) for m in air[t].messages} for t in ("ble5", "wifi", "nan")} == dict.fromkeys(
        ("ble5", "wifi", "nan"), everything
    )
    for transport in ("ble5", "wifi", "nan"):
        assert parse_frame(transport, air[transport].frame).payload == air[transport].payload


def test_location_and_system_need_a_timestamp_and_authentication_and_packs_are_lost() -> None:
    bench = Bench().start()
    bench.feed(3.0, location={"timestamp": 0.0}, system={"timestamp": 0})
    bench.send(
        mavlink.MAVLink_open_drone_id_authentication_message(
            0, 0, ANY, 1, 0, 0, 3, 1, b"abc".ljust(23, b"\0")
        ),
        mavlink.MAVLink_open_drone_id_message_pack_message(0, 0, ANY, 25, 1, bytes(225)),
    )
    bench.run(2.0)
    assert [type(m) for m in bench.air()["ble5"].messages] == [BasicId]
    assert statuses(bench.said)[-1] == (0, "")  # and still it is good to arm


def test_a_rate_of_zero_leaves_stale_data_on_the_air_but_for_nan() -> None:
    bench = Bench(params={"WIFI_BCN_RATE": 1, "WIFI_NAN_RATE": 1}).start()
    bench.feed(3.0)
    for name in ("WIFI_BCN_RATE", "WIFI_NAN_RATE", "BT4_RATE", "BT5_RATE"):
        bench.set(name, 0.0)
    bench.feed(20.0)
    air = bench.air()
    assert set(air) == {"ble4", "ble5", "wifi"}
    assert all(19.0 < entry.age_s < 22.0 for entry in air.values())


def test_what_it_was_told_last_stays_on_the_air_for_ever() -> None:
    bench = Bench().start()
    bench.feed(3.0)
    before = bench.air()["ble5"].payload
    bench.run(60.0)
    assert bench.air()["ble5"].payload == before
    assert bench.air()["ble5"].age_s < 1.1


def test_bluetooth_intervals_are_those_of_the_start() -> None:
    bench = Bench(params={"BT4_RATE": 0, "BT5_RATE": 1}).start()
    bench.feed(2.0)
    bench.set("BT4_RATE", 1.0)
    bench.set("BT5_RATE", 4.0)
    bench.feed(3.0)
    assert "ble4" not in bench.air()
    assert bench.air()["ble5"].interval_s == 1.0
    bench.module.reboot(bench.now_s)
    bench.run(3.0)
    assert bench.air()["ble4"].interval_s == pytest.approx(1 / 7)
    assert bench.air()["ble5"].interval_s == 0.25


def test_the_channel_follows_at_the_next_start() -> None:
    bench = Bench(params={"WIFI_BCN_RATE": 1, "WIFI_CHANNEL": 6}).start()
    bench.run(1.0)
    bench.set("WIFI_CHANNEL", 11.0)
    bench.run(2.0)
    assert bench.module.wifi_channel == 6
    bench.module.reboot(bench.now_s)
    bench.run(2.0)
    assert bench.module.wifi_channel == 11


def test_before_it_knows_anything_it_sends_empty_packs_if_told_to() -> None:
    eager = Bench(params={"UAS_TYPE": 0}).start()
    assert eager.air()["ble5"].payload == b"\xf2\x19\x00"
    assert eager.air()["ble5"].frame is None
    shy = Bench(params={"BCAST_POWERUP": 0}).start()
    shy.run(5.0)
    assert shy.air() == {}
    assert statuses(shy.said)[-1] == (1, "uninitialised")
    shy.feed(2.0)
    assert set(shy.air()) == {"ble4", "ble5"}


def test_a_restart_keeps_the_flash_and_nothing_else() -> None:
    bench = Bench(boot_s=3.0, noise=True)
    bench.run(3.1)
    bench.send(heartbeat())
    bench.set("WIFI_BCN_RATE", 2.0)
    bench.feed(5.0)
    bench.module.reboot(bench.now_s)
    assert bench.air() == {}
    assert bench.run(2.9) == []
    bench.send(*data(bench.now_s))  # nobody listens
    bench.run(0.2)
    bench.send(heartbeat())
    assert statuses(bench.run(1.0)) == [(1, "LOC SELF_ID OP_ID SYS LOC OP_LOC ")]
    assert bench.param("WIFI_BCN_RATE") == 2.0
