"""`companion check` says what `companion run` will do: both prepare real modules and access points."""

from __future__ import annotations

import contextlib
import json
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.autopilot.wire import MavlinkWriter
from companion.commands import check as check_module
from companion.commands.check import _judge_mission, _judge_parameters, check
from companion.commands.preflight import Preflight
from companion.config import Config, RecordConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import (
    Firmware,
    MissionDownloaded,
    MissionItem,
    MissionRefused,
    Parameter,
    VehicleParameters,
)
from companion.radio.arduremoteid.module_radio import ArduRemoteIdTransport
from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.radio.frames_io import radio_address
from companion.radio.radio import Radio
from companion.radio.wifi import wifi_radio
from companion.radio.wifi.hostapd import ApStatus
from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import WifiTransport
from companion.remote_id.region import Region
from companion.runtime import radios
from companion.runtime.flight import Flight
from sitl_mocks.remote_id_module.module import ModuleOptions, RemoteIdModule

REGIONS = Path(__file__).parents[3] / "config" / "regions"
NOT_READY = "check: NOT ready"


class Wire:
    """A link to a module."""

    def __init__(self, options: ModuleOptions) -> None:
        self.module = RemoteIdModule(options, time.monotonic())

    def wait(self, timeout_s: float) -> None:
        time.sleep(min(timeout_s, 0.005))

    def receive(self, now_s: float) -> bytes:
        self.module.advance(time.monotonic())
        return self.module.drain()

    def send(self, data: bytes) -> None:
        self.module.receive(data, time.monotonic())

    def close(self) -> None:
        """Keep the module open."""


