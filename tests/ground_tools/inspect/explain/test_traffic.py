"""Aircraft that came near are reported for every kind of log: in figures, tables and the first lines."""

from __future__ import annotations

import gzip
import json
import math
import shutil
import struct
import tracemalloc
from pathlib import Path

import msgspec
import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Config, FlightConfig, IdentityConfig
from companion.event_record import Step
from companion.events import AdsbVehicle, AuthorityChanged, GnssFix, Landed, LandedState, RemoteIdHeard
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from ground_tools.inspect.explain import traffic
from ground_tools.inspect.export import tables
from ground_tools.inspect.read import nearness
from ground_tools.inspect.read.flown import flown
from ground_tools.inspect.read.nearness import ADSB_STAMP_S
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import headline, terminal
from ground_tools.inspect.report.page import page
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.flights import decision, step, track, write
from tests.support.place import HOME

M_PER_DEG = 111_195.0
"""Length of a degree of latitude (m) on a sphere, accurate to a third of a percent."""
DATA = Path(__file__).parents[3] / "data"
ONE = Config(identity=IdentityConfig(uas_id="ONE", icao="4B1234"))


def unpacked(folder: Path) -> Path:
    """The log of a simulated ArduPilot with ADS-B traffic."""
    path = folder / "ardupilot_sitl_odid_adsb.tlog"
    with gzip.open(DATA / f"{path.name}.gz") as packed, path.open("wb") as plain:
        shutil.copyfileobj(packed, plain)
    return path


def adsb(north_m: float, east_m: float, up_m: float | None, **over) -> AdsbVehicle:
    """An ADS-B report, by the position relative to that of `step` at 0 s, which is 50 m above home."""
    lat, lon, alt = HOME.to_geodetic(north_m, east_m, -50.0 - (up_m or 0.0))
    values = {"icao": 0x4CA123, "lat_deg": lat, "lon_deg": lon, "alt_m": None if up_m is None else alt}
    return AdsbVehicle(**(values | {"callsign": "EI1  "} | over))


def remote_id(name: str, north_m: float, east_m: float, *, alt_m: float | None = 450.0) -> RemoteIdHeard:
    lat, lon, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    who = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=name)
    where = Location(lat_deg=lat, lon_deg=lon, alt_geodetic_m=alt_m)
    return RemoteIdHeard(
        transport="wifi", address=f"02:{name}", counter=1, rssi_dbm=-60, messages=(who, where)
    )


def beside(now_s: float, north_m: float, east_m: float) -> Step:
    """As `step`, at another place."""
    lat, lon, _ = HOME.to_geodetic(north_m, east_m, 0.0)
    (place,) = step(now_s).events
    return Step(now_s=now_s, events=(msgspec.structs.replace(place, lat_deg=lat, lon_deg=lon),), commands=())


def heard(folder: Path, *events, config: Config = ONE):
    """Rows of the traffic that ONE received, with one event per second from 0 s."""
    steps = [step(float(k), events=(event,)) for k, event in enumerate(events)]
    write(folder, config, [*steps, step(float(len(steps)))])
    return describe(read_run(folder))


def test_an_adsb_aircraft_is_reported_with_distance_and_time(tmp_path):
    figures = heard(tmp_path, adsb(500.0, 0.0, 300.0), adsb(0.0, 190.0, 214.0), adsb(0.0, 900.0, 214.0))
    (row,) = figures["aircraft"][0]["traffic"]
    assert (row["identity"], row["callsign"], row["by"], row["messages"]) == ("4CA123", "EI1", "ADS-B", 3)
    near = row["nearest"]
    assert near["time_s"] == 1.0
    assert near["aside_m"] == pytest.approx(190.0, abs=1.0)
    assert near["above_m"] == pytest.approx(214.0, abs=0.5)
    assert near["slant_m"] == pytest.approx(286.2, abs=1.0)
    (first, *_) = headline.verdicts(figures)
    assert first == (
        "Nearest other aircraft: 4CA123 (EI1), 190 m beside ONE and 214 m above it by barometric altitude at "
        "1.0 s (ADS-B, as reported); no other was heard"
    )
    text = terminal.text(figures)
    assert "Other aircraft that were heard" in text
    assert "214 baro" in text
    assert json.loads(json.dumps(figures)) == figures


