"""Before the flight, the vehicle's mission is fetched, and what of it cannot be flown is said."""

from __future__ import annotations

import msgspec
import pytest

from companion.core import Companion
from companion.events import DownloadMission, FenceArea, Landed, MissionRefused, Say, VelocitySetpoint
from tests.companion.conftest import LAT, LON, Bench, config, mission


def on_ground(items=mission(300.0, 900.0), **flight):  # noqa: B008 (a tuple)
    flight = {"trajectory": "mission", "mission_speed_mps": 3.0, **flight}
    made = msgspec.structs.replace(config(**flight), path=None)
    return Bench(Companion(made), mission=items, armed=False, landed=Landed.ON_GROUND, height_m=0.0)


def asked_s(bench):
    return [now_s for now_s, c in bench.log if isinstance(c, DownloadMission)]


def said(bench):
    return [c.text for _, c in bench.log if isinstance(c, Say) and "refused" in c.text]


def test_a_sound_mission_is_fetched_when_the_vehicle_is_found_and_when_it_is_armed():
    bench = on_ground()
    bench.step(400)
    assert len(asked_s(bench)) == 1
    bench.armed = True
    bench.step(400)
    assert len(asked_s(bench)) == 2
    assert said(bench) == []
    assert not any(isinstance(c, VelocitySetpoint) for _, c in bench.log)


@pytest.mark.parametrize("flight", [{"use": "watch"}, {"use": "guard"}])
def test_a_mission_that_the_companion_does_not_fly_is_not_checked(flight):
    bench = on_ground(**flight)
    bench.step(100)
    assert asked_s(bench) == []


def test_nothing_is_fetched_before_the_vehicles_place_is_known():
    bench = on_ground()
    bench.stuck_position = True
    bench.step(100)
    assert asked_s(bench) == []
    bench.stuck_position = False
    bench.step(3)
    assert len(asked_s(bench)) == 1


@pytest.mark.parametrize(
    ("items", "speed_mps", "words"),
    [
        # The way to the first waypoint is not known yet, so it is not judged.
        (mission(300.0), 8.0, None),
        (mission(300.0, 900.0), 8.0, "m/s is above limits.max_speed_mps 5"),
        ((), 3.0, "mission"),
    ],
)
def test_what_cannot_be_flown_is_said_once(items, speed_mps, words):
    bench = on_ground(items, mission_speed_mps=speed_mps)
    bench.step(400)
    assert len(said(bench)) == (words is not None)
    assert words is None or words in said(bench)[0]


@pytest.mark.parametrize(("north_m", "forbidden"), [(600.0, True), (1500.0, False)])
def test_an_area_on_the_way_is_said(north_m, forbidden):
    around = FenceArea(inclusion=False, points=((LAT + north_m / 111_194.9, LON),), radius_m=20.0)
    bench = on_ground()
    bench.core = Companion(msgspec.structs.replace(bench.core.config, fence=(around,)))
    bench.step(100)
    assert [("area[0]" in text) for text in said(bench)] == [True] * forbidden


def test_a_refused_download_is_tried_again_after_ten_seconds():
    bench = on_ground(None)
    for _ in range(500):
        if any(isinstance(c, DownloadMission) for c in bench.commands):
            bench.extra.append(MissionRefused(reason="the vehicle's mission: no answer"))
        bench.step()
    gaps = [b - a for a, b in zip(asked_s(bench), asked_s(bench)[1:], strict=False)]
    assert gaps == [pytest.approx(10.0, abs=0.1)] * 2