class AccessPoint:
    """A running hostapd on channel 11."""

    path = "/run/hostapd/wlan0"
    trouble: str | None = None
    updates = 0

    def __init__(self, path: str) -> None:
        self.status = ApStatus("ENABLED", "02:00:00:aa:bb:cc", 11, 100)

    def poll(self, now_s: float) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Nothing to release."""


class Vehicle:
    """A vehicle, system 1, that sends everything fifty times a second to whoever connects."""

    def __init__(self) -> None:
        self.silent: set[str] = set()
        """Messages that it does not send."""
        self.fix_type = 3
        self.clock_off_s = 0.0
        self.old_s = 0.0
        """How old its positions grow within a second."""
        self.lat_e7 = 473_970_000
        self.noise = b""
        self.forwarded = b""
        """Frames of others."""
        self._began_s = time.monotonic()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.port = self._server.getsockname()[1]
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _frames(self, writer: MavlinkWriter) -> bytes:
        encode, up_s = writer.encoder, time.monotonic() - self._began_s
        boot_ms = round((100.0 + up_s * (1.0 - self.old_s)) * 1e3)
        unix_us = 0 if self.clock_off_s == math.inf else round((time.time() - self.clock_off_s) * 1e6)
        place = self.lat_e7, 85_450_000 if self.lat_e7 else 0
        messages = (
            encode.heartbeat_encode(2, 3, 1, 5, 4),
            encode.global_position_int_encode(boot_ms, *place, 450_000, 50_000, 0, 0, 0, 0),
            encode.local_position_ned_encode(boot_ms, 0, 0, 0, 0, 0, 0),
            encode.gps_raw_int_encode(0, self.fix_type, *place, 450_000, 0, 0, 0, 0, 12),
            encode.extended_sys_state_encode(0, 1),
            encode.system_time_encode(unix_us, boot_ms),
            encode.mission_current_encode(0),
        )
        return (
            self.noise
            + self.forwarded
            + b"".join(writer.pack(m) for m in messages if m.get_type() not in self.silent)
        )

    def _serve(self) -> None:
        writer, peers = MavlinkWriter(1, 1), list[socket.socket]()
        while not self._ended.wait(0.02):
            with contextlib.suppress(TimeoutError):
                peers.append(self._server.accept()[0])
                self._server.settimeout(0.001)
            for peer in list(peers):
                try:
                    peer.sendall(self._frames(writer))
                except OSError:
                    peers.remove(peer)
                    peer.close()
        for peer in peers:
            peer.close()

    def end(self) -> None:
        """Drop all connections and the port."""
        self._ended.set()
        self._thread.join(60.0)
        self._server.close()


@pytest.fixture
def vehicle(monkeypatch: pytest.MonkeyPatch) -> Iterator[Vehicle]:
    monkeypatch.setattr("companion.commands.check._SETTLE_S", 0.1)
    monkeypatch.setattr("companion.commands.check._MEASURE_S", 0.5)
    # It tells no parameters.
    monkeypatch.setattr("companion.commands.check._PARAMETERS_S", 0.2)
    made = Vehicle()
    yield made
    made.end()


def plain(lines: list[str]) -> list[str]:
    """The printed findings without colours and advice."""
    return [re.sub(r"^(green|yellow|red) +", "", line).split("\n")[0] for line in lines]


Both = Callable[..., tuple[list[str], list[str]]]


@pytest.fixture
def both(
    vehicle: Vehicle, make_config: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Both:
    """What `check` says of such radios, and then what `run` says before it flies, or why it does not.

    Radios are a `Wire` to a module, an `AccessPoint`, or an error.
    """

    def say_both(
        *parts: Any, region: str = "us", system_id: int = 1, **remote_id: Any
    ) -> tuple[list[str], list[str]]:
        left: list[Any] = []

        def open_radio(*_: object) -> Radio:
            part = left.pop(0)
            if isinstance(part, Exception):
                raise part
            if isinstance(part, Wire):
                return ArduRemoteIdTransport(part, system_id, time.monotonic, "the module")
            return WifiTransport(WifiRadio(hostapd=AccessPoint.path), radio_address("OWN"))

        monkeypatch.setattr(wifi_radio, "HostapdControl", AccessPoint)
        monkeypatch.setattr(radios, "open_radio", open_radio)
        monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
        base = make_config(use="watch")
        law = msgspec.toml.decode((REGIONS / f"{region}.toml").read_bytes(), type=Region)
        config = msgspec.structs.replace(
            base,
            vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{vehicle.port}", wait_s=60.0),
            record=RecordConfig(folder=str(tmp_path)),
            remote_id=msgspec.structs.replace(base.remote_id, **remote_id),
            region=msgspec.structs.replace(
                law, serial_number="any", operator_id="any", operator_id_required=False
            ),
            radio=tuple(ArduRemoteIdRadio(link="serial:/dev/x:1", system_id=system_id) for _ in parts),
        )
        checked: list[str] = []
        left[:] = parts
        code = check(config, checked.append)
        assert code == (0 if checked[-1] == "check: ready" else 1)
        run: list[str] = []
        left[:] = parts
        try:
            Flight(config, run.append, dry_run=False)._close()
        except ConfigError as error:
            run.append(str(error))
        return plain(checked), run

    return say_both


def module(**params: float) -> Wire:
    return Wire(ModuleOptions(boot_s=0.0, params={"UAS_TYPE": 2.0, "UAS_ID_TYPE": 1.0, **params}))


def test_a_rate_that_the_module_cannot_send_is_refused_by_both(both: Both) -> None:
    wire = module()
    checked, run = both(wire, transports=("wifi",), rate=8)
    refusal = "radio[0]: the module: wifi: 8 messages a second; allowed: 1 to 5"
    assert refusal in checked
    assert checked[-1] == NOT_READY
    assert run[-1] == refusal


def test_a_locked_module_is_refused_by_both(both: Both) -> None:
    wire = module(LOCK_LEVEL=1.0)
    checked, run = both(wire, transports=("wifi",), rate=2)
    (refusal,) = (line for line in checked if "the module is locked (LOCK_LEVEL 1)" in line)
    assert checked[-1] == NOT_READY
    assert run[-1] == refusal
    assert wire.module.param_sets == []


def test_what_the_check_says_would_be_set_is_what_run_sets(
    both: Both, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = module()
    sets_at_check: list[int] = []
    close = ArduRemoteIdTransport.close

    def counted(self: ArduRemoteIdTransport) -> None:
        sets_at_check.append(len(wire.module.param_sets))
        close(self)

    monkeypatch.setattr(ArduRemoteIdTransport, "close", counted)
    checked, run = both(wire, transports=("wifi",), rate=2)
    assert "remote ID: wifi 2/s" in checked
    assert "radio: would set WIFI_BCN_RATE to 2 (it is 0)" in checked
    assert checked[-1] == "check: ready"
    assert "remote ID: wifi 2/s" in run
    assert "radio: set WIFI_BCN_RATE to 2 (was 0)" in run
    assert sets_at_check == [0, 1]
    assert wire.module.param_sets == [("WIFI_BCN_RATE", 2.0)]


def test_the_rate_that_the_law_asks_for_on_a_channel_is_the_one_that_is_told(both: Both) -> None:
    line = "remote ID: wifi at least 5/s (region eu asks for wifi on channel 11 every 0.2 s, not 2/s)"
    for said in both(AccessPoint, region="eu", transports=("wifi",), rate=2):
        assert line in said


def test_a_module_that_is_told_to_be_another_vehicles_is_warned_of(both: Both) -> None:
    checked, _ = both(module(), system_id=7)
    (warning,) = (line for line in checked if line.startswith("radio[0].system_id: 7"))
    assert "but the vehicle is system 1" in warning
    checked, _ = both(module())
    assert not any("system_id" in line for line in checked)


def test_every_bad_radio_is_told_before_the_vehicle_is_waited_for(both: Both) -> None:
    checked, run = both(ConfigError("no such port"), module(), ConfigError("no such card"))
    at = [checked.index(line) for line in ("radio[0]: no such port", "radio[2]: no such card")]
    assert any(line.startswith("radio[1]: ArduRemoteID") for line in checked)
    assert max(at) < next(n for n, line in enumerate(checked) if line.startswith("vehicle: "))
    assert checked[-1] == NOT_READY
    assert run[-1] == "radio[0]: no such port"


def test_a_single_bad_radio_is_not_called_the_null_backend(both: Both) -> None:
    checked, _ = both(ConfigError("no such port"))
    assert "radio[0]: no such port" in checked
    assert not any("backend null" in line for line in checked)


def test_a_path_that_the_vehicle_cannot_fly_is_not_ready(make_config: Callable[..., Config]) -> None:
    def judge(use: str, told: VehicleParameters | None) -> tuple[bool, list[str]]:
        found = Preflight()
        _judge_parameters(make_config(use=use), told, found)
        return found.ready, [f"{finding.what}: {finding.text}" for finding in found.findings]

    slow = VehicleParameters(
        firmware=Firmware.PX4,
        speed_mps=Parameter(name="MPC_XY_VEL_MAX", value=2.0),
        setpoint_timeout_s=Parameter(name="COM_OF_LOSS_T", value=0.2),
        loss_action=Parameter(name="COM_OBL_RC_ACT", value=3.0),
    )
    ready, said = judge("fly", slow)
    assert not ready
    assert said[0] == "vehicle: without setpoints for 0.2 s (COM_OF_LOSS_T) it returns (COM_OBL_RC_ACT 3)"
    assert "vehicle: MPC_XY_VEL_MAX 2 is below limits.max_speed_mps 5: the vehicle's limit counts" in said
    assert any(line.startswith("vehicle: COM_OF_LOSS_T 0.2 s is short") for line in said)
    assert "is above the vehicle's MPC_XY_VEL_MAX 2" in said[-1]
    assert judge("watch", slow) == (True, [])
    ready, said = judge("fly", VehicleParameters(firmware=Firmware.ARDUPILOT))
    assert ready
    assert any("does not report its speed limits" in line for line in said)
    assert judge("fly", None) == (True, [])


def test_the_mission_that_is_to_be_guarded(make_config: Callable[..., Config]) -> None:
    told = VehicleParameters(firmware=Firmware.ARDUPILOT, speed_mps=Parameter(name="WP_SPD", value=9.6))
    place = MissionItem(seq=2, command=16, frame=6, lat_deg=47.0, lon_deg=8.0, alt_m=30.0)
    slow = MissionItem(seq=1, command=178, frame=2, params=(1.0, 4.0, -1.0, 0.0))

    def judge(mission: MissionDownloaded | MissionRefused | None) -> list[tuple[str, str]]:
        found = Preflight()
        _judge_mission(make_config(use="guard"), told, mission, found)
        assert found.ready
        assert {f.what for f in found.findings} == {"mission"}
        assert all(bool(f.do) is (f.light.value != "green") for f in found.findings)
        return [(f.light.value, f.text) for f in found.findings]

    fast = (
        "yellow",
        "WP_SPD 9.6 is above limits.max_speed_mps 5: taken for a conflict, the vehicle slows down to that "
        "at once",
    )
    assert judge(MissionDownloaded(items=(slow, place))) == [("green", "2 items, read from the vehicle")]
    assert judge(MissionDownloaded(items=(place,))) == [("green", "1 items, read from the vehicle"), fast]
    assert judge(MissionDownloaded(items=())) == [("yellow", "the vehicle has none"), fast]
    assert judge(MissionRefused(reason="item 3 of 5 did not come")) == [
        ("yellow", "not read: item 3 of 5 did not come"),
        fast,
    ]
    assert judge(None) == [("yellow", "not read: the vehicle did not finish sending it"), fast]


def test_what_the_vehicle_hears_of_crewed_traffic_is_told(make_config: Callable[..., Config]) -> None:
    def judge(use: str, receiver: float) -> list[str]:
        found = Preflight()
        told = VehicleParameters(
            firmware=Firmware.ARDUPILOT,
            adsb_type=Parameter(name="ADSB_TYPE", value=receiver),
            adsb_radius_m=Parameter(name="ADSB_LIST_RADIUS", value=2000.0),
        )
        _judge_parameters(make_config(use=use), told, found)
        assert found.ready
        return [f"{f.light.name} {f.what}: {f.text}" for f in found.findings if "ADSB" in f.text]

    for use in ("fly", "watch"):
        (line,) = judge(use, 1.0)
        assert line.startswith(
            "YELLOW vehicle: ADSB_LIST_RADIUS 2000: aircraft beyond 2000 m are not told of"
        )
        assert judge(use, 0.0) == [
            "GREEN vehicle: ADSB_TYPE 0: no ADS-B receiver: crewed traffic is not heard"
        ]


@pytest.fixture
def listed(vehicle: Vehicle, make_config: Callable[..., Config], tmp_path: Path) -> Callable[..., Any]:
    """The findings of a check, by what they are about; keywords replace parts of the configuration."""

    def run(code: int, **changes: Any) -> dict[str, list[tuple[str, str, str]]]:
        base = msgspec.structs.replace(
            make_config(use="watch"),
            vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{vehicle.port}", wait_s=60.0),
            record=RecordConfig(folder=str(tmp_path / "runs")),
        )
        said: list[str] = []
        assert check(msgspec.structs.replace(base, **changes), said.append, as_json=True) == code
        (line,) = said
        told = json.loads(line)
        assert told["ready"] is (code == 0)
        found: dict[str, list[tuple[str, str, str]]] = {}
        for finding in told["findings"]:
            found.setdefault(finding["what"], []).append((finding["light"], finding["text"], finding["do"]))
            assert bool(finding["do"]) is (finding["light"] != "green"), finding
        return found

    return run


def test_all_is_well_with_a_vehicle_that_sends_everything(
    listed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Until it is asked for its parameters no more.
    monkeypatch.setattr("companion.commands.check._PARAMETERS_S", 60.0)
    found = listed(0)
    for what in ("configuration", "disk", "policy", "link", "vehicle", "rates", "GNSS", "clock"):
        assert {light for light, *_ in found[what]} == {"green"}, what
    assert found["region"][0][:2] == ("yellow", "none: no Remote ID law applies")
    assert found["radio"][0][0] == "yellow", "to watch without a radio is a choice"
    assert "ardupilot, system 1" in found["vehicle"][0][1]
    assert "satellites 12" in found["GNSS"][0][1]
    assert "GLOBAL_POSITION_INT" in found["rates"][0][1]


@pytest.mark.parametrize(
    ("name", "light"),
    [
        ("GLOBAL_POSITION_INT", "red"),
        ("GPS_RAW_INT", "red"),
        ("EXTENDED_SYS_STATE", "red"),
        ("SYSTEM_TIME", "red"),
        ("LOCAL_POSITION_NED", "yellow"),
        ("MISSION_CURRENT", "yellow"),
    ],
)
def test_a_message_that_does_not_come_is_told(
    vehicle: Vehicle, listed: Callable[..., Any], name: str, light: str
) -> None:
    vehicle.silent.add(name)
    good, short = listed(1 if light == "red" else 0)["rates"]
    assert name not in good[1]
    assert short[0] == light
    assert short[1].startswith(f"{name} 0.0 a second")


def test_a_vehicle_that_does_not_know_where_it_is(vehicle: Vehicle, listed: Callable[..., Any]) -> None:
    vehicle.lat_e7, vehicle.fix_type = 0, 1
    found = listed(1)
    assert found["GNSS"] == [("red", "no 3D fix (fix type 1)", found["GNSS"][0][2])]
    assert "wait until the autopilot knows its position" in found["rates"][1][2]


def test_clocks(vehicle: Vehicle, listed: Callable[..., Any]) -> None:
    vehicle.clock_off_s = 3600.0
    ((light, text, _),) = listed(0)["clock"]
    assert light == "yellow"
    assert "+3600." in text
    vehicle.clock_off_s = math.inf
    assert listed(1)["clock"][0][:2] == ("red", "the vehicle does not know UTC")


def test_a_link_that_is_choked_or_noisy(
    vehicle: Vehicle, listed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle.old_s, vehicle.noise = 0.9, b"\xfd\x04\x00\x00\x00\x01\x01\x00\x00\x00abcdef"
    monkeypatch.setattr("companion.commands.check._MEASURE_S", 1.5)
    choked = listed(1)["link"]
    assert "damaged frames" in choked[0][1]
    assert choked[1][0] == "red"
    assert "s old" in choked[1][1]


def test_two_autopilots_are_not_ready_until_one_is_configured(
    vehicle: Vehicle, listed: Callable[..., Any]
) -> None:
    writer = MavlinkWriter(2, 1)
    vehicle.forwarded = writer.pack(writer.encoder.heartbeat_encode(2, 12, 1, 0, 4))
    (light, text, do) = listed(1)["vehicle"][-1]
    assert (light, do) == ("red", "set it to the right one, or stop what forwards the other")
    assert text == "two autopilots on this link (systems 1 and 2): set vehicle.system_id"
    link = f"tcp:127.0.0.1:{vehicle.port}"
    found = listed(0, vehicle=VehicleConfig(link=link, system_id=1, wait_s=60.0))
    assert "system 1" in found["vehicle"][0][1]


def test_bytes_that_are_no_vehicle_are_told_from_silence(
    vehicle: Vehicle, listed: Callable[..., Any]
) -> None:
    vehicle.silent.add("HEARTBEAT")
    link = f"tcp:127.0.0.1:{vehicle.port}"
    assert (
        "MAVLink frames were received"
        in listed(1, vehicle=VehicleConfig(link=link, wait_s=0.5))["vehicle"][0][1]
    )
    silent = listed(1, vehicle=VehicleConfig(link="udpin:127.0.0.1:0", wait_s=0.1))
    assert "no data was received" in silent["vehicle"][0][1]
    absent = listed(1, vehicle=VehicleConfig(link="serial:/dev/nothing:57600", wait_s=0.1))
    assert absent["link"][0][0] == "red"
    other = VehicleConfig(link=link, system_id=7, wait_s=0.5)
    _, text, do = listed(1, vehicle=other)["vehicle"][0]
    assert text.endswith("but no autopilot HEARTBEAT from system 7")
    assert do.startswith("set vehicle.system_id to the autopilot's system id")


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ("serial:/dev/null:57600", "this is not a serial port"),
        ("tcp:127.0.0.1:1", "no program accepts connections there; first start the program at the other end"),
        (
            "udpin:192.0.2.1:14550",
            "this computer has no such address; use 0.0.0.0 to listen on all of its addresses",
        ),
    ],
)
def test_a_link_that_cannot_be_opened_says_why(listed: Callable[..., Any], link: str, words: str) -> None:
    ((light, text, _),) = listed(1, vehicle=VehicleConfig(link=link, wait_s=0.1))["link"]
    assert (light, text) == ("red", f"vehicle.link: {link}: {words}")


class Sender:
    """Datagrams to one port, as fast as a vehicle's, until it is closed."""

    def __init__(self, port: int, *messages: bytes) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._send, args=(port, messages), daemon=True)
        self._thread.start()

    def _send(self, port: int, messages: tuple[bytes, ...]) -> None:
        while not self._ended.wait(0.02):
            for message in messages:
                self._socket.sendto(message, ("127.0.0.1", port))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


