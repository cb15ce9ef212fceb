"""Scenario files of other projects: reading, scaling, cutting into episodes, and messages about the rest."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.generators import HEIGHT_M
from ground_tools.campaign.scenario_measures import measures
from ground_tools.campaign.scenarios import bluesky, files, metropolis
from tests.support.read_files import HEAD_ON, INTENTIONS

KNOT = 1852.0 / 3600.0
DEGREE_M = math.radians(1.0) * 6_371_000.0
TEN_KNOTS = "10", 10.0 * KNOT
"""A speed at sea level, where true and calibrated airspeed are the same."""


def one(text):
    (plan,) = bluesky.parse(text).plans
    return plan


def at(plan, time_s):
    """Position at a time: on straight lines between the corners, and beyond the last one."""
    times = [corner[0] for corner in plan.corners]
    if time_s > times[-1]:
        assert plan.goes_on
        last = np.array(plan.corners[-1][1:])
        return last + (time_s - times[-1]) * np.array(plan.velocity)
    return np.array([np.interp(time_s, times, [c[i] for c in plan.corners]) for i in (1, 2, 3)])


# ---------------------------------------------------------------- reading


def test_aircraft_fly_straight_on_at_their_true_airspeed():
    found = bluesky.parse(HEAD_ON)
    west, east = found.plans
    assert (west.name, east.name) == ("WEST", "EAST")
    assert found.skipped == {"ASAS": 1, "TRAIL": 1, "RESO": 1}
    speed = west.velocity[1]
    assert speed / KNOT == pytest.approx(289.0, abs=1.0)  # 250 KCAS at 10,000 ft in the standard atmosphere
    assert east.velocity[1] == pytest.approx(-speed)
    assert at(west, 0.0) == pytest.approx([0.0, -0.5 * DEGREE_M, 3048.0])
    assert at(west, 100.0) == pytest.approx([0.0, -0.5 * DEGREE_M + 100.0 * speed, 3048.0])


@pytest.mark.parametrize(
    ("word", "feet", "mps"),
    [
        ("109.92461605498562", 65616.797900262463, 200.0),  # the speeds of BlueSky's own synthetic cases
        ("26.143244208325363", 65616.797900262463, 50.0),
        ("350.3079752622125", 65616.797900262463, 500.0),
        ("0.8", 35000.0, 0.8 * 296.53),
        ("M.8", 35000.0, 0.8 * 296.53),
        ("M0.8", 35000.0, 0.8 * 296.53),
        (*TEN_KNOTS[:1], 0.0, TEN_KNOTS[1]),
    ],
)
def test_true_airspeeds(word, feet, mps):
    assert bluesky.true_airspeed(word, feet * 0.3048) == pytest.approx(mps, rel=2e-4)


def test_a_route_with_heights_speeds_and_an_end():
    plan = one(
        "00:00:00>DEFWPT CORNER 0.01 0.01\n"
        "00:00:10.00>CRE A,M600,0,0,0,0,10\n"
        "00:00:10.00>DEST A 0.01 0.02\n"
        "00:00:10.00>ADDWPT,A,0.01,0,100,20\n"
        "00:00:10.00>ADDWPT A CORNER\n"
    )
    leg = 0.01 * DEGREE_M
    first_s = 10.0 + leg / TEN_KNOTS[1]
    second_s = first_s + leg / bluesky.true_airspeed("20", 30.48)
    third_s = second_s + leg / bluesky.true_airspeed("20", 30.48)
    assert [corner[0] for corner in plan.corners] == pytest.approx([10.0, first_s, second_s, third_s])
    assert at(plan, 0.5 * (10.0 + first_s)) == pytest.approx([0.5 * leg, 0.0, 0.5 * 30.48])
    assert at(plan, second_s) == pytest.approx([leg, leg, 30.48])
    assert at(plan, third_s) == pytest.approx([leg, 2.0 * leg, 30.48])
    assert not plan.goes_on


def test_orders_in_flight():
    plan = one(
        "00:00:00>CRE A,M600,0,0,0,0,10\n"
        "00:00:20>HDG A 90\n"
        "00:00:30>A ALT 100 600\n"  # 10 ft/s for 10 s
        "00:01:00>SPD A 0\n"
        "00:02:00>VS A -60\n"
        "00:02:30>DEL A\n"
        "00:03:00>HDG A 0\n"
    )
    v = TEN_KNOTS[1]
    assert at(plan, 20.0) == pytest.approx([20.0 * v, 0.0, 0.0])
    assert at(plan, 35.0) == pytest.approx([20.0 * v, 15.0 * v, 50.0 * 0.3048])
    for time_s in (60.0, 120.0):
        assert at(plan, time_s) == pytest.approx([20.0 * v, 40.0 * v, 30.48])
    assert at(plan, 150.0) == pytest.approx([20.0 * v, 40.0 * v, 70.0 * 0.3048])
    assert not plan.goes_on
    assert plan.corners[-1][0] == 150.0


def test_orders_are_processed_by_time_and_not_by_line():
    plan = one("00:00:30>HDG A 90\n00:00:00>CRE A,M600,0,0,0,0,10\n00:00:20>SPD A,20\n")
    assert [corner[0] for corner in plan.corners] == [0.0, 20.0, 30.0]


def test_backslashes_continue_lines_and_arguments_may_be_empty():
    plan = one("00:00:00>CRE A,M600,\\\n0,0,0,0,10\n00:00:00>ADDWPT A 0.01,0,,20\n")
    assert plan.corners[-1][1:] == pytest.approx((0.01 * DEGREE_M, 0.0, 0.0))
    assert plan.velocity[0] == pytest.approx(20.0 * KNOT)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("00:00:01>NONSENSE 1 2", "NONSENSE"),
        ("no time at all", "a line without a time"),
        ("00:00:01>", "a line without a command"),
        ("00:00:01>CRE B,B744,0", "CRE: too few arguments"),
        ("00:00:01>CRE B,B744,EHAM,RW18,0,0,0", "CRE: place"),
        ("00:00:01>CRE B,B744,99,0,0,0,0", "CRE: place"),
        ("00:00:01>CRE B,B744,0,0,nan,0,0", "CRE: heading nan"),
        ("00:00:01>CRE B,B744,0,0,0,high,0", "CRE: altitude high"),
        ("00:00:01>CRE B,B744,0,0,0,0,-5", "CRE: speed -5"),
        ("00:00:01>CRE a,B744,0,0,0,0,0", "CRE: an aircraft that flies already"),
        ("00:00:01>ADDWPT A EHAM", "ADDWPT: place EHAM"),
        ("00:00:01>DEST C 0 0", "DEST: an aircraft that does not fly"),
        ("00:00:01>HDG A north", "HDG: heading north"),
        ("00:00:01>SPD A fast", "SPD: speed fast"),
        ("00:00:01>ALT A high", "ALT: altitude high"),
        ("00:00:01>VS A up", "VS: vertical rate up"),
        ("00:00:01>DEFWPT HERE there 1", "DEFWPT: place"),
    ],
)
def test_input_that_is_not_understood_is_counted_and_ignored(line, name):
    text = "00:00:00>CRE A,M600,0,0,0,0,10\n"
    plain, found = bluesky.parse(text), bluesky.parse(f"{text}{line}\n{line}\n")
    assert found.skipped == {name: 2}
    assert at(found.plans[0], 50.0) == pytest.approx(at(plain.plans[0], 50.0))


WORDS = st.sampled_from(
    [
        *bluesky._FEWEST,
        "A",
        "B",
        "0",
        "1",
        "-1",
        "0.01",
        "FL100",
        "M.8",
        "nan",
        "1e999",
        "1e200",
        "FL1e308",
        "@",
        ",",
    ]
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 99), st.lists(WORDS, max_size=9)), max_size=12))
def test_no_text_breaks_the_reader(lines):
    text = "00:00:00>CRE A,M600,0,0,0,0,10\n"
    text += "\n".join(f"00:00:{second}>{' '.join(words)}" for second, words in lines)
    for plan in bluesky.parse(text).plans:
        corners = np.array([*plan.corners])
        assert np.isfinite(corners).all()
        assert (np.diff(corners[:, 0]) > 0.0).all()
        assert np.isfinite(plan.velocity).all()


# ---------------------------------------------------------------- scaling and episodes


def written(tmp_path, text, name="case.scn"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_a_scaled_file_keeps_its_shape_in_protected_zones(tmp_path):
    found = files.contents(written(tmp_path, HEAD_ON), 25.0, 9)
    (episode,) = found.episodes
    assert (found.aircraft, found.left_out, found.speed_mps) == (2, 0, 5.0)
    assert episode.speed_mps == pytest.approx(3.75, rel=1e-3)
    begin, end = episode.points[:, 0], episode.points[:, -1]
    far = DEGREE_M / 9260.0 * 25.0
    assert np.linalg.norm(begin[0] - begin[1]) == pytest.approx(far, rel=1e-6)
    # They meet in the middle of the flight.
    np.testing.assert_allclose(begin, end[::-1], atol=0.1)
    assert episode.times[0, -1] == pytest.approx(far / 3.75, rel=1e-3)
    np.testing.assert_allclose(episode.points[:, :, 2], -HEIGHT_M)


def test_heights_are_scaled_by_the_protected_zone_too(tmp_path):
    text = HEAD_ON.replace("270 10000 250", "270 11000 250")
    (episode,) = files.contents(written(tmp_path, text), 25.0, 9).episodes
    assert episode.points[0, 0, 2] - episode.points[1, 0, 2] == pytest.approx(25.0)


SMALL = """\
00:00:00>CRE A,M600,0,0,90,300,10
00:00:00>CRE B,M600,0.001,0.01,180,300,10
00:00:00>CRE C,M600,0.5,0.5,180,300,10
00:01:00>CRE LATE,M600,0,0.0205,270,300,10
00:10:00>DEL A
00:10:00>DEL B
00:10:00>DEL LATE
"""
"""Small aircraft. A flies east along the equator and passes LATE head-on, after 251 s. B crosses A's
way, too early for a conflict; C is far away."""


def test_an_episode_contains_the_aircraft_around_a_conflict(tmp_path):
    found = files.contents(written(tmp_path, SMALL), None, 9)
    (episode,) = found.episodes
    assert found.aircraft == 4
    assert episode.aircraft == 2
    assert found.speed_mps == pytest.approx(10.0 * KNOT / 0.75, rel=1e-2)
    assert episode.times.max() == pytest.approx(2.0 * files.AROUND_S)
    middle = [np.array([np.interp(60.0, t, p[:, c]) for c in range(3)])
              for t, p in zip(episode.times, episode.points, strict=True)]  # fmt: skip
    assert np.linalg.norm(middle[0] - middle[1]) < files.NEAR_M
    assert episode.speed_mps == pytest.approx(10.0 * KNOT, rel=1e-2)


def test_a_conflict_of_an_aircraft_that_flies_too_shortly_is_counted(tmp_path):
    text = SMALL.replace("00:01:00>CRE LATE,M600,0,0.0205", "00:04:00>CRE LATE,M600,0,0.0125")
    text += "00:00:00>CRE D,M600,0.6,0.6,0,300,10\n00:00:00>CRE E,M600,0.61,0.6,180,300,10\n"
    found = files.contents(written(tmp_path, text), None, 9)
    assert found.left_out == 1
    assert len(found.episodes) == 1  # the conflict of D and E


def test_without_any_conflict_nothing_is_flown(tmp_path):
    text = "00:00:00>CRE A,M600,0,0,0,0,10\n00:01:00>CRE B,M600,1,0,0,0,10\n00:09:00>DEL A\n"
    with pytest.raises(ConfigError, match="no two of its 2 aircraft are planned to come within 20 m"):
        files.contents(written(tmp_path, text), None, 9)


def test_pairs_are_those_of_all_distances():
    rng = np.random.default_rng(1)
    places = rng.uniform(-60.0, 60.0, (60, 3))
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    wanted = {(i, j) for i in range(60) for j in range(i) if gaps[i, j] < files.NEAR_M}
    assert {(max(p), min(p)) for p in files._pairs(places)} == wanted
    assert len(wanted) > 20


def test_seeds_move_the_paths_a_little_and_repeat(tmp_path):
    name = files.name_of(written(tmp_path, HEAD_ON), 0, 25.0)
    (times, points), (_, again), (_, other) = (files.draw(name, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(points, again)
    assert 0.0 < np.abs(points - other).max() < 2.0
    assert times.shape == points.shape[:2]
    with pytest.raises(ConfigError, match="no episode 7; there are 1"):
        files.draw(name.replace(":0:", ":7:"), 1)


def test_aircraft_that_are_cut_out_of_a_longer_flight_neither_start_nor_stop(tmp_path):
    path = written(tmp_path, INTENTIONS.replace("MP20,00:00:10", "MP20,00:00:22"), "flights.csv")
    found = files.contents(path, None, 9)
    name = files.name_of(path, 0, None)
    cell = Cell(generator=name, aircraft=2, law="none", speed_mps=found.speed_mps)
    look = campaign.look(cell, 1)
    assert look.world.end_s == found.episodes[0].times[0, -1] == campaign.duration_s(cell)
    found = measures.measured(cell, 1)
    assert found.end_m < 8.0  # GNSS errors; to stop at the end takes 22 m more
    assert found.row.deviation_m < 8.0  # to start takes 14 m


def test_cells_of_files_fly_and_depend_on_their_reader(tmp_path):
    name = files.name_of(written(tmp_path, HEAD_ON), 0, 25.0)
    cell = Cell(generator=name, aircraft=2, delay_s=(1.0, 2.0))
    (row,) = campaign.fly(cell, [1])
    (free,) = campaign.fly(campaign.baseline(cell), [1])
    assert free.separation_m < 10.0 < row.separation_m
    assert campaign.software_of([cell]) == campaign.software(others=True) != campaign.software()


# ---------------------------------------------------------------- flight intentions


def test_flight_intentions_are_straight_flights_between_their_places():
    found = metropolis.parse(INTENTIONS)
    assert [plan.name for plan in found.plans] == ["D1", "D2", "D3"]
    assert found.skipped == {
        "a loitering mission": 1, "type JET": 1, "time soon": 1, "place": 1, "too few columns": 1,
    }  # fmt: skip
    first, second = found.plans[:2]
    assert first.corners[0][0] == 10.0
    assert first.corners[1][0] == pytest.approx(10.0 + 0.02 * DEGREE_M / (20.0 * KNOT))
    assert first.corners[1][1] - first.corners[0][1] == pytest.approx(0.02 * DEGREE_M)
    # The map is exact in the middle of all places; a tenth of a degree of latitude away it is off by half a
    # percent.
    wide = 0.03 * DEGREE_M * math.cos(math.radians(48.19))
    assert second.corners[1][2] - second.corners[0][2] == pytest.approx(wide, rel=0.01)
    assert not second.goes_on


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet='0123456789:.,()"MPD \n\0', max_size=200))
def test_no_text_breaks_the_reader_of_flight_intentions(text):
    row = '00:00:00,D1,MP20,00:00:10,"(16.36, 48.18)","(16.36, 48.20)",2,,,,,,'
    for mixed in (text, f"{row}\n{text}", row.replace("48.20", text)):
        for plan in metropolis.parse(mixed).plans:
            assert np.isfinite(np.array(plan.corners)).all()


def test_episodes_of_flight_intentions(tmp_path):
    """D1 is at the crossing after 10 + 108.1 s, D2 about 13 s later. A later departure brings them
    together."""
    text = INTENTIONS.replace("MP20,00:00:10", "MP20,00:00:22")
    (episode,) = files.contents(written(tmp_path, text, "flights.csv"), None, 9).episodes
    assert episode.aircraft == 2
    assert sorted(
        np.linalg.norm(episode.points[:, -1] - episode.points[:, 0], axis=1) / 120.0
    ) == pytest.approx([20.0 * KNOT, 30.0 * KNOT], rel=0.01)


def test_the_search_for_episodes_is_limited(tmp_path):
    text = "".join(
        f"00:00:00,{name}{i},MP20,00:{15 * i:02d}:00,"
        f'"({16.0 + far}, 48.18)","({16.1 - far}, 48.18)",1,,,,,,\n'
        for i in range(4)
        for name, far in (("A", 0.0), ("B", 0.1))
    )
    path = written(tmp_path, text, "flights.csv")
    first, every = files.contents(path, None, 2), files.contents(path, None, 9)
    assert (len(first.episodes), first.whole) == (2, False)
    assert (len(every.episodes), every.whole) == (4, True)
    np.testing.assert_array_equal(first.episodes[1].points, every.episodes[1].points)


# ---------------------------------------------------------------- the command


def test_a_file_from_the_command_line(tmp_path, capsys):
    path = written(tmp_path, HEAD_ON)
    options = ["--scn", str(path), "--laws", "none", "dmuca", "--seeds", "1-2", "--processes", "1"]
    assert cli.main(["campaign", "scenarios", *options]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[2].startswith("| case | 2 | none | 2 | 2 | 2 |")
    assert out[3].startswith("| case | 2 | dmuca | 2 | 0 | ")
    assert out[4] == (
        f"{path}: 2 aircraft, 1 episode; conflicts of the plan that are in none: 0; "
        "not understood: ASAS (1), TRAIL (1), RESO (1)"
    )
    assert cli.main(["campaign", "scenarios", *options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [(x["scenario"], x["law"], x["losses_of_separation"]) for x in found["lines"]] == [
        ("case", "none", 2), ("case", "dmuca", 0),
    ]  # fmt: skip
    assert found["files"][0]["not_understood"] == {"ASAS": 1, "TRAIL": 1, "RESO": 1}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--scn", "none.scn"], "--scn: none.scn: cannot be read: No such file"),
        (["--scn", "CASE", "--zone", "0.5"], "--zone: 0.5 is out of range; allowed: 1 to 9260"),
        (["--scn", "CASE", "--zone", "nan"], "--zone: nan is out of range"),
        (["--scn", "CASE", "--zone", "9", "--unscaled"], "--unscaled cannot be combined with --zone"),
        (["--scn", "CASE", "--episodes", "0"], "--episodes: 0 is out of range"),
        (["--scn", "CASE", "--aircraft", "5"], "--scn cannot be combined"),
        (["merge", "--unscaled"], "--zone and --unscaled need --scn"),
        (["--scn", "EMPTY"], "it has 0 aircraft; allowed: 2 to 20,000; not understood: SYN (1)"),
    ],
)
def test_wrong_options(options, said, tmp_path, capsys):
    places = {
        "CASE": written(tmp_path, HEAD_ON),
        "EMPTY": written(tmp_path, "00:00:00>SYN SUPER 8\n", "e.scn"),
    }
    assert cli.main(["campaign", "scenarios", *(str(places.get(o, o)) for o in options)]) == 2
    assert said in capsys.readouterr().err
