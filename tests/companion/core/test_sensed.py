"""The core with a sensor aboard: what is seen is avoided, named, told and never given up."""

from __future__ import annotations

import math

import msgspec
import pytest

from companion.authority.table import State
from companion.avoidance.law import Neighbour
from companion.config import SensedConfig
from companion.core import Companion
from companion.events import AlertChanged, Attitude, Decision, FlightMode, ObstacleScan, Say
from companion.events.sensed import NOTHING, SENSED, SENSED_WALL, is_sensed
from companion.runtime.status import live_state
from companion.traffic.sensed.objects import STANDING_EXPIRE_S
from tests.companion.conftest import Bench, config
from tests.companion.core.conftest import intruder


@pytest.fixture
def seeing() -> Bench:
    """A bench whose core holds the vehicle, and reads a sensor."""
    made = msgspec.structs.replace(config(), sensed=SensedConfig(use=True, latency_s=0.0))
    bench = Bench(Companion(made))
    bench.until(lambda: bench.core.state is State.GUARDING and bench.mode is FlightMode.EXTERNAL)
    bench.step(5)
    return bench


def scan(bench: Bench, *things: tuple[float, float]) -> ObstacleScan:
    """Distances in sectors of 5 deg from north, with things at places (north, east) of the bench."""
    distances = [NOTHING] * 72
    for north, east in things:
        n, e = north - bench.north_m, east - bench.east_m
        sector = round(math.degrees(math.atan2(e, n)) / 5.0) % 72
        distances[sector] = round(100.0 * math.hypot(n, e))
    return ObstacleScan(
        component=196, axes="north", first_deg=0.0, step_deg=5.0, distances_cm=tuple(distances), max_cm=6000
    )


def see(bench: Bench, seconds: float, *things: tuple[float, float], attitude: bool = True) -> None:
    for _ in range(round(seconds / 0.05)):
        if attitude:
            bench.extra.append(Attitude(time_boot_s=bench.now_s, roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0))
        bench.extra.append(scan(bench, *things))
        bench.step()


def decisions(bench: Bench) -> list[Decision]:
    return [c for _, c in bench.log if isinstance(c, Decision)]


def said(bench: Bench) -> list[str]:
    return [c.text for _, c in bench.log if isinstance(c, Say)]


def test_what_is_seen_is_avoided_and_named(seeing):
    see(seeing, 2.0, (30.0, 0.5))
    last = decisions(seeing)[-1]
    (view,) = last.tracks
    assert view.track_id.startswith(SENSED)
    assert view.conflict
    assert last.chosen_ned_mps != last.wanted_ned_mps
    assert any(is_sensed(c.track_id) for _, c in seeing.log if isinstance(c, AlertChanged))
    assert any(
        text.startswith(f"DMUCA caution {SENSED}") or f"warning {SENSED}" in text for text in said(seeing)
    )


def test_status_shows_it_as_sensed(seeing):
    see(seeing, 1.0, (30.0, 0.5))
    (shown,) = live_state.core_status(seeing.core, seeing.now_s, decisions(seeing)[-1])["tracks"]
    assert shown.transport == "sensed"
    assert shown.doubts == ()
    assert shown.distance_m == pytest.approx(30.0, abs=1.0)
    assert shown.above_m is None


def test_it_is_gone_soon_after_the_last_measurement(seeing):
    see(seeing, 1.0, (30.0, 0.5))
    seeing.step(round((STANDING_EXPIRE_S + 1.0) / 0.05))
    assert decisions(seeing)[-1].tracks == ()


def test_no_allowance_ends_it(seeing):
    """It stays in the way for longer than any allowance of unproven traffic."""
    allowances = seeing.core._decider.allowances
    see(seeing, 1.0, (25.0, 0.5))
    other = Neighbour(f"{SENSED}9", (20.0, 0.0, -50.0), (-3.0, 0.0, 0.0), 0.0, 1.0, proven=True)
    for second in range(0, 2000, 10):
        assert allowances.admitted(float(second), (0.0, 0.0, -50.0), (3.0, 0.0, 0.0), [other]) == [other]
    assert allowances.hold is None


def test_a_heard_aircraft_that_is_seen_is_one_and_the_alert_says_so(seeing):
    for number in range(120):
        if number % 10 == 0:
            seeing.extra.append(intruder(seeing, 30.0, 0.0, east_m=0.5))
        see(seeing, 0.05, (30.0, 0.5))
    assert [is_sensed(view.track_id) for view in decisions(seeing)[-1].tracks] == [True]
    assert seeing.core.sensed.fused.keys() == {(False, "OTHER")}
    ends = [
        c.reason
        for _, c in seeing.log
        if isinstance(c, AlertChanged) and c.track_id == "OTHER" and not c.level
    ]
    assert ends == [
        f"clear OTHER: the same aircraft is avoided as {seeing.core.sensed.fused[False, 'OTHER']}"
    ]
    names = {shown.track_id for shown in live_state.core_status(seeing.core, seeing.now_s, None)["tracks"]}
    assert "OTHER" not in names


def test_many_places_of_a_wall_are_told_once(seeing):
    wall = [(20.0, 20.0 * math.tan(math.radians(deg))) for deg in range(-45, 46, 5)]
    see(seeing, 5.0, *wall)
    assert len({v.track_id for v in decisions(seeing)[-1].tracks if SENSED_WALL in v.track_id}) > 4
    assert sum(SENSED_WALL in text for text in said(seeing)) == 1


def test_the_pilot_is_told_when_nothing_can_be_used_and_when_scans_stop(seeing):
    see(seeing, 1.0)
    see(seeing, 3.0, attitude=False)
    texts = [text for text in said(seeing) if "obstacle sensor" in text]
    assert texts == ["DMUCA: obstacle sensor not used: attitude older than 0.25 s"]
    see(seeing, 10.0)
    seeing.step(100)
    assert said(seeing)[-1] == "DMUCA: obstacle sensor is silent"


def test_without_the_section_such_events_are_ignored(flying):
    see(flying, 1.0, (30.0, 0.5))
    assert flying.core.sensed is None
    assert decisions(flying)[-1].tracks == ()


def test_a_clock_that_restarts_forgets_what_was_seen(seeing):
    see(seeing, 1.0, (30.0, 0.5))
    seeing.boot_offset_s -= 50.0
    see(seeing, 0.2, (30.0, 0.5))
    assert seeing.core.sensed.look(seeing.now_s, seeing.core.own) == []
    see(seeing, 3.0, (30.0, 0.5))
    assert len(seeing.core.sensed.look(seeing.now_s, seeing.core.own)) == 1
