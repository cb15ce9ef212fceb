"""What we tell of ourselves, over bytes: who is answered, with what, how fast."""

from __future__ import annotations

import itertools
import json
import math
import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from companion import __version__
from companion.adjustable_parameters import NAMES, changed
from companion.autopilot.link import AutopilotLink
from companion.autopilot.served import ftp
from companion.autopilot.served.component_information import (
    CAPABILITIES,
    MOST_WAITING,
    PERIOD_S,
    ComponentInformation,
)
from companion.autopilot.served.metadata import metadata_files
from companion.autopilot.signing import Signing
from companion.autopilot.wire import FrameScanner, MavlinkWriter
from companion.config import AvoidanceConfig, Config, IdentityConfig, LimitsConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import Settings
from companion.radio.ether.section import EtherRadio

CONFIG = Config(identity=IdentityConfig(uas_id="OWN"), radio=(EtherRadio(address="127.0.0.1:1"),))
KEY = bytes(range(32))
BASIC, METADATA, VERSION, ACK, FTP = 396, 397, 148, 77, 110
ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3


class Station:
    """A ground station, and the vehicle that passes on what it says."""

    def __init__(self, signing=None, config=CONFIG):
        self.link = AutopilotLink(VehicleConfig(), signing=signing, information=ComponentInformation(config))
        self.now_s = 10.0
        self.peer = Signing(KEY, 1_000_000, 0.0) if signing else None
        self._writers = {}
        self._scanner = FrameScanner(keep_unknown=True)
        self.says(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), 1, 1)

    def says(self, message, system=255, component=190, signed=True):
        frame = self._writers.setdefault((system, component), MavlinkWriter(system, component)).pack(message)
        if self.peer is not None and signed:
            frame = self.peer.sign(frame)
        self.link.receive(frame, self.now_s)

    def run(self, seconds=0.5, step_s=0.05):
        """Let time pass; (time, frame) of all that we said of ourselves."""
        heard = []
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            self.link.advance(self.now_s)
            heard += [(self.now_s, frame) for frame in self._scanner.frames(self.link.drain())]
        return [(t, f) for t, f in heard if f.message_id in (BASIC, METADATA, VERSION, ACK, FTP)]

    def request(self, number, system=1, component=191, command=512, signed=True):
        long = mavlink.MAVLink_command_long_message
        self.says(long(system, component, command, 0, number, 0, 0, 0, 0, 0, 0), signed=signed)

    def ftp(self, opcode, data=b"", *, system=1, component=191, offset=0, size=None, seq=1, signed=True):
        head = struct.pack("<HBBBBBBI", seq, 0, opcode, len(data) if size is None else size, 0, 0, 0, offset)
        payload = (head + data).ljust(ftp.PAYLOAD_BYTES, b"\0")
        self.says(
            mavlink.MAVLink_file_transfer_protocol_message(0, system, component, payload), signed=signed
        )


def ids(heard):
    return [frame.message_id for _, frame in heard]


def result(frame, of=512):
    command, code, _, _, system, component = struct.unpack("<HBBiBB", frame.payload.ljust(10, b"\0"))
    assert command == of
    return code, system, component


def basic(frame):
    fields = struct.unpack("<QII32s32s24s24s32s", frame.payload.ljust(160, b"\0"))
    return [f.rstrip(b"\0") if isinstance(f, bytes) else f for f in fields]


def metadata(frame):
    boot_ms, crc, uri = struct.unpack("<II100s", frame.payload.ljust(108, b"\0"))
    return boot_ms, crc, uri.rstrip(b"\0").decode()


def test_what_we_are():
    station = Station()
    station.request(BASIC)
    (_, ack), (now_s, frame) = station.run()
    assert result(ack) == (ACCEPTED, 255, 190)
    assert (frame.system_id, frame.component_id) == (1, 191)
    assert basic(frame) == [
        CAPABILITIES, round(now_s * 1e3), 0, b"DMUCA", b"companion", __version__.encode(), b"", b"",
    ]  # fmt: skip


def test_the_version_is_told_as_the_autopilots_message_too():
    station = Station()
    station.request(VERSION)
    (_, ack), (_, frame) = station.run()
    assert result(ack) == (ACCEPTED, 255, 190)
    told = mavlink.MAVLink(None).decode(bytearray(frame.raw))
    assert ".".join(map(str, told.flight_sw_version.to_bytes(4, "big"))) == f"{__version__}.0"
    assert told.capabilities == 32 | 8192 | 131072 == CAPABILITIES
    assert (told.uid, told.vendor_id, told.board_version) == (0, 0, 0)


