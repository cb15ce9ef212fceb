"""The laws of other projects: agreement with their published equations, and flights in the campaign."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import Volume
from companion.avoidance.law import settings_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import flight, outcome, tables
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.peer_comparison import command, pareto, search
from ground_tools.campaign.peer_comparison import table as comparison
from ground_tools.campaign.peers import common, flown, fly_away, laws, mvp, orca
from ground_tools.campaign.world import World
from ground_tools.common import table_file
from ground_tools.common.sources import ROOT

PEERS = sorted(name for name in laws.PEERS if flown.missing(name) is None)
EXACT = World(end_s=100.0, sigma_m=0.0, sigma_mps=0.0, declared_m=0.0, quantised=False, delay_s=(0.0, 0.0))
LIMITS = settings_of(AvoidanceConfig(), LimitsConfig(), Trajectory([0.0, 1.0], [(0.0, 0.0, 0.0)] * 2))


def ned(*values):
    return k.Vector(*map(float, values))


def up(v):
    """Convert NED to east, north and up, the axes of BlueSky and ArduPilot."""
    return np.array([v[1], v[0], -v[2]])


def encounters(number, seed=1):
    """Positions of another aircraft beside the own one, and both velocities; NED."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        bearing, distance = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(1.0, 120.0)
        away = ned(distance * math.cos(bearing), distance * math.sin(bearing), rng.uniform(-20.0, 20.0))
        yield away, ned(*rng.uniform(-5.0, 5.0, 2), 0.3 * rng.normal()), ned(*rng.uniform(-5.0, 5.0, 3))


# ---------------------------------------------------------------- published equations


def rvo2_plane(p, v, own, radius, tau, step):
    """The half-space as RVO2-3D computes it: its point and normal, as n . v >= least."""
    p2, r2 = p @ p, radius * radius
    if p2 > r2:
        w = v - p / tau
        if w @ p < 0.0 and (w @ p) ** 2 > r2 * (w @ w):
            n = w / np.linalg.norm(w)
            u = (radius / tau - np.linalg.norm(w)) * n
        else:
            a, b = p2, p @ v
            cross = np.cross(p, v)
            c = v @ v - (cross @ cross) / (p2 - r2)
            t = (b + math.sqrt(b * b - a * c)) / a
            ww = v - t * p
            n = ww / np.linalg.norm(ww)
            u = (radius * t - np.linalg.norm(ww)) * n
    else:
        w = v - p / step
        n = w / np.linalg.norm(w)
        u = (radius / step - np.linalg.norm(w)) * n
    return n, n @ (own + 0.5 * u)


def test_the_planes_of_orca_are_those_of_rvo2():
    for away, velocity, own in encounters(300):
        found = orca.plane(away, velocity, own, Volume(22.0, 1.0, 20.0), 0.2)
        p, v = np.array(away), np.array(own) - np.array(velocity)
        normal, least = rvo2_plane(p, v, np.array(own), 22.0, 20.0, 0.2)
        assert found.normal == pytest.approx(normal, abs=1e-6)
        assert found.least == pytest.approx(least, abs=1e-6)


