"""The figures of a run and their terminal output: conflicts, reactions, faults, and missing data."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from companion.config import AvoidanceConfig, Config, FlightConfig, IdentityConfig
from companion.events import (
    AlertChanged,
    AuthorityChanged,
    Broadcast,
    BroadcastChanged,
    GlobalPosition,
    RadioState,
    RemoteIdHeard,
    Say,
    Severity,
    VehicleText,
    VehicleTime,
)
from companion.events.sensed import SENSED, SENSED_WALL
from companion.geometry import LocalFrame
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.remote_id.region import Region
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.report import headline, terminal
from ground_tools.inspect.report.summary import describe
from tests.ground_tools.inspect.flights import decision, guarded, step, track, write

FLYING = FlightConfig(use="fly")


def told(folder: Path) -> str:
    return " ".join(terminal.text(describe(read_run(folder))).split())


@pytest.fixture
def guard(tmp_path: Path) -> Path:
    for config, steps in guarded():
        write(tmp_path, config, steps)
    return tmp_path


def test_a_conflict_reports_what_each_aircraft_did(guard: Path) -> None:
    figures = describe(read_run(guard))
    (row,) = figures["conflicts"]
    assert (row["pair"], row["kept"], row["required_m"]) == (["ONE", "TWO"], True, 10.0)
    assert row["minimum_m"] == figures["separations"][0]["minimum_m"]
    assert row["done"][0].startswith("ONE left its mission: turned right by")
    assert row["done"][1] == "TWO only watched"
    one = figures["aircraft"][0]
    assert [(span["mode"]) for span in one["flight"]["modes"]] == ["AUTO", "GUIDED", "AUTO"]
    assert one["flight"]["authority"][1]["reason"] == "conflict with TWO"
    assert one["flight"]["authority"][1]["to_s"] == one["flight"]["authority"][2]["from_s"]
    assert one["flight"]["max_height_m"] == pytest.approx(50.0, abs=1.0)
    assert one["flight"]["armed_s"] == pytest.approx(one["duration_s"], abs=2.0)
    assert len(one["manoeuvres"]) == 1


def test_figures_are_json_and_reproducible(guard: Path) -> None:
    first, second = (json.dumps(describe(read_run(guard))) for _ in range(2))
    assert first == second
    assert json.loads(first)["aircraft"][0]["manoeuvres"][0]["half_spaces"]
    assert terminal.text(json.loads(first)) == terminal.text(describe(read_run(guard)))


def test_tables_fit_where_there_is_no_terminal(guard: Path) -> None:
    """The lines with the run's name and with missing data may be longer."""
    lines = terminal.text(describe(read_run(guard))).splitlines()
    assert max(map(len, lines[lines.index("") :])) <= terminal.PIPED_WIDTH
    assert not re.search(r"\x1b", "\n".join(lines))


def test_times_are_on_the_common_time_line(tmp_path: Path, made: SimpleNamespace) -> None:
    """The second aircraft's own clock is 1,000 s ahead."""
    for name, clock_s in (("ONE", 0.0), ("TWO", 1000.0)):
        me = made.northbound if name == "ONE" else made.eastbound(2.0)
        made.write_events(tmp_path, name, made.steps(me, made.northbound, clock_s))
    one, two = describe(read_run(tmp_path))["aircraft"]
    assert one["flight"]["start_s"] == pytest.approx(two["flight"]["start_s"], abs=0.01)
    assert one["faults"][0]["time_s"] == pytest.approx(two["faults"][0]["time_s"], abs=0.01)


def test_an_aircraft_that_was_only_heard_is_a_conflict_by_prediction(tmp_path: Path) -> None:
    def one(t):
        return decision(track("INTRUDER", position_ned_m=(20.0 + abs(t - 4.0), 0.0, -51.0)), chosen=(4, 3, 0))

    write(
        tmp_path,
        Config(identity=IdentityConfig(uas_id="ONE"), flight=FLYING),
        [step(k / 5, one(k / 5)) for k in range(50)],
    )
    (row,) = describe(read_run(tmp_path))["conflicts"]
    assert (row["pair"], row["kept"], row["time_s"]) == (["ONE", "INTRUDER"], None, 4.0)
    assert row["by"] == "Remote ID, as predicted aboard"
    assert "turned right by 37 deg" in row["done"][0]
    assert (
        "Nearest other aircraft: INTRUDER, 20.02 m from ONE at 4.0 s (Remote ID, as predicted aboard)"
        in told(tmp_path)
    )