@pytest.mark.usefixtures("vehicle")
def test_datagrams_that_are_no_mavlink_are_told_from_silence(listed: Callable[..., Any]) -> None:
    port = free_port()
    with contextlib.closing(Sender(port, b"$GPGGA,1*00")):
        found = listed(1, vehicle=VehicleConfig(link=f"udpin:127.0.0.1:{port}", wait_s=0.5))
    ((_, text, do),) = found["vehicle"]
    assert re.search(r"; \d+ datagrams were received, but no MAVLink$", text)
    assert do == "check what sends to this address"


@pytest.mark.usefixtures("vehicle")
def test_two_that_send_to_one_port_are_told_of(listed: Callable[..., Any]) -> None:
    """The link believes the first sender alone, so that two autopilots are never seen."""
    port = free_port()
    beats = [
        writer.pack(writer.encoder.heartbeat_encode(2, 3, 1, 5, 4))
        for writer in (MavlinkWriter(1, 1), MavlinkWriter(2, 1))
    ]
    link = f"udpin:127.0.0.1:{port}"
    with contextlib.closing(Sender(port, beats[0])), contextlib.closing(Sender(port, beats[1])):
        both = listed(1, vehicle=VehicleConfig(link=link, wait_s=60.0))["link"]
        neither = listed(1, vehicle=VehicleConfig(link=link, system_id=7, wait_s=0.5))["vehicle"]
    light, text, do = both[1]
    assert light == "yellow"
    assert re.search(r"another sender uses this port; \d+ datagrams were ignored", text)
    assert do.startswith("let only one program send to this port")
    assert re.search(r"from system 7; \d+ datagrams of another sender were ignored", neither[0][1])
    with contextlib.closing(Sender(port, beats[0])):
        assert len(listed(1, vehicle=VehicleConfig(link=link, wait_s=60.0))["link"]) == 1


@pytest.mark.parametrize(
    ("free", "delete_oldest", "old_runs", "light"),
    [
        (5000.0, False, 0, "green"),
        (400.0, False, 3, "yellow"),
        (100.0, False, 3, "red"),
        (100.0, True, 3, "yellow"),
        (100.0, True, 0, "red"),
    ],
)
def test_room_on_the_disk(
    listed: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    free: float,
    delete_oldest: bool,
    old_runs: int,
    light: str,
) -> None:
    monkeypatch.setattr(check_module, "free_mb", lambda _folder: free)
    monkeypatch.setattr(check_module, "finished_runs", lambda _folder: [tmp_path] * old_runs)
    monkeypatch.setattr(check_module, "_vehicle", lambda *_: None)
    record = RecordConfig(folder=str(tmp_path / "runs"), delete_oldest=delete_oldest)
    assert listed(1 if light == "red" else 0, record=record)["disk"][0][0] == light


def test_a_folder_that_cannot_be_written(
    listed: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_module, "_vehicle", lambda *_: None)
    (tmp_path / "file").write_text("")
    found = listed(1, record=RecordConfig(folder=str(tmp_path / "file" / "runs")))
    assert found["disk"][0][:2] == ("red", f"{tmp_path}/file/runs: cannot be written")