def test_a_report_is_extrapolated_over_its_age(tmp_path):
    event = adsb(0.0, 1000.0, 100.0, age_s=2.0, velocity_ned_mps=(0.0, -100.0, 0.0), alt_geometric=True)
    (row,) = heard(tmp_path, event)["aircraft"][0]["traffic"]
    assert row["nearest"]["aside_m"] == pytest.approx(1000.0 - 100.0 * (2.0 + ADSB_STAMP_S), abs=2.0)
    assert not row["nearest"]["barometric"]


def test_a_geometric_altitude_is_compared_above_the_ellipsoid(tmp_path):
    gnss = GnssFix(
        fix_type=3, lat_deg=HOME.lat_deg, lon_deg=HOME.lon_deg, alt_msl_m=450.0, alt_ellipsoid_m=498.0
    )
    figures = heard(tmp_path, gnss, adsb(0.0, 100.0, 48.0, alt_geometric=True))
    assert figures["aircraft"][0]["traffic"][0]["nearest"]["above_m"] == pytest.approx(0.0, abs=0.5)


def test_a_geometric_altitude_is_not_compared_while_the_undulation_is_unknown(tmp_path):
    """Heights above the ellipsoid and above mean sea level differ by 48 m here."""
    figures = heard(tmp_path, adsb(0.0, 100.0, 48.0, alt_geometric=True))
    near = figures["aircraft"][0]["traffic"][0]["nearest"]
    assert near["above_m"] is None
    assert near["slant_m"] == pytest.approx(100.0, abs=0.5)
    assert "at an unknown height" in headline.verdicts(figures)[0]


@pytest.mark.parametrize(("fix_type", "ellipsoid_m"), [(3, 5450.0), (2, 498.0)])
def test_an_ellipsoidal_altitude_that_cannot_be_true_is_not_used(tmp_path, fix_type, ellipsoid_m):
    gnss = GnssFix(
        fix_type=fix_type,
        lat_deg=HOME.lat_deg,
        lon_deg=HOME.lon_deg,
        alt_msl_m=450.0,
        alt_ellipsoid_m=ellipsoid_m,
    )
    figures = heard(tmp_path, gnss, adsb(0.0, 100.0, 48.0, alt_geometric=True))
    assert figures["aircraft"][0]["traffic"][0]["nearest"]["above_m"] is None


def test_the_own_transponder_and_the_own_remote_id_are_no_traffic(tmp_path):
    figures = heard(tmp_path, adsb(0.0, 0.0, 0.0, icao=0x4B1234), remote_id("ONE", 0.0, 0.0))
    assert figures["aircraft"][0]["traffic"] == []
    assert headline.verdicts(figures)[0] == "Other aircraft: none was heard"


FOREIGN = "Identity used by ANOTHER sender, from elsewhere: "


def test_who_sends_our_identity_from_elsewhere_is_in_the_first_lines(tmp_path):
    """ONE flies north at 5 m/s and hears itself, while another sender of its identity comes to 60 m."""
    foreign = [remote_id("ONE", 5.0 * k, 60.0 + 40.0 * abs(12 - k), alt_m=480.0) for k in range(20)]
    foreign = [msgspec.structs.replace(one, address="02:foreign") for one in foreign]
    steps = [step(float(k), events=(remote_id("ONE", 5.0 * k, 0.0), foreign[k])) for k in range(20)]
    write(tmp_path, ONE, steps)
    figures = describe(read_run(tmp_path))
    (row,) = figures["aircraft"][0]["traffic"]
    assert (row["identity"], row["elsewhere"], row["messages"]) == ("ONE", True, 20)
    nearest, line, *_ = headline.verdicts(figures)
    assert nearest.startswith("Nearest other aircraft: ONE, sent from elsewhere, 60 m beside ONE")
    assert line.startswith(f"{FOREIGN}ONE; nearest: ONE, sent from elsewhere, 60 m beside ONE")
    assert headline.is_bad(line)
    assert "elsewhere" in terminal.text(figures).partition("Other aircraft that were heard")[2]


