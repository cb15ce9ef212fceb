"""Every manoeuvre is found once, with its reason, command and outcome."""

import math
from pathlib import Path

import msgspec
import pytest

from companion.config import AvoidanceConfig, Config, FlightConfig, IdentityConfig
from companion.events import AuthorityChanged
from ground_tools.inspect.explain.manoeuvres import change, find, verdict
from ground_tools.inspect.read.read_run import read_run
from tests.ground_tools.inspect.flights import decision, guarded, read, step, track, write

CONFIG = Config(identity=IdentityConfig(uas_id="ONE"), flight=FlightConfig(use="fly"))
RIGHT = (4.0, 3.0, 0.0)


def flown(folder: Path, *spans: tuple[float, float], end_s: float = 40.0, config: Config = CONFIG, **over):
    """A record of decisions at 5 Hz that turn right inside the spans (s)."""

    def one(t):
        left = any(a <= t <= b for a, b in spans)
        return decision(
            track(conflict=left, active=left), **({"chosen": RIGHT if left else (5.0, 0.0, 0.0)} | over)
        )

    return read(folder, config, [step(k / 5, one(k / 5)) for k in range(int(end_s * 5))])


def test_a_guarded_vehicle_is_taken_once(tmp_path: Path) -> None:
    config, steps = guarded()[0]
    (one,) = find(read(tmp_path, config, steps))
    moves = {c.state: s.now_s for s in steps for c in s.commands if isinstance(c, AuthorityChanged)}
    assert one.guarded
    assert one.tracks == ("TWO",)
    assert one.track == "TWO"
    assert one.start_s == pytest.approx(moves["avoiding"], abs=0.3)
    assert one.end_s == pytest.approx(moves["watching"], abs=1.0)
    assert one.time_to_closest_s == pytest.approx(31.8, abs=0.5)
    assert one.closest_m < 3.0 < 10.0 < one.nearest_m
    assert one.deviation_m > 10.0
    assert one.half_spaces
    assert one.alternatives
    assert one.text.startswith("The wanted velocity would have led within 1.0 m of TWO in 31.8 s")
    assert "left its mission" in one.done
    assert "right" in one.done


def test_decisions_while_the_autopilot_flies_are_no_manoeuvre(tmp_path: Path) -> None:
    def moved(previous, state):
        return AuthorityChanged(previous=previous, state=state, trigger="x", reason="y")

    left = decision(track(), chosen=RIGHT)
    steps = [step(0.0, moved("standby", "watching")), *(step(k / 5, left) for k in range(1, 50))]
    assert find(read(tmp_path / "watched", CONFIG, steps)) == ()
    steps += [step(10.0, moved("watching", "avoiding")), *(step(10.0 + k / 5, left) for k in range(1, 5))]
    (one,) = find(read(tmp_path / "taken", CONFIG, steps))
    assert (one.start_s, one.guarded) == (10.2, True)
    assert "instead of" not in one.done
    fast = msgspec.structs.replace(left, velocity_ned_mps=(9.4, 0.0, 0.0))
    steps[51] = step(10.2, fast)
    (one,) = find(read(tmp_path / "fast", CONFIG, steps))
    assert one.done.startswith(
        "The aircraft left its mission for 0.6 s, at 9.4 m/s instead of the wanted 5.0 m/s. "
    )


def test_short_gaps_belong_to_a_manoeuvre_and_long_ones_separate_two(tmp_path: Path) -> None:
    found = find(flown(tmp_path, (5.0, 8.0), (11.0, 13.0), (25.0, 26.0)))
    assert [(one.start_s, one.end_s) for one in found] == [(5.0, 13.0), (25.0, 26.0)]


def test_a_lagging_command_is_no_manoeuvre(tmp_path: Path) -> None:
    """The command lags after a corner of the path, while no half-space of a track is active."""
    found = [step(k / 5, decision(track(conflict=False, active=False), chosen=RIGHT)) for k in range(50)]
    assert find(read(tmp_path / "lag", CONFIG, found)) == ()
    speed = [step(k / 5, decision(chosen=RIGHT, limits=("speed", "climb or ceiling"))) for k in range(50)]
    assert find(read(tmp_path / "speed", CONFIG, speed)) == ()


def test_a_fence_makes_a_manoeuvre(tmp_path: Path) -> None:
    steps = [step(k / 5, decision(chosen=(0.0, 0.0, 0.0), limits=("fence",))) for k in range(50)]
    (one,) = find(read(tmp_path, CONFIG, steps))
    assert (one.tracks, one.limits, one.track) == ((), ("fence",), None)
    assert one.why == "The wanted velocity was excluded by fence."