def bluesky(away, velocity, own, p):
    """BlueSky's detection and MVP for one pair, after its source.

    Returns:
        Whether there is a conflict, the time to the closest approach, and the change of the own velocity
        (east, north, up).
    """
    drel, v1, v2 = up(away), up(own), up(velocity)
    dist = math.hypot(drel[0], drel[1])
    du, dv = v1[0] - v2[0], v1[1] - v2[1]
    dv2 = max(du * du + dv * dv, 1e-6)
    tcpa = -(-du * drel[0] - dv * drel[1]) / dv2
    dcpa2 = abs(dist * dist - tcpa * tcpa * dv2)
    dtin = math.sqrt(max(0.0, p.radius_m**2 - dcpa2)) / math.sqrt(dv2)
    dalt, dvs = -drel[2], v1[2] - v2[2]
    cross = [(dalt + p.height_m) / -dvs, (dalt - p.height_m) / -dvs]
    tin, tout = max(min(cross), tcpa - dtin), min(max(cross), tcpa + dtin)
    conflict = dcpa2 < p.radius_m**2 and tin <= tout and tout > 0.0 and tin < p.look_s
    if not conflict:
        return False, tcpa, None
    vrel, rpz, hpz = v2 - v1, p.radius_m * p.margin, p.height_m * p.margin
    dcpa = drel + vrel * tcpa
    dabs = math.hypot(dcpa[0], dcpa[1])
    ih = rpz - dabs
    if dabs <= p.head_on_m:
        dabs = p.head_on_m
        dcpa[0], dcpa[1] = drel[1] / dist * dabs, -drel[0] / dist * dabs
    if rpz < dist and dabs < dist:
        erratum = math.cos(math.asin(rpz / dist) - math.asin(dabs / dist))
        ih = rpz / erratum - dabs
    iv, tsolv = hpz, abs(drel[2] / vrel[2])
    if tsolv > p.look_s:
        tsolv = tin
    dv3 = (iv / tsolv) * (-vrel[2] / abs(vrel[2]))
    return True, tcpa, -np.array([*(ih * dcpa[:2] / (abs(tcpa) * dabs)), 0.5 * dv3])


@pytest.mark.parametrize("head_on_m", [1.0, 10.0])
def test_mvp_is_that_of_bluesky(head_on_m):
    p = laws.PEERS["mvp"].best._replace(radius_m=16.0, height_m=16.0, look_s=30.0, head_on_m=head_on_m)
    conflicts = 0
    for away, velocity, own in encounters(600):
        relative = ned(*(np.array(velocity) - np.array(own)))
        met = mvp.detect.py_func(away, relative, p)
        conflict, tcpa, change = bluesky(away, velocity, own, p)
        assert met.conflict == conflict
        assert met.nearest_s == pytest.approx(tcpa, rel=1e-9)
        if conflict:
            conflicts += 1
            assert up(mvp.change.py_func(away, relative, met, p)) == pytest.approx(change, rel=1e-6)
    assert conflicts > 60


def test_mvp_returns_after_the_closest_approach_only():
    p = laws.PEERS["mvp"].best._replace(radius_m=16.0)
    east, west = ned(0.0, 3.0, 0.0), ned(0.0, -3.0, 0.0)
    for away, own, other, clear in (
        (ned(0.0, 40.0, 0.0), east, west, False),  # ahead
        (ned(0.0, -40.0, 0.0), east, west, True),  # behind
        (ned(0.0, -10.0, 0.0), east, west, False),  # behind, but in the protected zone
        (ned(16.1, -0.5, 0.0), east, ned(0.0, 2.0, 0.0), False),  # side by side just outside of it
        (ned(30.0, -1.0, 0.0), east, ned(0.0, 2.0, 0.0), True),
    ):
        relative = ned(*(np.array(other) - np.array(own)))
        assert mvp.passed.py_func(away, relative, own, other, p) == clear