@pytest.mark.parametrize(("seconds", "told"), [(2, False), (3, True)])
def test_a_moment_of_an_old_position_is_no_foreign_sender(tmp_path, seconds, told):
    figures = heard(tmp_path, *[remote_id("ONE", 0.0, 500.0)] * seconds)
    assert any(line.startswith(FOREIGN) for line in headline.verdicts(figures)) is told


def test_who_sends_the_identity_of_a_partner_from_elsewhere_is_not_the_partner(tmp_path):
    two = [remote_id("TWO", 5.0 * k, 45.0) for k in range(20)]
    foreign = [remote_id("TWO", 5.0 * k, 250.0 + 10.0 * k) for k in range(20)]
    foreign = [msgspec.structs.replace(one, address="02:foreign") for one in foreign]
    write(tmp_path, ONE, [step(float(k), events=(two[k], foreign[k])) for k in range(20)])
    own = [beside(float(k), 5.0 * k, 40.0) for k in range(20)]
    write(tmp_path, Config(identity=IdentityConfig(uas_id="TWO")), own)
    figures = describe(read_run(tmp_path))
    rows = figures["aircraft"][0]["traffic"]
    assert [(row["elsewhere"], row["of_the_run"], row["messages"]) for row in rows] == [
        (False, True, 20),
        (True, True, 20),
    ]
    assert [row["nearest"]["aside_m"] for row in rows] == pytest.approx([45.0, 250.0], abs=1.0)
    lines = headline.verdicts(figures)
    assert any(line.startswith(f"{FOREIGN}TWO; nearest: TWO, sent from elsewhere, 250 m") for line in lines)
    # The partner itself is a pair, and no other aircraft.
    assert "Nearest other aircraft: TWO, sent from elsewhere, 250 m beside ONE" in "".join(lines)


def test_an_unknown_height_is_reported(tmp_path):
    figures = heard(tmp_path, adsb(0.0, 80.0, None), remote_id("TWO", 0.0, 300.0, alt_m=None))
    rows = figures["aircraft"][0]["traffic"]
    assert [row["identity"] for row in rows] == ["4CA123", "TWO"]
    assert rows[0]["nearest"]["above_m"] is None
    assert "80 m beside ONE, at an unknown height, at" in headline.verdicts(figures)[0]
    assert headline.verdicts(figures)[0].endswith("2 other aircraft in all")


def test_of_too_many_aircraft_the_nearest_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(nearness, "_MOST", 5)
    far = [adsb(0.0, 2000.0 + k, 300.0, icao=k) for k in range(9)]
    near = [adsb(0.0, 20.0, 5.0, icao=0xABCDEF), adsb(0.0, 90.0, 5.0, icao=0xABCDE0)]
    figures = heard(tmp_path, *far, *near, adsb(0.0, 3000.0, 300.0, icao=0xFFFFFF))
    (one,) = figures["aircraft"]
    names = [row["identity"] for row in one["traffic"]]
    assert names[:2] == ["ABCDEF", "ABCDE0"]
    assert len(names) == 5
    assert headline.verdicts(figures)[0].startswith("Nearest other aircraft: ABCDEF")
    (words,) = [words for words in one["missing"] if "ADS-B" in words]
    assert words.startswith("7 ADS-B reports are left out")


def test_of_too_many_remote_id_addresses_the_nearest_are_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(nearness, "_MOST", 5)
    far = [remote_id(f"FAR{k}", 0.0, 2000.0 + k) for k in range(9)]
    near = [remote_id("NEAR", 45.0, 20.0), remote_id("NEXT", 50.0, 90.0)]
    write(
        tmp_path,
        ONE,
        [step(float(k), events=(event,)) for k, event in enumerate([*far, *near, far[3], near[0]])],
    )
    run = read_run(tmp_path)
    figures = describe(run)
    (one,) = figures["aircraft"]
    names = [row["identity"] for row in one["traffic"]]
    assert names[:2] == ["NEAR", "NEXT"]
    assert len(names) == len(one["remote_id"]["heard"]) == 5
    assert one["heard"] == 13
    (words,) = [words for words in one["missing"] if "frames of Remote ID" in words]
    assert words.startswith("7 frames of Remote ID are left out: there were more than 5 radio addresses")
    # What is left out is still in the tables, by its address.
    blocks = tables.tracks(run, flown(run))
    heard_names = {name for block in blocks for name in block["name"]}
    assert {"NEAR", "02:FAR5"} <= heard_names


