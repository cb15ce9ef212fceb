"""In real time, each a process of its own: one guarded on its mission and one flown on a path meet head-on,
and an intruder behind sees nobody. Each firmware's manners are guarded once and flown once.

They meet near each other, with a small radius and a short way back, so that the encounter takes about 13 s: a
stall of the machine ends it, and then it is flown again. The defaults are flown in virtual time, by
`tests/sitl_mocks/with_companion/test_guard.py`."""

from __future__ import annotations

import re
import socket
import threading
import time

import numpy as np
import pytest

from companion.autopilot.wire import MavlinkReader, MavlinkWriter
from companion.radio.ether.ether_radio import EtherTransport
from companion.radio.frames_io import radio_address
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from tests.integration.conftest import again_after_a_stall, wait_for_the_end_of_a_stall
from tests.support.place import HOME

GEOID_M = 47.0
RADIUS_M = 2.5
CONFIG = """
[identity]
uas_id = "{name}"
[vehicle]
link = "udpout:127.0.0.1:{port}"
wait_s = 30.0
[flight]
take_in_flight = true
{flight}
[limits]
max_speed_mps = 8.0
max_acceleration_mps2 = 4.0
[avoidance]
conflict_radius_m = {radius_m}
recovery_time_s = 2.0
n_noncollide = 5
[remote_id]
transports = ["wifi"]
rate = 2
[[radio]]
backend = "ether"
address = "{ether}"
[record]
folder = "{folder}"
name = "{name}"
"""


def place(north_m, east_m):
    lat_deg, lon_deg, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    return lat_deg, lon_deg


class Station:
    """A ground station on the vehicle's second link."""

    def __init__(self, port):
        self.writer, self.reader = MavlinkWriter(255, 190), MavlinkReader()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(0.2)
        self.say(lambda e: e.heartbeat_encode(6, 8, 0, 0, 4))

    def say(self, pack):
        self.socket.send(self.writer.pack(pack(self.writer.encoder)))

    def upload(self, system_id, points, home_first):
        items = [(16, 0.0, 0.0, 400.0)] if home_first else []
        items += [(22, *points[0])] + [(16, *point) for point in points]
        self.say(lambda e: e.mission_count_encode(system_id, 1, len(items), 0))
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            try:
                messages = self.reader.feed(self.socket.recv(65536))
            except TimeoutError:
                continue
            for message in messages:
                if message.get_type() == "MISSION_ACK":
                    assert message.type == 0
                    return
                if message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    self.answer(system_id, message.seq, *items[message.seq])
        raise AssertionError("the mission was not taken")

    def answer(self, system_id, seq, command, north_m, east_m, height_m):
        x, y = (round(value * 1e7) for value in place(north_m, east_m))
        self.say(
            lambda e: e.mission_item_int_encode(
                system_id, 1, seq, 6, command, 0, 1, 0, 0, 0, 0, x, y, height_m, 0
            )
        )

    def select(self, system_id, mode, sub):
        self.say(lambda e: e.command_long_encode(system_id, 1, 176, 0, 1.0, mode, sub, 0, 0, 0, 0))


class Intruder(threading.Thread):
    """Flies south on a line of its own, says so twice a second, and sees nobody."""

    def __init__(self, ether):
        super().__init__(daemon=True)
        self.radio = EtherTransport(ether, "INTRUDER", radio_address("INTRUDER"))
        self.places = []
        self.ended = threading.Event()

    def run(self):
        began = time.monotonic()
        while not self.ended.wait(0.1):
            passed, utc_s = time.monotonic() - began, time.time()
            north, east = 38.0 - 4.0 * passed, 0.0
            self.places.append((utc_s, north, east, -50.0))
            if len(self.places) % 5 == 0:
                lat_deg, lon_deg = place(north, east)
                location = Location(
                    status=Status.AIRBORNE, lat_deg=lat_deg, lon_deg=lon_deg,
                    alt_geodetic_m=450.0 + GEOID_M, direction_deg=180.0, speed_mps=4.0,
                    vertical_speed_mps=0.0, horizontal_accuracy_m=1.0, vertical_accuracy_m=1.0,
                    speed_accuracy_mps=0.3, timestamp_s=round(utc_s % 3600.0, 1),
                )  # fmt: skip
                name = BasicId(
                    id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="INTRUDER"
                )
                self.radio.broadcast("wifi", (name, location), time.monotonic())
            self.radio.heard(time.monotonic())

    def close(self):
        self.ended.set()
        if self.ident is not None:
            self.join(60.0)
        self.radio.close()