@pytest.mark.parametrize("speed_mps", [50.0, 3.0])
def test_mvp_adds_the_changes_of_all_conflicts_and_keeps_the_greatest_speed(speed_mps):
    """The vertical part has priority, and the horizontal part keeps its direction."""
    p = laws.PEERS["mvp"].best._replace(radius_m=16.0, height_m=16.0, look_s=15.0, level=0.0)
    law = SimpleNamespace(speed_mps=speed_mps, climb_mps=2.0, descent_mps=2.0)
    velocity, wanted = ned(1.0, 3.0, 0.0), ned(0.0, 3.0, 0.0)
    others = [(ned(4.0, 60.0, 6.0), ned(0.0, -3.0, 0.0)), (ned(40.0, 40.0, 5.0), ned(-3.0, 0.0, -0.1))]
    own = k.Own(ned(0.0, 0.0, 0.0), velocity, 1.0, 7.0, 7.0, math.inf, -math.inf)
    mind = SimpleNamespace(
        notes=np.zeros((3, 3 + 6)), senders=[1, 2], neighbours=np.zeros((2, k.OTHER_COLUMNS))
    )
    expected = np.array(velocity)
    for row, (away, moves) in enumerate(others):
        known = k.Other(*away, *moves, *[0.0] * (k.OTHER_COLUMNS - 6))._replace(vertical_known=1.0)
        k.put_other(mind.neighbours, row, known)
        relative = ned(*(np.array(moves) - np.array(velocity)))
        met = mvp.detect.py_func(away, relative, p)
        assert met.conflict
        expected = expected + np.array(mvp.change.py_func(away, relative, met, p))
    assert expected[2] < -0.1  # above both of them
    mvp._resolve.py_func(mind, 0, 2, own, wanted, p, law)
    begun, at_s, active, *flown = mind.notes[0, 3:]
    assert (begun, at_s, active) == (1.0, 7.0, 1.0)
    assert mind.notes[0, :3].tolist() == [0.0, 1.0, 1.0]
    down = max(expected[2], -2.0)
    assert flown[2] == pytest.approx(down)
    level = np.hypot(*expected[:2])
    room = math.sqrt(speed_mps**2 - down**2)
    assert (level > room) == (speed_mps == 3.0)
    assert flown[:2] == pytest.approx(expected[:2] * min(1.0, room / level))


def test_the_threats_and_the_way_of_fly_away_are_those_of_ardupilot():
    for away, velocity, own in encounters(300):
        relative = ned(*(np.array(velocity) - np.array(own)))
        # closest_distance_between_radial_and_point, of the line that the obstacle flies in the time ahead
        line, point = 10.0 * np.array(relative[:2]), -np.array(away[:2])
        t = min(max(line @ point / (line @ line), 0.0), 1.0)
        near = np.linalg.norm(point - t * line)
        assert fly_away.nearest_level.py_func(away, relative, 10.0) == pytest.approx(near)
        us, them = -up(away), up(velocity)
        if np.linalg.norm(them) >= 1.0:
            us = us - them * (us @ them) / (them @ them)
        us = us / np.linalg.norm(us)
        climb = LIMITS.climb_mps if us[2] > 0.0 else LIMITS.descent_mps
        found, flies = fly_away.away_from.py_func(away, velocity, LIMITS, False)
        assert found
        assert up(flies) == pytest.approx(us * [LIMITS.speed_mps, LIMITS.speed_mps, climb], abs=1e-9)
        _, level = fly_away.away_from.py_func(away, velocity, LIMITS, True)
        assert (math.hypot(level.n, level.e), level.d) == pytest.approx((LIMITS.speed_mps, 0.0))


# ---------------------------------------------------------------- flights


def head_on(law, world, aside_m):
    """Least separation and true positions of two aircraft that meet head-on, with exact messages."""
    south, north = np.array([-90.0, 0.0, -100.0]), np.array([90.0, 0.0, -100.0])
    aside = np.array([0.0, aside_m, 0.0])
    points = np.array([[south, north], [north + aside, south + aside]])
    times = np.tile([0.0, 60.0], (2, 1))
    meaning = flown.flown_by(law, campaign.LAWS)
    rows = [
        meaning.settings_row(
            settings_of(meaning.avoidance, LimitsConfig(), Trajectory(t.tolist(), p.tolist())), True
        )
        for t, p in zip(times, points, strict=True)
    ]
    result = np.zeros(outcome.FLIGHT_ENTRIES)
    trace = np.zeros((1000, 2, 3))
    flight.fly(
        np.random.default_rng(1), world.conditions(0.2), times, points, k.NO_WALLS, np.array(rows),
        np.zeros(2), trace, outcome.new_log(2), np.zeros((2, 2, outcome.PAIR_ENTRIES)), result,
        loop=meaning.peer[0].loop,
    )  # fmt: skip
    return result[outcome.F_SEPARATION], trace