@pytest.mark.parametrize("law", ["none", "dmuca"])
def test_the_law_none_has_no_manoeuvres(tmp_path: Path, law: str) -> None:
    config = msgspec.structs.replace(CONFIG, avoidance=AvoidanceConfig(law=law))
    assert len(find(flown(tmp_path, (5.0, 8.0), config=config))) == (law == "dmuca")


def test_a_record_without_its_header_has_no_manoeuvres(tmp_path: Path) -> None:
    steps = [step(k / 5, decision(track(), chosen=RIGHT)) for k in range(50)]
    path = write(tmp_path, CONFIG, steps)
    data = path.read_bytes()
    path.write_bytes(data[:8] + data[8 + 8 + int.from_bytes(data[8:12], "little") :])
    record = read_run(tmp_path).aircraft[0]
    assert record.header is None
    assert len(record.facts.decisions.now_s) == 50
    assert find(record) == ()


def test_the_way_back_counts_until_the_path_is_regained(tmp_path: Path) -> None:
    """The distance from the path grows to 20 m at 15 s and is below 5 m again at 18.8 s."""

    def off(t):
        return max(0.0, min(2.0 * (t - 5.0), 20.0 - 4.0 * (t - 15.0)))

    def one(t):
        left = 5.0 <= t <= 12.0
        return decision(
            track(conflict=left, active=left),
            chosen=RIGHT if left else (5.0, 0.0, 0.0),
            path_ned_m=(0.0, off(t), -50.0),
        )

    (found,) = find(read(tmp_path, CONFIG, [step(k / 5, one(k / 5)) for k in range(150)]))
    assert found.deviation_m == pytest.approx(20.0)
    assert found.regained_s == pytest.approx(18.8)
    assert "back on it 6.8 s after the manoeuvre" in found.came


def test_the_companion_says_that_the_path_is_regained_before_the_next_decision(tmp_path: Path) -> None:
    """A record that ends then has no decision near the path."""
    away = {"path_ned_m": (0.0, 20.0, -50.0)}
    steps = [step(k / 5, decision(track(), chosen=RIGHT, **away)) for k in range(20)]
    steps += [step(4.0 + k / 5, decision(track(conflict=False, active=False), **away)) for k in range(20)]
    for state, trigger, regained_s in (("guarding", "regained", 8.0), ("standby", "pilot", None)):
        changed = AuthorityChanged(previous="recovering", state=state, trigger=trigger, reason="")
        (found,) = find(read(tmp_path / trigger, CONFIG, [*steps, step(8.0, changed)]))
        assert found.regained_s == regained_s


def test_unknown_numbers_are_left_out(tmp_path: Path) -> None:
    (one,) = find(flown(tmp_path, (5.0, 8.0)))
    assert one.deviation_m is None
    assert one.regained_s is None
    assert "timed path" not in one.text


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        (RIGHT, "turned right by 37 deg"),
        ((4.0, -3.0, 0.0), "turned left by 37 deg"),
        ((3.0, 0.0, 0.0), "slower by 2.0 m/s"),
        ((5.0, 0.0, -1.5), "1.5 m/s upwards"),
        ((5.0, 0.0, 1.5), "1.5 m/s downwards"),
        ((5.0, 0.1, 0.0), "hardly changed"),
    ],
)
def test_changes_of_velocity_are_described(chosen: tuple[float, float, float], words: str) -> None:
    assert change((5.0, 0.0, 0.0), chosen) == words


def test_an_infeasible_decision_is_reported(tmp_path: Path) -> None:
    (one,) = find(flown(tmp_path, (5.0, 8.0), feasible=False))
    assert not one.feasible
    assert "No velocity kept every half-space." in one.done


def test_times_and_distances_of_the_nearest(tmp_path: Path) -> None:
    def one(t):
        near = 60.0 + abs(t - 7.0)
        return decision(track(position_ned_m=(near, 0.0, -50.0)), chosen=RIGHT)

    (found,) = find(read(tmp_path, CONFIG, [step(k / 5, one(k / 5)) for k in range(50)]))
    assert (found.nearest_track, found.nearest_s) == ("TWO", 7.0)
    assert found.nearest_m == pytest.approx(60.0)
    assert math.isclose(found.time_to_closest_s, 20.0)
    assert "excluded by TWO" in verdict(found.alternatives[1])