def vehicle(start, tmp_path, name, firmware, system_id, north_m, *more):
    """A vehicle in a mode from which no companion takes it."""
    child = start(
        "sitl_mocks.cli", "serve", "--firmware", firmware, "--airborne", "50", "--start", str(north_m), "0",
        "--system-id", str(system_id), "--mode", "manual", *more,
        "--link", "udpin:127.0.0.1:0", "--link", "udpin:127.0.0.1:0", "--truth", tmp_path / f"{name}.csv",
    )  # fmt: skip
    child.wait_for("ready")
    return child, [int(p) for p in re.findall(r"link udpin:127\.0\.0\.1:(\d+)", child.output)]


def least(one, other):
    """Least distance (m) of two flights, rows of UTC, north, east, down."""
    times = one[(one[:, 0] > other[0, 0]) & (one[:, 0] < other[-1, 0])]
    there = np.column_stack([np.interp(times[:, 0], other[:, 0], other[:, c]) for c in (1, 2, 3)])
    return float(np.linalg.norm(times[:, 1:] - there, axis=1).min())


def select(station, system_id, mode, companion, until):
    """Select a mode until the companion acts on it: PX4 accepts a mission's mode right after the upload, and
    does not enter it."""
    for _ in range(20):
        station.select(system_id, *mode)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            if until in companion.output:
                return
            companion.check_stall()
            time.sleep(0.05)
    companion.wait_for(until)


@pytest.mark.parametrize("guarded", ["ardupilot", "px4"])
@again_after_a_stall
def test_head_on_with_one_that_cooperates_and_one_that_does_not(start, tmp_path, guarded):
    flown = "px4" if guarded == "ardupilot" else "ardupilot"
    air = start("sitl_mocks.cli", "ether", "--listen", "127.0.0.1:0", "--delay", "0.2", "0.8")
    ether = air.wait_for(r"ether on (\S+)").group(1)
    slow = "WPNAV_SPEED=100" if guarded == "ardupilot" else "MPC_XY_CRUISE=1"
    vehicle_a, (port_a, station_a) = vehicle(start, tmp_path, "a", guarded, 1, 0.0, "--param", slow)
    vehicle_b, (port_b, station_b) = vehicle(start, tmp_path, "b", flown, 2, 22.0)
    lines = ['altitude = "home"', "waypoint = ["]
    for t_s, north_m in ((0.0, 22.0), (100.0, -378.0)):
        lat_deg, lon_deg = place(north_m, 0.0)
        lines.append(f"  {{ t_s = {t_s}, lat_deg = {lat_deg}, lon_deg = {lon_deg}, alt_m = 50.0 }},")
    (tmp_path / "t.toml").write_text("\n".join([*lines, "]"]))
    uses = {"A": (port_a, 'use = "guard"'), "B": (port_b, 'use = "fly"\ntrajectory = "t.toml"')}
    companions = {}
    for name, (port, flight) in uses.items():
        path = tmp_path / f"{name}.toml"
        path.write_text(
            CONFIG.format(
                name=name, port=port, flight=flight, ether=ether, folder=tmp_path / "runs", radius_m=RADIUS_M
            )
        )
        companions[name] = start("companion.commands.cli", "run", "--config", path)
        companions[name].must_not_stall = True
    a, b = companions["A"], companions["B"]
    intruder = Intruder(ether)
    stations = [Station(station_a), Station(station_b)]
    try:
        stations[0].upload(1, [(0.0, 0.0, 50.0), (1500.0, 0.0, 50.0)], guarded == "ardupilot")
        for companion in (a, b):
            companion.wait_for("the companion takes control only from")
        if start.again:
            wait_for_the_end_of_a_stall()
        select(stations[0], 1, (3.0, 0.0) if guarded == "ardupilot" else (4.0, 4.0), a, "standby -> watching")
        select(stations[1], 2, (4.0, 0.0) if flown == "ardupilot" else (4.0, 3.0), b, "standby -> guarding")
        intruder.start()
        a.wait_for("watching -> avoiding: conflict with")
        a.wait_for("avoiding -> recovering")
        a.wait_for("recovering -> guarding")
        back = a.wait_for(
            r"guarding -> watching: mission resumed at item (\d+) after (\d+) s under companion control, "
            r"at most (\d+) m off"
        )
        item, seconds, off_m = map(int, back.groups())
        assert item == (3 if guarded == "ardupilot" else 2)
        assert 5 < seconds < 120
        assert 3 < off_m < 60
        b.wait_for("guarding -> avoiding")
    finally:
        for station in stations:
            station.socket.close()
        intruder.close()
    for ended in (a, b, vehicle_a, vehicle_b):  # the vehicles write their last positions
        assert ended.end() == 0
    a, b = (np.loadtxt(tmp_path / f"{n}.csv", delimiter=",", skiprows=1) for n in ("a", "b"))
    c = np.array(intruder.places)
    assert least(a, b) > 2.0 * RADIUS_M
    assert least(a, c) > 2.0 * RADIUS_M
    assert least(b, c) > 2.0 * RADIUS_M