@pytest.mark.parametrize("law", PEERS)
def test_a_head_on_pair_resolves(law):
    """Published ORCA plans for exactly 10 m, and may fall below it by up to 1 m, because the vehicle lags."""
    separation, trace = head_on(law, EXACT, 0.5)
    assert separation > (9.0 if law == "orca" else 10.0)
    assert np.abs(trace[-1, 0] - (90.0, 0.0, -100.0)).max() < 5.0
    assert np.abs(trace[-1, 1] - (-90.0, 0.5, -100.0)).max() < 5.0


@pytest.mark.parametrize("law", [law for law in PEERS if law != "fly-away"])
def test_an_exactly_symmetric_pair_stays_apart_and_symmetric(law):
    """With a message in every step, both aircraft have the same information about each other. ORCA may then
    stop both in front of each other, because it has no rule that breaks the symmetry."""
    separation, trace = head_on(law, replace(EXACT, message_s=0.1), 0.0)
    assert separation > (9.0 if law == "orca" else 10.0)
    # Of DAIDALUS's two directions, which are equally near, rounding decides which one an aircraft flies.
    assert law == "daidalus" or trace[:, 0, :2] == pytest.approx(-trace[:, 1, :2], abs=1e-6)


def test_fly_away_has_no_direction_in_an_exact_head_on():
    """The own position has no component perpendicular to the other's velocity, and ArduPilot does nothing."""
    separation, _ = head_on("fly-away", replace(EXACT, message_s=0.1), 0.0)
    assert separation < 2.0


@pytest.mark.parametrize("law", PEERS)
def test_the_same_seed_gives_the_same_flight(law):
    cell = Cell(generator="head-on", aircraft=3, law=law, delay_s=(1.0, 2.0))
    first = campaign.fly(cell, [1, 2])
    assert campaign.fly(cell, [1, 2]) == first
    assert first[0].separation_m != first[1].separation_m
    assert first[0].manoeuvres > 0.0
    assert first[0].alerts


@pytest.mark.parametrize("law", ["mvp", "orca"])
def test_who_does_not_avoid_flies_as_with_any_other_law(law):
    blind = Cell(generator="crossing", aircraft=2, law=law, intruders=1.0)
    alone = campaign.fly(replace(blind, law="none"), [1, 2])
    assert [r.separation_m for r in campaign.fly(blind, [1, 2])] == [r.separation_m for r in alone]


@pytest.mark.parametrize("law", PEERS)
def test_every_command_is_within_the_limits(law):
    commands = campaign.look(Cell(generator="circle", aircraft=4, law=law, delay_s=(1.0, 2.0)), 3).log.flown[
        :, 0
    ]
    assert np.linalg.norm(commands, axis=1).max() <= LIMITS.speed_mps + 1e-9
    assert commands[:, 2].min() >= -LIMITS.climb_mps - 1e-9


@pytest.mark.parametrize("law", [*PEERS, "mvp:look_s=15,level=0", "fly-away:level=1"])
def test_every_command_changes_within_the_limit(law):
    """`kernels.limit` keeps the limit of the change only if the law's wish is within the greatest speed."""
    look = campaign.look(Cell(generator="circle", aircraft=4, law=law, delay_s=(1.0, 2.0)), 3)
    changes = np.linalg.norm(np.diff(look.log.flown[:, 0], axis=0), axis=1)
    assert changes.max() <= LIMITS.acceleration_mps2 * 0.2 + 1e-6


def test_a_changed_number_of_the_own_law():
    """A growth of 1 is the unchanged law."""
    cell = Cell(generator="S2", aircraft=3, delay_s=(2.0, 3.0))
    as_it_is = campaign.fly(cell, [1, 2])
    assert campaign.fly(replace(cell, law="dmuca:growth=1"), [1, 2]) == as_it_is
    assert campaign.fly(replace(cell, law="dmuca:growth=0"), [1, 2]) != as_it_is