@pytest.mark.parametrize(
    ("spans", "nearest_s"),
    [
        ((), 1.0),  # it flies throughout
        (((1.0, 2.0),), 3.0),  # both ends of a span count as on the ground
        (((0.0, 1.0), (1.0, 2.5), (2.9, math.inf)), None),  # it never flies, and the nearest one counts
        (((0.0, 1.5), (2.5, 3.0)), 2.0),
    ],
)
def test_the_nearest_in_flight_counts(spans, nearest_s):
    near = np.array([[1.0, 10.0, 10.0, 0.0], [2.0, 30.0, 30.0, 0.0], [3.0, 20.0, 20.0, 0.0]])
    found = traffic._nearest(near, np.array(spans).reshape(-1, 2), barometric=False)
    assert found["time_s"] == (1.0 if nearest_s is None else nearest_s)


def test_thousands_of_flights_with_traffic_need_little_memory():
    """A table of all times and all spans is 40 MB, and was made twice."""
    near = np.column_stack([np.arange(20_000.0), *np.ones((3, 20_000))])
    ground = np.arange(0.0, 20_000.0, 5.0).reshape(-1, 2)
    tracemalloc.start()
    traffic._nearest(near, ground, barometric=False)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 4e6


def test_without_own_positions_distances_are_unknown(tmp_path):
    steps = [Step(now_s=float(k), events=(adsb(0.0, 80.0, 10.0),), commands=()) for k in range(5)]
    write(tmp_path, ONE, steps)
    figures = describe(read_run(tmp_path))
    assert figures["aircraft"][0]["traffic"][0]["nearest"] is None
    assert "Other aircraft: 1 heard; how near they came is not known" in headline.verdicts(figures)


def test_aircraft_of_the_run_are_reported_as_pairs(tmp_path):
    write(tmp_path, ONE, [step(0.0, events=(remote_id("TWO", 0.0, 30.0),)), step(1.0)])
    write(tmp_path, Config(identity=IdentityConfig(uas_id="TWO")), [step(0.0), step(1.0)])
    figures = describe(read_run(tmp_path))
    assert [row["of_the_run"] for row in figures["aircraft"][0]["traffic"]] == [True]
    assert "Other aircraft: none was heard beside those of the run" in headline.verdicts(figures)
    assert "Other aircraft that were heard" not in terminal.text(figures)


@pytest.mark.parametrize(("recorded_s", "told"), [(6, True), (40, False)])
def test_an_aircraft_that_came_near_after_its_record_was_cut_off_is_told(tmp_path, recorded_s, told):
    """TWO crosses the way of ONE, which flies north at 5 m/s, 20 m beside it at 30 s."""
    places = [(5.0 * k, 20.0 + 30.0 * abs(30 - k)) for k in range(40)]
    write(tmp_path, ONE, [step(float(k), events=(remote_id("TWO", *at),)) for k, at in enumerate(places)])
    own = [beside(float(k), *places[k]) for k in range(recorded_s)]
    write(tmp_path, Config(identity=IdentityConfig(uas_id="TWO")), own)
    figures = describe(read_run(tmp_path))
    (row,) = figures["aircraft"][0]["traffic"]
    assert (row["of_the_run"], row["beyond_record"]) == (True, told)
    line = next(line for line in headline.verdicts(figures) if "ther aircraft" in line)
    assert line.startswith("Nearest other aircraft: TWO, 20 m beside ONE") is told
    assert ("Other aircraft that were heard" in terminal.text(figures)) is told


@pytest.mark.parametrize("flies", [True, False])
def test_who_stands_beside_at_the_start_does_not_hide_who_comes_near_in_flight(tmp_path, flies):
    steps = []
    for k in range(60):
        where = LandedState(landed=Landed.IN_AIR if flies and k >= 10 else Landed.ON_GROUND)
        beside = remote_id("BESIDE", 5.0 * k, 3.0) if k < 10 else remote_id("BESIDE", 0.0, 800.0)
        near = remote_id("NEAR", 5.0 * k, 12.0 + 20.0 * abs(40 - k))
        steps.append(step(float(k), events=(where, beside, near)))
    write(tmp_path, ONE, steps)
    line = headline.verdicts(describe(read_run(tmp_path)))[0]
    assert line.startswith(f"Nearest other aircraft: {'NEAR, 12' if flies else 'BESIDE, 3'} m beside ONE")


