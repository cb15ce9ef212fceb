"""Recorded flights through log reader and link, counted independently with pymavlink's own reader.

The three simulator recordings are kept (thinned) in `tests/data`. The full ones and three real-world logs lie
beside the checkout; where they are missing those tests are skipped.
"""

from __future__ import annotations

import gzip
import io
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from companion.autopilot.link import AutopilotLink
from companion.autopilot.lists.mission import path_from_mission
from companion.autopilot.tlog import TlogCounts, TlogWriter, read_tlog
from companion.autopilot.wire import FrameScanner
from companion.config import VehicleConfig
from companion.events import (
    CurrentMode,
    DownloadMission,
    Event,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    LocalPosition,
    MissionDownloaded,
    OperatorData,
    RemoteIdHeard,
    RemoteIdModule,
    VehicleTime,
)
from companion.remote_id.messages import OperatorId, SelfId
from tests.support.place import HOME

REPOSITORY = Path(__file__).parents[3]
THINNED = REPOSITORY / "tests" / "data"
FULL = REPOSITORY.parent / "shared" / "data" / "mavlink"

SIMULATED = ["ardupilot_sitl_guided", "ardupilot_sitl_odid_adsb", "px4_sih_offboard"]
REAL = ["dronekit_flight_replay", "uavlogviewer_vtol", "ardusub_multi_component"]
LOGS = [f"thinned/{n}" for n in SIMULATED] + [f"full/{n}" for n in SIMULATED + REAL]


@pytest.fixture(scope="module", params=LOGS)
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    kind, name = request.param.split("/")
    if kind == "full":
        path = FULL / f"{name}.tlog"
        if not path.exists():
            pytest.skip(f"{path} is not there: the full recordings are not part of the repository")
        return path
    return unpacked(name, tmp_path_factory.mktemp("log"))


def unpacked(name: str, folder: Path) -> Path:
    path = folder / f"{name}.tlog"
    with gzip.open(THINNED / f"{name}.tlog.gz") as packed, path.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    return path


def through_link(path: Path) -> tuple[AutopilotLink, list[Event], TlogCounts]:
    link = AutopilotLink(VehicleConfig())
    counts = TlogCounts()
    events: list[Event] = []
    with path.open("rb") as stream:
        for utc_s, raw in read_tlog(stream, path.name, counts):
            events += link.receive(raw, utc_s)
    return link, events, counts


def independent(path: Path) -> tuple[Counter[str], list[Any], int]:
    """Messages of the autopilot from its first heartbeat on, its positions, and damaged spans."""
    reader = mavutil.mavlink_connection(str(path), dialect="ardupilotmega", robust_parsing=True)
    counted: Counter[str] = Counter()
    positions = []
    damaged = 0
    while (message := reader.recv_msg()) is not None:
        kind = message.get_type()
        damaged += kind == "BAD_DATA"
        if kind == "BAD_DATA" or (message.get_srcSystem(), message.get_srcComponent()) != (1, 1):
            continue
        if kind != "HEARTBEAT" and "HEARTBEAT" not in counted:
            continue
        counted[kind] += 1
        if kind == "GLOBAL_POSITION_INT":
            positions.append(message)
    return counted, positions, damaged


def test_every_message_becomes_the_event_that_it_should(log: Path) -> None:
    link, events, counts = through_link(log)
    counted, positions, damaged = independent(log)
    got = Counter(type(e) for e in events)
    known = [p for p in positions if (p.lat, p.lon) != (0, 0)]
    assert got[GlobalPosition] == len(known) > 300
    assert link.counts.no_position == len(positions) - len(known)
    assert got[Heartbeat] == counted["HEARTBEAT"]
    assert got[GnssFix] == counted["GPS_RAW_INT"]
    assert got[LocalPosition] == counted["LOCAL_POSITION_NED"]
    assert got[VehicleTime] == counted["SYSTEM_TIME"]
    assert link.counts.bad_values == 0
    assert counts.corrupt_spans == damaged

    own = [e for e in events if isinstance(e, GlobalPosition)]
    for event, message in ((own[0], known[0]), (own[-1], known[-1])):
        assert event.lat_deg == pytest.approx(message.lat / 1e7)
        assert event.lon_deg == pytest.approx(message.lon / 1e7)
        assert event.alt_msl_m == pytest.approx(message.alt / 1e3)
        assert event.time_boot_s == pytest.approx(message.time_boot_ms / 1e3)
        assert event.velocity_ned_mps == pytest.approx((message.vx / 100, message.vy / 100, message.vz / 100))


def test_a_tail_cut_anywhere_loses_one_record_at_most(log: Path) -> None:
    data = log.read_bytes()
    # A log that begins in the middle of a record is as good a log, and quicker to read.
    tail = data[-6_000:]
    whole = [raw for _, raw in read_tlog(io.BytesIO(tail), log.name)]
    for cut in range(1, 2048, 7):
        got = [raw for _, raw in read_tlog(io.BytesIO(tail[:-cut]), log.name)]
        assert got == whole[: len(got)]
        lost = sum(8 + len(raw) for raw in whole[len(got) :])
        assert lost < cut + 8 + 280


def test_reading_in_pieces_or_at_once_is_the_same(log: Path) -> None:
    with log.open("rb") as stream:
        frames = [raw for _, raw in read_tlog(stream, log.name)][:3000]
    once = FrameScanner(keep_unknown=True).frames(b"".join(frames) + frames[0])
    scanner = FrameScanner(keep_unknown=True)
    data = b"".join(frames) + frames[0]
    pieces = [f for at in range(0, len(data), 97) for f in scanner.frames(data[at : at + 97])]
    assert [f.raw for f in pieces] == [f.raw for f in once] == [*frames, frames[0]]


