"""Facts of a record: the content of the columns, and that they are small compared with the record."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from companion.event_record import Step
from companion.events import (
    AuthorityChanged,
    CurrentMode,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    ModeRefused,
    RemoteIdHeard,
    Say,
    VehicleText,
    VehicleTime,
)
from companion.geometry import LocalFrame
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from ground_tools.inspect.read.conditions import GnssQuality
from ground_tools.inspect.read.facts import gather
from ground_tools.inspect.read.modes import mode_name
from ground_tools.inspect.read.read_run import read_run


def test_columns_of_a_record(made: SimpleNamespace) -> None:
    facts = gather(made.steps(made.northbound, made.eastbound(20.0)))
    assert (facts.steps, facts.start_s, facts.end_s, facts.duration_s) == (601, 0.0, 60.0, 60.0)
    assert facts.fixes.shape == (601, 8)
    assert facts.utc_offset_s == pytest.approx(made.utc_s)
    assert {name: len(times) for name, times in facts.sent.items()} == {"wifi": 61}
    assert {a: (len(h.now_s), h.transports) for a, h in facts.heard.items()} == {
        "c2:00:00:00:00:02": (61, ("wifi",))
    }
    kinds = [type(what) for _, what in facts.rare]
    assert kinds == [AuthorityChanged, Say, VehicleText, ModeRefused]
    assert len(facts.decisions.now_s) == 301
    assert facts.decisions.conflict.any()
    assert facts.decisions.feasible.all()


def test_a_track_has_a_row_a_second_with_its_least_distance(made: SimpleNamespace) -> None:
    facts = gather(made.steps(made.northbound, made.eastbound(20.0)))
    track = facts.tracks["DMUCA002"]
    assert len(track.now_s) == 61
    assert (np.diff(track.now_s) > 0).all()
    # 5 m/s each, with decisions at 5 Hz: the minimum is taken over the decisions within the second.
    times = facts.decisions.now_s
    truth = np.hypot(20.0 - 5.0 * (times - 30.0), 5.0 * (times - 30.0))
    assert track.distance_m.min() == pytest.approx(truth.min(), abs=0.01)
    assert set(np.flatnonzero(track.conflict)) == {
        int(t) for t, d in zip(times, truth, strict=True) if d < 20.0
    }


def test_repeated_events_are_kept_only_when_they_change() -> None:
    def beat(mode: int, armed: bool) -> Heartbeat:
        return Heartbeat(
            system_id=1,
            firmware=Firmware.ARDUPILOT,
            vehicle_type=2,
            custom_mode=mode,
            mode=FlightMode.OTHER,
            armed=armed,
        )

    modes = [(3, False), (3, False), (3, True), (4, True), (4, True), (3, True)]
    facts = gather(Step(now_s=float(i), events=(beat(*m),), commands=()) for i, m in enumerate(modes))
    assert [now for now, _ in facts.rare] == [0.0, 2.0, 3.0, 5.0]


def test_identities_are_kept_by_radio_address() -> None:
    names = ("A", "B", "A")
    steps = [
        Step(
            now_s=float(i),
            events=(
                RemoteIdHeard(
                    transport="ble4",
                    address="aa",
                    messages=(BasicId(uas_id=name, id_type=IdType.SERIAL_NUMBER, ua_type=UaType.NONE),),
                ),
            ),
            commands=(),
        )
        for i, name in enumerate(names)
    ]
    assert gather(steps).heard["aa"].uas_ids == ("A", "B")


def test_decisions_give_positions_only_without_fixes(made: SimpleNamespace) -> None:
    steps = made.steps(made.northbound, made.eastbound(20.0))
    blind = [
        Step(
            now_s=step.now_s,
            events=tuple(event for event in step.events if not isinstance(event, GlobalPosition)),
            commands=step.commands,
        )
        for step in steps
    ]
    whole, decided = gather([*blind[:9], *steps[9:]]), gather(blind)
    assert (len(whole.decided), decided.fixes.shape, decided.decided.shape) == (0, (0, 8), (301, 8))
    fixes = gather(steps).fixes
    same = np.isin(fixes[:, 0], decided.decided[:, 0])
    assert decided.decided[:, 1:4] == pytest.approx(fixes[same][:, 1:4], abs=1e-3)
    # Of a decision, the time, three speeds and two flags are kept.
    kept = whole.decisions
    assert (
        sum(rows.nbytes for rows in (kept.now_s, kept.speeds_mps, kept.feasible, kept.conflict)) == 301 * 22
    )


def test_distances_use_the_senders_extrapolated_position() -> None:
    """A message from 30 m ahead is received 1 s late, at 4 m/s closing speed, 10 m higher if its height can
    be compared. No distance is computed with an own position that is 3 s old."""

    def at(now_s: float, *, gnss: bool) -> Step:
        place = LocalFrame(47.0, 8.0, 400.0).to_geodetic(30.0, 0.0, -10.0)
        own = GlobalPosition(
            time_boot_s=now_s,
            lat_deg=47.0,
            lon_deg=8.0,
            alt_msl_m=400.0,
            height_above_home_m=50.0,
            velocity_ned_mps=(0.0, 0.0, 0.0),
        )
        fix = GnssFix(
            fix_type=3, lat_deg=47.0, lon_deg=8.0, alt_msl_m=400.0, alt_ellipsoid_m=447.0, satellites=9
        )
        report = Location(
            lat_deg=place[0],
            lon_deg=place[1],
            alt_geodetic_m=place[2] + 47.0,
            speed_mps=4.0,
            direction_deg=180.0,
            timestamp_s=now_s - 1.0,
        )
        heard = RemoteIdHeard(transport="wifi", address="aa", messages=(report,))
        utc = VehicleTime(time_boot_s=now_s, utc_s=3600.0 + now_s)
        return Step(now_s=now_s, events=(own, utc, *((fix,) if gnss else ()), heard), commands=())

    late = at(13.0, gnss=True)
    late = msgspec.structs.replace(late, events=late.events[-1:])
    near = gather([at(10.0, gnss=False), at(10.2, gnss=True), at(11.0, gnss=True)]).heard["aa"].near
    assert near[:, 0].tolist() == [10.0, 11.0]
    assert near[:, 1] == pytest.approx([26.0, math.hypot(26.0, 10.0)], abs=0.05)
    assert len(gather([at(10.0, gnss=True), late]).heard["aa"].near) == 1


def test_no_steps() -> None:
    facts = gather([])
    assert (facts.steps, facts.duration_s, facts.fixes.shape, facts.rare) == (0, 0.0, (0, 8), ())


def test_steps_are_read_anew_and_end_where_the_facts_do(run_folder: Path) -> None:
    path = run_folder / "DMUCA001.events"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] + b"\xff" + whole[len(whole) // 2 + 1 :])
    run = read_run(run_folder)
    one = run.aircraft[0]
    assert len(run.problems) == 1
    assert "checksum" in run.problems[0]
    assert 0 < one.facts.steps < 601
    assert [len(list(one.steps())) for _ in range(2)] == [one.facts.steps] * 2


def test_current_mode_sets_the_time_of_a_mode_change() -> None:
    beat = Heartbeat(
        system_id=1,
        firmware=Firmware.PX4,
        vehicle_type=2,
        custom_mode=0x60000,
        mode=FlightMode.EXTERNAL,
        armed=True,
    )
    hold = CurrentMode(custom_mode=0x3040000)
    events = [hold, beat, hold, hold]
    facts = gather(Step(now_s=float(i), events=(event,), commands=()) for i, event in enumerate(events))
    assert [(now, mode_name(what)) for now, what in facts.rare] == [(1.0, "OFFBOARD"), (2.0, "AUTO.LOITER")]


def test_no_satellites_are_the_fewest() -> None:
    quality = GnssQuality()
    for now_s, satellites in enumerate((14, 0, 12)):
        quality.add(
            float(now_s),
            GnssFix(
                fix_type=3, lat_deg=47.0, lon_deg=8.0, alt_msl_m=400.0, alt_ellipsoid_m=447.0,
                satellites=satellites,
            ),
        )  # fmt: skip
    assert quality.least_satellites == 0