def test_an_aircraft_that_is_heard_after_both_have_landed_came_not_near(tmp_path):
    landed = LandedState(landed=Landed.ON_GROUND)
    steps = [step(float(k)) for k in range(10)]
    steps += [step(float(k), events=(landed, remote_id("TWO", 5.0 * k, 3.0))) for k in range(10, 20)]
    write(tmp_path, ONE, steps)
    write(tmp_path, Config(identity=IdentityConfig(uas_id="TWO")), [step(float(k)) for k in range(9)])
    (row,) = describe(read_run(tmp_path))["aircraft"][0]["traffic"]
    assert row["nearest"]["slant_m"] == pytest.approx(3.0, abs=0.5)
    assert not row["beyond_record"]


def frame_of(mav, message, boot_s):
    """A message as an entry of a .tlog."""
    return struct.pack(">Q", round((1.8e9 + boot_s) * 1e6)) + message.pack(mav)


@pytest.mark.parametrize(
    ("alt_type", "alt_mm", "above_m", "words"),
    [
        (mavlink.ADSB_ALTITUDE_TYPE_PRESSURE_QNH, 210_000, -240.0, "240 m below it by barometric altitude"),
        (mavlink.ADSB_ALTITUDE_TYPE_PRESSURE_QNH, 650_000, 200.0, "200 m above it by barometric altitude"),
        (mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC, 698_000, 200.0, "200 m above it at"),
    ],
)
def test_altitudes_of_messages_are_compared_in_their_own_datum(tmp_path, alt_type, alt_mm, above_m, words):
    """The own aircraft is 50 m above home, 450 m above mean sea level and 498 m above the ellipsoid."""
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    lat, lon = round(HOME.lat_deg * 1e7), round(HOME.lon_deg * 1e7)
    east = round(HOME.to_geodetic(0.0, 190.0, 0.0)[1] * 1e7)
    flags = mavlink.ADSB_FLAGS_VALID_COORDS | mavlink.ADSB_FLAGS_VALID_ALTITUDE
    entries = []
    for k in range(20):
        beat = mavlink.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)
        fix = mavlink.MAVLink_gps_raw_int_message(
            k * 500_000, 3, lat, lon, 450_000, 100, 100, 0, 0, 12, 498_000, 300, 300, 100
        )
        own = mavlink.MAVLink_global_position_int_message(k * 500, lat, lon, 450_000, 50_000, 0, 0, 0, 0)
        other = mavlink.MAVLink_adsb_vehicle_message(
            0x4CA123, lat, east, alt_type, alt_mm, 0, 0, 0, b"EI1", 1, 1, flags, 0
        )
        entries += [frame_of(mav, message, k / 2 + 1) for message in (beat, fix, own, other)]
    path = tmp_path / "made.tlog"
    path.write_bytes(b"".join(entries))
    figures = describe(read_run(path))
    near = figures["aircraft"][0]["traffic"][0]["nearest"]
    assert near["above_m"] == pytest.approx(above_m, abs=0.5)
    assert near["aside_m"] == pytest.approx(190.0, abs=0.5)
    assert words in headline.verdicts(figures)[0]


