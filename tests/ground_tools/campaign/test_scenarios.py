"""Intruders on missions, and scenarios of everyday traffic with their measures."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from msgspec.structs import replace

from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import tables, vehicles
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.generators import HEIGHT_M, MEETING_S
from ground_tools.campaign.scenario_measures import command, measures
from ground_tools.campaign.scenarios import layouts, missions
from ground_tools.common import table_file

MISSION = Cell(generator="cruise", aircraft=2, intruders=0.5, intruder="survey", delay_s=(1.0, 2.0))


# ---------------------------------------------------------------- missions


def drawn(name, seed, aircraft=3):
    times, points = layouts.draw("cruise", aircraft, 5.0, seed)
    on_mission = np.arange(aircraft) < 1
    return times, points, *missions.flown(name, times, points, on_mission, seed)


def place(times, points, at):
    return np.array([np.interp(at, times, points[:, c]) for c in range(3)])


@pytest.mark.parametrize("name", missions.MISSIONS)
def test_a_mission_passes_the_others_in_the_middle_and_leaves_their_paths_as_they_are(name):
    for seed in range(20):
        times, points, t, p = drawn(name, seed)
        assert t.shape == (3, p.shape[1])
        assert (np.diff(t) > 0.0).all()
        assert (t[:, 0] == times[:, 0]).all()
        assert t[:, -1] == pytest.approx(times[:, -1])
        middle = np.mean([place(times[i], points[i], MEETING_S) for i in (1, 2)], axis=0)
        miss = place(t[0], p[0], MEETING_S) - middle
        assert np.linalg.norm(miss) <= missions.PASS_M + 1e-6
        for i in (1, 2):
            for at in (0.0, 33.3, 120.0, 239.0):
                assert place(t[i], p[i], at) == pytest.approx(place(times[i], points[i], at), abs=1e-6)
        again = drawn(name, seed)
        np.testing.assert_array_equal(p, again[3])


@pytest.mark.parametrize(
    ("name", "slowest", "fastest"),
    [("survey", 2.5, 6.0), ("shuttle", 2.5, 6.0), ("orbit", 1.9, 5.0), ("stop-and-go", 3.0, 8.0)],
)
def test_missions_move_as_documented(name, slowest, fastest):
    for seed in range(20):
        _, _, t, p = drawn(name, seed)
        speed = np.linalg.norm(np.diff(p[0], axis=0), axis=1) / np.diff(t[0])
        moving = speed > 1e-6
        assert slowest <= speed[moving].min()
        assert speed[moving].max() <= fastest + 1e-6
        assert moving.all() == (name != "stop-and-go")
        assert np.ptp(p[0, :, 2]) < 1e-6
        inner = p[0, 1:-1] if name != "orbit" else p[0]
        extent = np.linalg.norm(inner[:, None, :2] - inner[None, :, :2], axis=2).max()
        assert extent <= {"shuttle": 120.0, "orbit": 80.0}.get(name, math.inf) + 1e-6


def test_an_intruder_on_a_mission_avoids_nobody_and_stays_in_the_baseline():
    unavoided = campaign.baseline(MISSION)
    assert (unavoided.intruder, unavoided.intruders, unavoided.law) == ("survey", 0.5, "none")
    look, free = campaign.look(MISSION, 5), campaign.look(unavoided, 5)
    assert look.kinds.tolist() == [vehicles.BLIND, vehicles.AVOIDS]
    np.testing.assert_array_equal(look.trace[:, 0], free.trace[:, 0])
    assert look.row.separation_m > free.row.separation_m
    assert look.row.deviation_m > free.row.deviation_m


@pytest.mark.parametrize("name", missions.MISSIONS)
def test_an_intruder_on_a_mission_keeps_to_the_corners_of_its_path(name):
    for seed in (1, 2):
        look = campaign.look(campaign.baseline(replace(MISSION, intruder=name)), seed)
        t = look.world.step_s * np.arange(1, len(look.trace) + 1)
        path = np.column_stack([np.interp(t, look.times[0], look.points[0, :, c]) for c in range(3)])
        # GNSS errors, plus the overshoot at corners. With a limit of 1 m/s^2 the deviation was up to 46 m.
        assert np.linalg.norm(look.trace[:, 0] - path, axis=1).max() < 15.0


def test_missions_from_the_command_line(capsys):
    options = ["--aircraft", "2", "--intruder", "orbit", "--intruders", "0.5", "--seeds", "1-5"]
    assert cli.main(["campaign", "run", "--generator", "cruise", *options, "--processes", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["unavoided_losses_of_separation"] >= 4
    assert found["losses_of_separation"] < found["unavoided_losses_of_separation"]


def test_files_depend_on_what_their_cells_need():
    plain, mission = Cell(generator="S2", aircraft=2), MISSION
    assert campaign.software_of([plain]) == campaign.software()
    assert campaign.software_of([mission]) == campaign.software(scenarios=True) != campaign.software()
    assert campaign.software_of([replace(plain, law="mvp")]) == campaign.software(peers=True)


# ---------------------------------------------------------------- scenarios


@pytest.mark.parametrize("name", layouts.SCENARIOS)
def test_a_scenario_is_drawn_from_its_seed(name):
    aircraft = layouts.SCENARIOS[name].aircraft
    for seed in range(5):
        times, points = layouts.draw(name, aircraft, 5.0, seed)
        np.testing.assert_array_equal(points, layouts.draw(name, aircraft, 5.0, seed)[1])
        assert times.shape == points.shape[:2]
        assert times.shape[0] == aircraft
        assert (np.diff(times) > 0.0).all()
        assert np.abs(points[:, :, 2] + HEIGHT_M).max() < 52.0
        way = np.linalg.norm(np.diff(points, axis=1), axis=2) / np.diff(times)
        assert way.max() <= 3.76
    assert not np.array_equal(points, layouts.draw(name, aircraft, 5.0, 99)[1])


@pytest.mark.parametrize(("name", "apart_m"), [("lanes-15", 15.0), ("lanes-20", 20.0)])
def test_the_oncoming_lane_is_to_the_right(name, apart_m):
    _, points = layouts.draw(name, 2, 5.0, 1)
    way = (points[0, 1] - points[0, 0])[:2]
    right = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    assert (points[1, 0, :2] - points[0, 0, :2]) @ right == pytest.approx(apart_m, abs=2.0)


@pytest.mark.parametrize(("name", "apart_m"), [("abreast-25", 25.0), ("stacked-25", 25.0), ("parking", 15.0)])
def test_places_have_their_documented_distances(name, apart_m):
    _, points = layouts.draw(name, 5, 5.0, 1)
    gaps = np.linalg.norm(points[:, None, -1] - points[None, :, -1], axis=2)[np.triu_indices(5, 1)]
    assert gaps.min() == pytest.approx(apart_m, abs=2.5)


def test_unknown_scenarios_are_refused(capsys):
    with pytest.raises(ValueError, match="unknown; allowed: lanes-15"):
        layouts.draw("nowhere", 2, 5.0, 1)
    assert cli.main(["campaign", "scenarios", "nowhere"]) == 2
    assert "allowed: lanes-15" in capsys.readouterr().err
    assert cli.main(["campaign", "scenarios", "merge", "--laws", "nonsense"]) == 2
    assert "--law: nonsense is unknown" in capsys.readouterr().err


# ---------------------------------------------------------------- measures


def test_changes_of_side_ignore_positions_on_the_path():
    assert measures._changes(np.array([0.0, 3.0, 1.0, -1.0, 2.5, -2.0, -5.0, 0.0, 4.0])) == 2
    assert measures._changes(np.array([0.0, 1.0, -1.9])) == 0


def test_least_distances():
    trace = np.zeros((2, 3, 3))
    trace[:, 1, 0], trace[:, 2, 0] = (30.0, 8.0), (100.0, 90.0)
    assert measures._least_distances(trace).tolist() == [8.0, 8.0, 70.0]


def test_an_aircraft_that_avoids_nobody_arrives_without_needless_deviation():
    found = measures.measured(Cell(generator="parking", aircraft=5, law="none", delay_s=(1.0, 2.0)), 90001)
    assert found.end_m < measures.ARRIVED_M
    assert found.row.deviation_m < 8.0
    avoiding = measures.measured(Cell(generator="parking", aircraft=5, delay_s=(1.0, 2.0)), 90001)
    assert avoiding.needless_m == pytest.approx(avoiding.row.deviation_m, abs=0.5)
    assert avoiding.needless_m > found.needless_m
    assert avoiding.end_m > found.end_m
    assert found.clear_s == 0.0
    assert avoiding.clear_s is None  # the places are too near to each other for the aircraft to reach them
    assert measures.figures([found, avoiding])["not_clear"] == 1


def test_the_time_to_clear_is_from_leaving_the_plan_to_being_back_on_it():
    times = np.tile(np.arange(6.0)[:, None], (1, 2))
    gaps = np.array([[1.0, 2.0], [11.0, 3.0], [5.0, 5.0], [3.0, 12.0], [2.0, 9.0], [1.0, 1.0]])
    assert measures._clear(times, gaps) == 2.0  # off the plan first at 1 s and last at 3 s
    assert measures._clear(times, np.minimum(gaps, measures.OFF_M)) == 0.0
    gaps[-1, 0] = 11.0
    assert measures._clear(times, gaps) is None


def test_a_near_mid_air_collision_of_small_aircraft_is_wide_and_flat():
    look = campaign.look(Cell(generator="head-on", aircraft=2, law="none"), 1)
    assert measures._snmac(look)
    trace = np.zeros((2, 2, 3))
    for offset, inside in (((15.0, 0.0, 4.5), True), ((15.5, 0.0, 0.0), False), ((0.0, 0.0, 4.7), False)):
        trace[:, 1] = offset
        assert measures._snmac(dataclasses.replace(look, trace=trace)) == inside


def test_the_table_of_scenarios(capsys, tmp_path):
    options = ["--laws", "none", "dmuca", "--seeds", "1-2", "--processes", "1"]
    assert (
        cli.main(["campaign", "scenarios", "abreast-25", *options, "--file", str(tmp_path / "t.json")]) == 0
    )
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 4
    assert out[2].startswith("| abreast-25 | 5 | none | 2 | 0 | 0 |")
    kept = table_file.read(tmp_path / "t.json", tables.Kept)
    assert command.markdown(kept.lines).splitlines() == out
    for x in kept.lines:
        assert campaign.fly(x.cell, [1]) == [x.first]