def test_a_changed_number_is_not_an_intruders():
    """Otherwise a changed acceleration of ours would also change how sharply intruders turn."""
    changed = flown.flown_by("dmuca:acceleration_mps2=1", campaign.LAWS)
    as_it_is = flown.flown_by("dmuca", campaign.LAWS)
    assert changed.settings_row(LIMITS, True) != as_it_is.settings_row(LIMITS, True)
    assert changed.settings_row(LIMITS, False) == as_it_is.settings_row(LIMITS, False)


def test_the_own_law_reproduces_the_kept_flights():
    kept = table_file.read(ROOT / "results" / "campaign" / "generators.json", tables.Kept)
    for line in kept.lines[:4]:
        assert campaign.fly(line.cell, [line.first.seed]) == [line.first]


# ---------------------------------------------------------------- names, search, tables


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("nonsense", "--law: nonsense is unknown; allowed: dmuca, paper, none, orca"),
        ("paper:growth=1", "--law: paper is unknown; allowed: dmuca"),  # it has no parameters
        ("mvp:radius=3", "mvp: parameter 'radius' is unknown; allowed: radius_m, height_m"),
        ("mvp:radius_m=", "mvp: radius_m= is not allowed; allowed: 0.001 to 10000"),
        ("mvp:level=2", "mvp: level=2 is not allowed; allowed: 0 or 1"),
        ("mvp:look_s=nan", "mvp: look_s=nan is not allowed"),
        ("dmuca:law=1", "dmuca: parameter 'law' is unknown; allowed: radius_m, sigmas"),
    ],
)
def test_a_law_that_is_not_known_is_refused(law, words, capsys):
    assert cli.main(["campaign", "run", "--generator", "S2", "--law", law, "--seeds", "1-2"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--worst", "1"], "--worst cannot be combined with --law mvp"),
        (["--world", "fence"], "--law mvp cannot be combined with --world fence"),
        (["--intruder", "twin", "--intruders", "0.2"], "--law mvp cannot be combined with --intruder twin"),
    ],
)
def test_what_a_peer_cannot_fly_is_refused(options, words, capsys):
    assert cli.main(["campaign", "run", "--generator", "head-on", "--law", "mvp", *options]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("name", PEERS)
def test_a_name_with_all_parameters_is_read_as_it_was_written(name):
    peer = laws.PEERS[name]
    assert laws.of(name) == (peer, peer.best)
    for tried in peer.candidates():
        assert laws.of(search.whole(name, tried)) == (peer, tried)
    assert not peer.main or peer.main in peer.best._fields


def test_every_search_has_the_same_budget():
    assert {len(laws.PEERS[name].candidates()) for name in search.searched()} == {laws.CANDIDATES}


def line(law, encounter, lost, deviation_m):
    found = {
        "runs": 25, "losses_of_separation": lost, "collisions": 0, "min_separation_m": 9.0,
        "median_max_deviation_m": deviation_m,
    }  # fmt: skip
    return tables.Line(cell=Cell(generator=encounter, aircraft=5, law=law), found=found)


def test_the_best_candidate_loses_least_and_then_deviates_least():
    lines = [line("a:r=1", "S2", 0, 9.0), line("a:r=1", "random", 1, 9.0), line("a:r=2", "S2", 0, 30.0)]
    lines += [line("a:r=2", "random", 0, 10.0), line("a:r=3", "S2", 0, 40.0), line("a:r=3", "random", 0, 1.0)]
    assert search.scores(lines)["a:r=3"] == (0, 20.5)
    assert search.best_of(lines) == {"a": "a:r=2"}
    assert search.markdown(lines).count("`a:r=") == 3


def test_the_kept_search_found_what_the_laws_fly_with():
    kept = table_file.read(ROOT / "results" / "campaign" / "peers-search.json", tables.Kept)
    assert f"{kept.seeds[0]}-{kept.seeds[1]}" == search.SEEDS
    assert [x.cell for x in kept.lines] == of_flown(kept, search.cells())
    for name, law in search.best_of(kept.lines).items():
        assert laws.of(law)[1] == laws.PEERS[name].best


@pytest.mark.parametrize("name", comparison.TABLES)
def test_the_page_shows_the_kept_tables(name):
    kept = table_file.read(ROOT / "results" / "campaign" / f"peers-{name}.json", tables.Kept)
    assert [x.cell for x in kept.lines] == of_flown(kept, comparison.TABLES[name].cells())
    assert comparison.markdown(name, kept.lines) in on_the_page(kept)


def test_the_page_shows_the_points_of_the_picture():
    kept = table_file.read(ROOT / "results" / "campaign" / "peers-pareto.json", tables.Kept)
    assert [x.cell for x in kept.lines] == of_flown(kept, pareto.cells())
    assert pareto.markdown(kept.lines) in on_the_page(kept)


def test_the_page_shows_the_best_of_the_kept_search():
    kept = table_file.read(ROOT / "results" / "campaign" / "peers-search.json", tables.Kept)
    assert search.markdown(kept.lines) in (ROOT / "docs" / "peers-results.md").read_text()


def of_flown(kept, cells):
    """The cells, without those of a law that needs what was not there when the file was made."""
    names = {x.cell.law.partition(":")[0] for x in kept.lines}
    return [c for c in cells if (n := c.law.partition(":")[0]) in names or not laws.PEERS[n].needs]


def on_the_page(kept):
    """The page's text, after a check that it and the commands use the kept seeds."""
    page = (ROOT / "docs" / "peers-results.md").read_text()
    first, last = kept.seeds
    assert f"{first}-{last}" == command.HELD_OUT
    for line in kept.lines:
        assert line.found["runs"] == last - first + 1
    assert f"{last - first + 1:,} flights a cell (seeds {first:,} to {last:,})" in page
    return page


def test_a_table_from_one_command(capsys, monkeypatch, tmp_path):
    small = replace(comparison.TABLES["encounters"].encounters[1], aircraft=2)
    table = comparison.Table("two", ("none", "orca"), (small,), comparison.separation, "numbers")
    monkeypatch.setitem(comparison.TABLES, "encounters", table)
    words = ["campaign", "peers", "table", "encounters", "--seeds", "1-2", "--processes", "1"]
    words += ["--out", str(tmp_path / "kept"), "--file", str(tmp_path / "table.json")]
    assert cli.main(words) == 0
    assert capsys.readouterr().out.startswith("| encounter | none | orca |\n| --- | --- | --- |\n| S2 | ")
    assert cli.main([*words, "--json"]) == 0
    lines = json.loads(capsys.readouterr().out)["lines"]
    assert [(x["encounter"], x["law"], x["runs"]) for x in lines] == [("S2", "none", 2), ("S2", "orca", 2)]
    assert len(table_file.read(tmp_path / "table.json", tables.Kept).lines) == 2


def test_the_picture_needs_every_cell(tmp_path):
    pytest.importorskip("matplotlib")
    found = {"runs": 10, "losses_of_separation": 1, "min_separation_m": 9.0, "median_max_deviation_m": 20.0}
    lines = [tables.Line(cell=cell, found=found) for cell in pareto.cells()]
    pareto.draw(tmp_path / "p.png", lines)
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")
    assert pareto.markdown(lines).count("1 / 9.0 / 20.0") == len(lines)
    with pytest.raises(ConfigError, match="needs 1 cells that were not flown"):
        pareto.draw(tmp_path / "p.png", lines[1:])


def test_the_columns_of_parameters_follow_those_of_the_own_law():
    assert len(k.Settings._fields) == common.AVOIDS
    row = flown.flown_by("mvp", campaign.LAWS).settings_row(LIMITS, False)
    assert row[common.AVOIDS] == 0.0
    assert row[0] == k.NONE
    assert tuple(row[common.FIRST :]) == tuple(laws.PEERS["mvp"].best)
