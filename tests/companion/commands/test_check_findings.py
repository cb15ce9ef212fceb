"""What `companion check` finds about the vehicle, its link and the disk."""

from __future__ import annotations

import contextlib
import json
import math
import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest

from companion.autopilot.link import AutopilotLink
from companion.autopilot.wire import MavlinkWriter
from companion.commands import check as check_module
from companion.commands.check import check
from companion.config import AtmcConfig, Config, IdentityConfig, RecordConfig, RemoteIdConfig, VehicleConfig
from companion.events import GlobalPosition
from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.radio.ether.section import EtherRadio
from companion.radio.null.null_radio import NullTransport
from companion.radio.null.section import NullRadio
from companion.radio.radio import Health
from companion.remote_id.messages import IdType
from companion.runtime import radios
from companion.runtime.links.byte_link import Received
from companion.runtime.links.kept_link import KeptLink
from tests.companion.commands.conftest import Vehicle
from tests.support.place import LAT_E7, LON_E7


@pytest.fixture
def listed(vehicle: Vehicle, make_config: Callable[..., Config], tmp_path: Path) -> Callable[..., Any]:
    """The findings of a check, by what they are about; keywords replace parts of the configuration."""

    def run(code: int, **changes: Any) -> dict[str, list[tuple[str, str, str]]]:
        base = msgspec.structs.replace(
            make_config(use="watch"),
            identity=IdentityConfig(uas_id="1596B0000TEST001"),
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
        assert {light for light, *_ in found[what]} == {"green"}, found[what]
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
    # What the vehicle says may be late, or be heard late, on a busy machine.
    said = re.fullmatch(r"UTC known; this computer's clock differs from the vehicle's by (\+\d+\.\d) s", text)
    assert said is not None
    assert float(said[1]) == pytest.approx(3600.0, abs=10.0)
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


def test_a_radio_that_cannot_send_the_identity(
    listed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for probe in ("find_radios", "_vehicle"):
        monkeypatch.setattr(check_module, probe, lambda *_: None)
    tag = IdentityConfig(id_type=IdType.SPECIFIC_SESSION, uas_id="\x01 \x01\x00\x30" + "\0" * 11 + "\x01")
    found = listed(1, identity=tag, radio=(NullRadio(), ArduRemoteIdRadio(link="udpout:127.0.0.1:9")))
    light, text, _ = found["identity"][0]
    assert light == "red"
    assert text.startswith("radio[1]: the module cuts identities at a zero byte")


def test_a_folder_whose_disk_is_not_mounted(
    listed: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(check_module, "_vehicle", lambda *_: None)
    found = listed(1, record=RecordConfig(folder=str(tmp_path / "disk" / "runs")))
    for what in ("disk", "settings"):
        light, text, _ = found[what][0]
        assert light == "red"
        assert f"there is no folder {tmp_path}/disk; mount its disk" in text


@pytest.mark.parametrize(
    ("transports", "policy", "warned"),
    [(("wifi",), None, True), (("ble4", "wifi"), None, False), (("wifi",), "fixed", False)],
)
def test_a_broadcast_without_ble4_is_warned_about(
    listed: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    transports: tuple[Any, ...],
    policy: str | None,
    warned: bool,
) -> None:
    """Wi-Fi alone stops preventing losses of separation in a busy channel. A policy chooses by itself."""
    monkeypatch.setattr("companion.commands.check_radios._RADIO_S", 0.1)
    found = listed(
        1,  # no air is served there
        radio=(EtherRadio(address="127.0.0.1:9"),),
        remote_id=RemoteIdConfig(transports=transports),
        atmc=AtmcConfig(policy=policy),
    )
    texts = [text for light, text, _ in found["remote ID"] if light == "yellow"]
    assert any("no BLE 4" in text for text in texts) is warned


def test_a_radio_that_is_not_ok_is_red_whatever_it_says_is_missing(
    listed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line is a warning if it is a missing function, not if it only ends like one."""

    class Broken(NullTransport):
        def health(self, now_s: float) -> Health:
            return Health(False, "antenna broken", 0, 0, 0, missing=("broken", ""))

    monkeypatch.setattr(check_module, "_vehicle", lambda *_: None)
    monkeypatch.setattr("companion.commands.check_radios._RADIO_S", 0.1)
    monkeypatch.setattr(radios, "open_radio", lambda *_: Broken())
    found = listed(1, radio=(EtherRadio(address="127.0.0.1:9"),))
    lights = {text: light for light, text, _ in found["radio"]}
    assert lights == {"antenna broken": "red", "broken": "yellow", "": "yellow"}


@pytest.mark.parametrize(("stalls_s", "comes_at_once"), [(101.0, True), (101.96, False)])
def test_a_computer_that_stood_still_is_not_told_as_an_overloaded_link(
    monkeypatch: pytest.MonkeyPatch, stalls_s: float, comes_at_once: bool
) -> None:
    """It stands still for 3 s while it waits, and the simulated vehicle beside it as well."""
    now_s = 100.0
    writer = MavlinkWriter(1, 1)

    class Link:
        quiet = False

        def wait(self, timeout_s: float) -> None:
            nonlocal now_s
            stalls = now_s < stalls_s <= now_s + timeout_s
            now_s += 3.0 if stalls else timeout_s
            self.quiet = stalls and not comes_at_once

        def receive(self, _: float) -> Received:
            encode, boot_ms = writer.encoder, round(1e3 * now_s)
            messages = (
                encode.heartbeat_encode(2, 3, 1, 5, 4),
                encode.global_position_int_encode(boot_ms, LAT_E7, LON_E7, 450_000, 50_000, 0, 0, 0, 0),
            )
            return Received(b"" if self.quiet else b"".join(map(writer.pack, messages)))

        def send(self, data: bytes) -> None:
            """Nobody answers."""

    monkeypatch.setattr("companion.runtime.clock.now_s", lambda: now_s)
    config = VehicleConfig()
    probe = check_module._Probe(cast("KeptLink", Link()), AutopilotLink(config))
    probe.run(2.0)
    assert probe.counts[GlobalPosition] > 30
    assert probe.own.age_s(probe.now_s) < config.stale_after_s