def test_sensed_obstacles_are_named_and_the_points_of_a_wall_are_merged(tmp_path: Path) -> None:
    wall, pole = f"{SENSED_WALL}4/1", f"{SENSED}7"

    def one(t):
        places = [
            track(wall, position_ned_m=(20.0 + abs(t - 4.0), 0.0, -51.0)),
            track(f"{SENSED_WALL}4/2", position_ned_m=(30.0 + abs(t - 4.0), 0.0, -51.0)),
            track(pole, position_ned_m=(40.0, 10.0, -50.0)),
        ]
        return decision(*places, chosen=(4, 3, 0))

    write(
        tmp_path,
        Config(identity=IdentityConfig(uas_id="ONE"), flight=FLYING),
        [step(k / 5, one(k / 5)) for k in range(50)],
    )
    first, second = describe(read_run(tmp_path))["conflicts"]
    assert first["pair"] == ["ONE", SENSED_WALL.strip()]
    assert first["by"] == "own sensor, as predicted aboard"
    assert second["pair"] == ["ONE", pole]
    words = told(tmp_path)
    assert "Nearest other aircraft" not in words
    assert (
        f"Nearest thing that a sensor aboard saw: {SENSED_WALL.strip()}, 20.02 m from ONE at 4.0 s "
        "(own sensor, as predicted aboard); 2 obstacles or aircraft in conflict in all" in words
    )


def test_after_a_pilot_takes_over_received_positions_are_used(tmp_path: Path) -> None:
    """The law decides for 2 s and sees INTRUDER 60 m away, which then comes nearer. A second aircraft appears
    only in a warning. A third one is received and is no conflict."""

    def heard(name: str, now_s: float, north_m: float) -> RemoteIdHeard:
        own = step(now_s).events[0]
        assert isinstance(own, GlobalPosition)
        place = LocalFrame(own.lat_deg, own.lon_deg, 450.0).to_geodetic(north_m, 0.0, 0.0)
        identity = BasicId(uas_id=name, id_type=IdType.SERIAL_NUMBER, ua_type=UaType.NONE)
        report = Location(lat_deg=place[0], lon_deg=place[1])
        return RemoteIdHeard(transport="wifi", address=name, messages=(identity, report))

    steps = []
    for k in range(60):
        t = k / 5
        came = abs(t - 8.0)
        events = (heard("INTRUDER", t, 12.0 + 6.0 * came), heard("NEXT", t, 31.0), heard("FAR", t, 90.0))
        made = (decision(track("INTRUDER", position_ned_m=(60.0, 0.0, -50.0))),) if t <= 2.0 else ()
        steps.append(step(t, *made, events=events))
    took = AuthorityChanged(
        previous="avoiding",
        state="yielded",
        trigger="mode taken",
        reason="mode changed to LOITER, not by the companion",
    )
    warned = AlertChanged(
        track_id="NEXT",
        level=2,
        reason="closest 1 m aside",
        time_to_closest_s=9.0,
        horizontal_m=1.0,
        vertical_m=0.0,
        acting=False,
    )
    steps[11] = msgspec.structs.replace(steps[11], commands=(took, warned))
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE"), flight=FLYING), steps)
    one, two = describe(read_run(tmp_path))["conflicts"]
    assert (one["pair"][1], one["time_s"], one["by"]) == ("INTRUDER", 8.0, "Remote ID, as heard")
    assert one["minimum_m"] == pytest.approx(12.0, abs=0.1)
    assert one["done"][0].endswith("; its state was yielded: mode changed to LOITER, not by the companion")
    assert (two["pair"][1], two["by"]) == ("NEXT", "Remote ID, as heard")
    assert two["minimum_m"] == pytest.approx(31.0, abs=0.1)
    assert two["done"][0].startswith("ONE did nothing: ")


def test_a_wrongly_assumed_distance_is_reported(tmp_path: Path, made: SimpleNamespace) -> None:
    """An aircraft sends a false position: ONE takes it to be 60 m away while it is 1.4 m away."""
    for name, me in (("ONE", made.northbound), ("TWO", made.eastbound(2.0))):
        config = Config(identity=IdentityConfig(uas_id=name), flight=FLYING)
        steps = []
        for made_step in made.steps(me, made.northbound):
            false = decision(track("TWO", position_ned_m=(60.0, 0.0, -51.0), conflict=False, active=False))
            commands = (false,) if name == "ONE" else ()
            steps.append(msgspec.structs.replace(made_step, commands=commands))
        write(tmp_path, config, steps)
    row = describe(read_run(tmp_path))["conflicts"][0]
    assert not row["kept"]
    assert row["done"][0] == (
        "ONE did nothing: its law saw no conflict with it at that time (it assumed a distance of 60.0 m)"
    )
    assert row["done"][1] == "TWO did nothing: its law made no decision at that time"
    assert "Separation LOST by 1 of 1 pairs; ONE - TWO: closest 1.41 m" in told(tmp_path)