def test_pymavlink_reads_the_same_nearest_aircraft_from_the_log(tmp_path):
    """ADSB_VEHICLE.altitude and GLOBAL_POSITION_INT.alt are both above mean sea level by their definition."""
    path = unpacked(tmp_path)
    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    own, found = None, []
    while (message := log.recv_match(type=["GLOBAL_POSITION_INT", "ADSB_VEHICLE"])) is not None:
        if message.get_type() == "GLOBAL_POSITION_INT":
            own = message if message.lat else own
        elif own is not None:
            age_s, course = message.tslc + ADSB_STAMP_S, math.radians(message.heading / 100.0)
            along_m = message.hor_velocity / 100.0 * age_s
            north = (message.lat - own.lat) * 1e-7 * M_PER_DEG + along_m * math.cos(course)
            east = (message.lon - own.lon) * 1e-7 * M_PER_DEG * math.cos(math.radians(own.lat * 1e-7))
            aside = math.hypot(north, east + along_m * math.sin(course))
            above = (message.altitude - own.alt) / 1e3 + message.ver_velocity / 100.0 * age_s
            found.append((math.hypot(aside, above), aside, above, f"{message.ICAO_address:06X}"))
    slant, aside, above, name = min(found)
    row = describe(read_run(path))["aircraft"][0]["traffic"][0]
    assert (row["identity"], len({one[-1] for one in found})) == (name, 19)
    near = row["nearest"]
    for value, expected in ((near["slant_m"], slant), (near["aside_m"], aside), (near["above_m"], above)):
        assert value == pytest.approx(expected, abs=2.0)
    assert above == pytest.approx(-186.0, abs=1.0)


def test_a_log_without_a_companion_reports_all_received_aircraft(tmp_path):
    pytest.importorskip("matplotlib")
    run = read_run(unpacked(tmp_path))
    figures = describe(run)
    rows = figures["aircraft"][0]["traffic"]
    assert len(rows) == 19
    assert (rows[0]["identity"], rows[0]["callsign"]) == ("001225", "SIM4645")
    assert rows[0]["nearest"]["aside_m"] == pytest.approx(200.7, abs=1.0)
    first = headline.verdicts(figures)[0]
    assert first.startswith("Nearest other aircraft: 001225 (SIM4645), 201 m beside")
    assert "186 m below it by barometric altitude" in first
    assert first.endswith("19 other aircraft in all")
    text = page(run, figures)
    assert text.index("001225 (SIM4645)") < text.index("<h2>")
    assert all(row["identity"] in text for row in rows)
    # The documentation shows the same numbers as the tool.
    line = next(
        line
        for line in (DATA.parents[1] / "docs" / "logs.md").read_text().splitlines()
        if "19 ICAO addresses" in line
    )
    faults = figures["aircraft"][0]["faults"]
    reboots = [row for row in faults if "restarted" in row["text"]]
    assert f"one reboot, {len(faults) - len(reboots)} warnings" in line
    assert len(reboots) == 1


def test_an_aircraft_that_avoided_another_is_not_reported_as_passive(tmp_path):
    """TWO comes near while ONE flies around THREE."""
    busy = AuthorityChanged(
        previous="guarding", state="avoiding", trigger="conflict", reason="conflict with X"
    )
    config = Config(identity=IdentityConfig(uas_id="ONE"), flight=FlightConfig(use="fly"))
    other = track("TWO", position_ned_m=(30.0, 0.0, -51.0), conflict=False, active=False)
    steps = [step(k / 5, decision(track("THREE"), other, chosen=(4, 3, 0))) for k in range(1, 40)]
    write(tmp_path, config, [step(0.0, busy), *steps])
    write(tmp_path, Config(identity=IdentityConfig(uas_id="TWO")), [step(k / 5) for k in range(41)])
    (row, *_) = describe(read_run(tmp_path))["conflicts"]
    assert sorted(row["pair"]) == ["ONE", "TWO"]
    assert "ONE was avoiding THREE at that time" in "; ".join(row["done"])


@pytest.mark.parametrize(
    ("predicted_m", "words"), [(30.0, "LAW, 30.00 m from ONE"), (50.0, "SEEN, 40 m beside ONE")]
)
def test_the_nearer_of_a_predicted_and_a_reported_approach_is_told(predicted_m, words):
    nearest = {"slant_m": 40.0, "aside_m": 40.0, "above_m": None, "barometric": False, "time_s": 2.0}
    heard = {
        "identity": "SEEN",
        "callsign": "",
        "of_the_run": False,
        "beyond_record": False,
        "elsewhere": False,
        "by": "wifi",
        "nearest": nearest,
    }
    conflict = {"pair": ("ONE", "LAW"), "by": "prediction", "minimum_m": predicted_m, "time_s": 1.0}
    figures = {"aircraft": [{"name": "ONE", "traffic": [heard]}], "conflicts": [conflict]}
    assert headline._on_traffic(figures).startswith(f"Nearest other aircraft: {words}")