@pytest.mark.parametrize(("message_id", "extra"), [(BASIC, 50), (METADATA, 182)])
def test_the_checksums_of_messages_that_pymavlink_does_not_know(message_id, extra):
    """CRC_EXTRA as mavgen makes it of MAVLink's own common.xml."""
    station = Station()
    station.request(message_id)
    raw = station.run()[1][1].raw
    crc = x25crc(raw[1:-2])
    crc.accumulate(bytes((extra,)))
    assert raw[-2:] == crc.crc.to_bytes(2, "little")


@pytest.mark.parametrize("request_int", [False, True])
def test_the_metadata_lead_to_files_that_are_what_they_say(request_int):
    station = Station()
    if request_int:
        station.says(mavlink.MAVLink_command_int_message(1, 191, 0, 512, 0, 0, METADATA, 0, 0, 0, 0, 0, 0))
    else:
        station.request(METADATA)
    _, (_, frame) = station.run()
    _, crc, uri = metadata(frame)
    assert uri == "mftp:///general.json"
    general = download(station, uri)
    assert ftp.crc32(general) == crc
    told = json.loads(general)
    # The version of the layout of general metadata.
    assert told["version"] == 1
    assert (told["vendorName"], told["modelName"]) == ("DMUCA", "companion")
    assert told["firmwareVersion"] == __version__
    (parameter,) = told["metadataTypes"]
    assert parameter["type"] == 1
    content = download(station, parameter["uri"])
    assert ftp.crc32(content) == parameter["fileCrc"]
    assert [p["name"] for p in json.loads(content)["parameters"]] == list(NAMES)
    assert station.link.counts.information_refused == 0


def download(station, uri):
    station.ftp(4, uri.removeprefix("mftp://").encode())
    ((_, opened),) = station.run()
    size = int.from_bytes(opened.payload[15:19], "little")
    content = b""
    while len(content) < size:
        station.ftp(5, size=239, offset=len(content), seq=len(content))
        ((_, frame),) = station.run()
        assert frame.payload[:3] == bytes((0, 255, 190))
        content += frame.payload.ljust(254, b"\0")[15:][: frame.payload[7]]
    return content


@pytest.mark.parametrize(
    "config",
    [
        CONFIG,
        Config(
            identity=IdentityConfig(uas_id="OWN"),
            radio=CONFIG.radio,
            limits=LimitsConfig(max_speed_mps=12.0),
            avoidance=AvoidanceConfig(conflict_radius_m=60.0, horizon_s=4.0),
        ),
    ],
)
def test_the_ranges_that_are_told_are_those_that_are_kept(config):
    parameters = json.loads(metadata_files(config)["parameter.json"])["parameters"]
    assert [p["name"] for p in parameters] == list(NAMES)
    for told in parameters:
        assert told["type"] == "Float"
        assert told["shortDesc"]
        assert told["longDesc"]
        assert told["units"] in ("", "m", "s", "m/s")
        assert told["min"] <= told["default"] <= told["max"]
        name = told["name"]
        assert changed(name, told["default"], config, Settings()) == Settings()
        for value in (told["min"], told["max"]):
            changed(name, value, config, Settings())
        for value in (told["min"] - 0.1, told["max"] + 0.1):
            with pytest.raises(ConfigError, match="allowed"):
                changed(name, value, config, Settings())


def test_switching_off_is_told_as_a_choice_of_two():
    """A ground station shows the words instead of a number to type."""
    switch, *numbers = json.loads(metadata_files(CONFIG)["parameter.json"])["parameters"]
    assert {value["value"]: value["description"] for value in switch["values"]} == {
        0: "Watch only",
        1: "As configured",
    }
    assert (switch["min"], switch["max"], switch["decimalPlaces"], switch["increment"]) == (0, 1, 0, 1)
    for number in numbers:
        assert number["decimalPlaces"] == 1
        assert "values" not in number


def test_each_request_is_counted_once():
    station = Station()
    for count in (1, 2):
        station.request(METADATA)
        station.run()
        assert station.link.counts.information_requests == count


def test_what_there_is_not_is_refused_and_counted():
    station = Station()
    for number, code in ((1, UNSUPPORTED), (395, UNSUPPORTED), (148.5, DENIED), (math.nan, DENIED),
                         (math.inf, DENIED), (-1.0, DENIED), (1e30, UNSUPPORTED)):  # fmt: skip
        refused = station.link.counts.information_refused
        station.request(number)
        ((_, ack),) = station.run()
        assert result(ack)[0] == code
        assert station.link.counts.information_refused == refused + 1
    station.ftp(4, b"settings.json")
    station.ftp(7, b"\xff" * 200, size=255, seq=2)
    replies = [frame.payload for _, frame in station.run()]
    assert [(p[6], p[15]) for p in replies] == [(129, 10), (129, 3)]
    assert station.link.counts.information_refused == 9
    assert station.link.counts.bad_values == 0