@pytest.mark.parametrize("name", SIMULATED)
def test_what_our_writer_writes_pymavlink_reads(name: str, tmp_path: Path) -> None:
    path = unpacked(name, tmp_path)
    copy = tmp_path / "copy.tlog"
    with path.open("rb") as stream, copy.open("wb") as out:
        writer = TlogWriter(out)
        for utc_s, raw in read_tlog(stream, name):
            writer.received(utc_s, raw)
    assert copy.read_bytes() == path.read_bytes()
    assert independent(copy)[0] == independent(path)[0]


def test_modes_of_the_recorded_flights(tmp_path: Path) -> None:
    for name in ("ardupilot_sitl_guided", "px4_sih_offboard"):
        _, events, _ = through_link(unpacked(name, tmp_path))
        modes = {e.mode for e in events if isinstance(e, Heartbeat) and e.armed}
        assert modes | {FlightMode.STICKS} == set(FlightMode)


def test_the_reboot_in_the_recording_is_seen(tmp_path: Path) -> None:
    link, _, _ = through_link(unpacked("ardupilot_sitl_odid_adsb", tmp_path))
    assert link.counts.reboots == 1


@pytest.mark.parametrize("name", ["ardupilot_sitl_guided", "px4_sih_offboard"])
def test_the_recorded_mission_download_is_understood(name: str, tmp_path: Path) -> None:
    """The vehicle's recorded answers, with our own questions in the place of the recorded ones."""
    link = AutopilotLink(VehicleConfig())
    missions = []
    with unpacked(name, tmp_path).open("rb") as stream:
        for utc_s, raw in read_tlog(stream, name):
            if raw[7] == 44 and raw[6] == 1:
                link.send(DownloadMission(), utc_s)
            missions += [e for e in link.receive(raw, utc_s) if isinstance(e, MissionDownloaded)]
    (mission,) = missions
    assert len(mission.items) == 4
    path = path_from_mission(
        mission.items,
        speed_mps=5.0,
        max_climb_mps=2.0,
        max_descent_mps=2.0,
        start=(HOME.lat_deg, HOME.lon_deg, 30.0),
        home_alt_msl_m=400.0,
    )
    assert len(path.waypoint) >= 2


def test_remote_id_that_ardupilot_was_fed_and_relayed(tmp_path: Path) -> None:
    """A transmitter at 236 says that it is ready, and feeds identities and a take-off point without time."""
    path = unpacked("ardupilot_sitl_odid_adsb", tmp_path)
    link, events, _ = through_link(path)
    reader = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    sent: Counter[tuple[int, str]] = Counter()
    while (message := reader.recv_msg()) is not None:
        sent[message.get_srcComponent(), message.get_type()] += 1
    modules = [e for e in events if isinstance(e, RemoteIdModule)]
    assert modules == [RemoteIdModule(component_id=236, ready=True)] * sent[236, "OPEN_DRONE_ID_ARM_STATUS"]
    assert len(modules) > 20
    told = [m for e in events if isinstance(e, OperatorData) for m in e.messages]
    assert Counter(type(m) for m in told) == {
        SelfId: sent[1, "OPEN_DRONE_ID_SELF_ID"],
        OperatorId: sent[1, "OPEN_DRONE_ID_OPERATOR_ID"],
    }
    assert told[-1] in (
        SelfId(description_type=0, text="sitl test"),
        OperatorId(operator_id_type=0, operator_id="FIN87astrdge12k8"),
    )
    assert not any(isinstance(e, RemoteIdHeard) for e in events)
    assert link.counts.bad_values == 0


def test_px4s_own_remote_id_is_no_operator(tmp_path: Path) -> None:
    link, events, _ = through_link(unpacked("px4_sih_offboard", tmp_path))
    assert not any(isinstance(e, OperatorData | RemoteIdHeard | RemoteIdModule) for e in events)
    assert link.counts.bad_values == 0


@pytest.mark.parametrize(
    ("name", "word"), [("uavlogviewer_vtol", "fixed-wing"), ("ardusub_multi_component", "submarine")]
)
def test_vehicles_that_are_not_flown_say_so(name: str, word: str) -> None:
    path = FULL / f"{name}.tlog"
    if not path.exists():
        pytest.skip(f"{path} is not there: the full recordings are not part of the repository")
    link, events, _ = through_link(path)
    assert link.vehicle is not None
    assert word in str(link.vehicle.refusal)
    assert {e.mode for e in events if isinstance(e, Heartbeat)} == {FlightMode.OTHER}


def test_px4s_current_mode_is_that_of_its_heartbeats(tmp_path: Path) -> None:
    """Every 2 s, as nobody asked for it: it agrees with the heartbeat before it, or the next one."""
    _, events, _ = through_link(unpacked("px4_sih_offboard", tmp_path))
    told = [e for e in events if isinstance(e, CurrentMode | Heartbeat)]
    found = [k for k, e in enumerate(told) if isinstance(e, CurrentMode)]
    assert len(found) > 50
    for k in found:
        assert told[k].custom_mode in {told[k - 1].custom_mode, told[min(k + 1, len(told) - 1)].custom_mode}


def test_px4_tells_that_a_failsafe_acts(tmp_path: Path) -> None:
    """In the recording setpoints stop again and again, and PX4 returns until they resume."""
    _, events, _ = through_link(unpacked("px4_sih_offboard", tmp_path))
    beats = [e for e in events if isinstance(e, Heartbeat)]
    acting = {(e.custom_mode, e.failsafe) for e in beats if e.armed}
    assert (5 << 24 | 4 << 16, True) in acting
    assert {custom for custom, failsafe in acting if failsafe} == {5 << 24 | 4 << 16}
    assert any(not e.failsafe and e.mode is FlightMode.EXTERNAL for e in beats)