def test_the_law_none_is_named(tmp_path: Path, made: SimpleNamespace) -> None:
    config = Config(
        identity=IdentityConfig(uas_id="ONE"), flight=FLYING, avoidance=AvoidanceConfig(law="none")
    )
    write(tmp_path, config, made.steps(made.northbound, made.eastbound(2.0)))
    made.write_events(tmp_path, "TWO", made.steps(made.eastbound(2.0), made.northbound))
    assert describe(read_run(tmp_path))["conflicts"][0]["done"][0].startswith('ONE did nothing: law "none"')


def test_a_violated_minimum_rate_is_reported_at_the_top(tmp_path: Path) -> None:
    region = Region(name="eu", transport_sets=(("wifi",),), location_period_s=1.0)
    config = Config(identity=IdentityConfig(uas_id="ONE"), region=region)
    on = BroadcastChanged(rates=(("wifi", 1.0),), legal=True, reason="")
    sends = [step(t, Broadcast(transport="wifi", messages=(Location(),))) for t in (1.0, 2.0, 3.5)]
    write(tmp_path, config, [step(0.0, on, events=(RadioState(can_send=("wifi",)),)), *sends])
    assert "Remote ID: minimum rates of region eu NOT kept by ONE" in told(tmp_path)
    assert "NOT kept: 1 times" in told(tmp_path)
    write(tmp_path, config, [step(0.0, on), *sends[:2]])
    assert "Remote ID: minimum rates of region eu kept by all 1 aircraft" in told(tmp_path)


def test_faults_are_listed_in_order(tmp_path: Path) -> None:
    lost = AuthorityChanged(previous="avoiding", state="fault", trigger="unfit", reason="no GNSS")
    quiet = VehicleText(severity=6, text="EKF active")
    loud = VehicleText(severity=2, text="battery low")
    steps = [
        step(1.0, Say(severity=Severity.INFO, text="hello"), events=(quiet, loud)),
        step(2.0, lost, Say(severity=Severity.WARNING, text="DMUCA fault")),
    ]
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE")), steps)
    faults = describe(read_run(tmp_path))["aircraft"][0]["faults"]
    assert [(row["time_s"], row["what"], row["text"]) for row in faults] == [
        (1.0, "vehicle", "battery low"),
        (2.0, "authority: fault", "no GNSS"),
        (2.0, "companion", "DMUCA fault"),
    ]


def test_missing_data_is_reported(tmp_path: Path) -> None:
    path = write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE")), [step(1.0), step(2.0)])
    (one,) = describe(read_run(tmp_path))["aircraft"]
    assert one["missing"] == [
        'the law made no decision: flight.use was "watch", or the companion never took control',
        "heartbeats are missing, so arming and modes are not known",
        "UTC is missing, so latencies are not known",
        "no Remote ID was sent",
        "no Remote ID was heard",
    ]
    assert one["flight"]["armed_s"] is None
    data = path.read_bytes()
    path.write_bytes(data[:8] + data[16 + int.from_bytes(data[8:12], "little") :])
    assert "missing: ONE: the log has no companion" in told(tmp_path)


def test_a_killed_companion_is_reported(tmp_path: Path) -> None:
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE")), [step(1.0), step(2.0)])
    (tmp_path / "manifest.json").write_text('{"what": "companion run", "aircraft": ["ONE"]}')
    words = "ONE: the companion did not end normally (killed, hung, power lost), or it still runs; nothing is"
    assert words in told(tmp_path)
    (tmp_path / "summary.json").write_text('{"ticks": 2}')
    assert "did not end normally" not in told(tmp_path)


def test_texts_from_logs_do_not_control_the_terminal(tmp_path: Path) -> None:
    evil = "[bold red]\x1b[2J\x1b]0;x\x07 \u202egnp\x9b [/nothing]"
    steps = [step(k / 5, decision(track(evil), chosen=(4, 3, 0))) for k in range(20)]
    steps.append(step(9.0, events=(VehicleText(severity=1, text=evil),)))
    write(tmp_path, Config(identity=IdentityConfig(uas_id="ONE"), flight=FLYING), steps)
    text = terminal.text(describe(read_run(tmp_path)))
    assert "[bold red]" in text
    assert "\\x1b[2J" in text
    assert all(c.isprintable() or c == "\n" for c in text)


def test_times_count_from_the_first_step_whose_utc_is_shown(tmp_path: Path) -> None:
    config = Config(identity=IdentityConfig(uas_id="ONE"), flight=FLYING)
    told_utc = VehicleTime(time_boot_s=0.0, utc_s=1_767_225_605.0)
    write(tmp_path, config, [step(62_000.0), step(62_005.0, events=(told_utc,)), step(62_010.0)])
    figures = describe(read_run(tmp_path))
    flight = figures["aircraft"][0]["flight"]
    assert (flight["start_s"], flight["end_s"]) == (0.0, 10.0)
    assert figures["utc_at_zero_s"] == 1_767_225_600.0
    assert "at 0 s: 2026-01-01 00:00:00Z" in headline.head(figures)