@pytest.mark.parametrize("command", [0, 22, 176, 400, 519, 0xFFFF])
@pytest.mark.parametrize("as_int", [False, True])
def test_a_command_that_we_do_not_know_is_refused(command, as_int):
    station = Station()
    if as_int:
        station.says(mavlink.MAVLink_command_int_message(1, 191, 0, command, 0, 0, 1, 0, 0, 0, 0, 0, 0))
    else:
        # Its first parameter names no message here.
        station.request(VERSION, command=command)
    ((_, ack),) = station.run()
    assert ack.message_id == ACK
    assert result(ack, command) == (UNSUPPORTED, 255, 190)
    assert station.link.counts.information_refused == 1


def test_each_command_that_waits_is_refused_once():
    station = Station()
    for command in (400, 22, 400, 22, 400):
        station.request(1, command=command)
    station.request(VERSION)
    heard = station.run(1.0)
    assert ids(heard) == [ACK, ACK, ACK, VERSION]
    assert [result(heard[n][1], of)[0] for n, of in enumerate((400, 22))] == [UNSUPPORTED] * 2


@pytest.mark.parametrize("message_id", [BASIC, METADATA])
@pytest.mark.parametrize(("system", "component"), [(1, 0), (0, 0), (0, 191)])
def test_what_we_are_may_be_asked_of_everybody(message_id, system, component):
    station = Station()
    station.request(message_id, system, component)
    assert ids(station.run()) == [ACK, message_id]


def test_nobody_is_answered_for_another():
    station = Station()
    station.request(VERSION, component=0)
    station.request(VERSION, component=1)
    station.request(METADATA, component=1)
    station.request(METADATA, system=2)
    station.request(METADATA, system=2, component=0)
    station.request(1, component=0)
    # Arming is for whom it is sent to: for all, for the autopilot, for another aircraft.
    for system, component in ((0, 0), (1, 0), (0, 191), (1, 1), (2, 191)):
        station.request(1, system, component, command=400)
    station.ftp(4, b"general.json", component=1)
    station.ftp(4, b"general.json", component=0)
    station.ftp(4, b"general.json", system=2)
    # A reply that strayed here would be answered for ever.
    station.ftp(128, b"general.json")
    station.ftp(129, b"\x01")
    assert station.link.counts.foreign == 16
    assert station.link.counts.information_requests == 0
    assert station.run() == []


def test_our_own_vehicles_components_are_no_ground_station():
    station = Station()
    for component in (1, 154, 191):
        message = mavlink.MAVLink_command_long_message(1, 191, 512, 0, VERSION, 0, 0, 0, 0, 0, 0)
        station.says(message, 1, component)
    assert station.run() == []


def test_before_the_vehicle_is_known_nobody_is_answered():
    link = AutopilotLink(VehicleConfig(), information=ComponentInformation(CONFIG))
    message = mavlink.MAVLink_command_long_message(1, 191, 512, 0, VERSION, 0, 0, 0, 0, 0, 0)
    link.receive(MavlinkWriter(255, 190).pack(message), 0.0)
    link.advance(1.0)
    assert VERSION not in [f.message_id for f in FrameScanner().frames(link.drain())]
    assert link.counts.foreign == 1


def test_a_flood_is_answered_no_faster_and_fills_nothing():
    station, heard = Station(), []
    for turn in range(40):
        for number in range(50):
            station.request(number)
            station.ftp(4, b"general.json", seq=turn * 50 + number, component=191)
        heard += station.run(0.05)
    times = sorted({t for t, _ in heard})
    assert 10 < len(heard) <= 2.0 / PERIOD_S + 1
    assert min(b - a for a, b in itertools.pairwise(times)) >= PERIOD_S - 1e-6
    left = station.run(10.0)
    assert len(left) <= MOST_WAITING
    # And then it is as before.
    station.request(VERSION)
    assert ids(station.run()) == [ACK, VERSION]


def test_what_is_asked_again_while_it_waits_is_answered_once():
    station = Station()
    for _ in range(3):
        station.request(VERSION)
        station.ftp(4, b"general.json")
    assert ids(station.run(2.0)) == [ACK, VERSION, FTP]


def test_on_a_signed_link_unsigned_requests_are_dropped():
    station = Station(Signing(KEY, 1_000_000, 0.0))
    station.request(METADATA, signed=False)
    station.ftp(4, b"general.json", signed=False)
    station.request(1, command=400, signed=False)
    assert station.run() == []
    assert station.link.counts.information_requests == 0
    station.request(METADATA)
    station.ftp(4, b"general.json")
    heard = station.run()
    assert ids(heard) == [ACK, METADATA, FTP]
    ours = Signing(KEY, 2_000_000, 0.0)
    assert all(ours.refusal(frame) is None for _, frame in heard)
