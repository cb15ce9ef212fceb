"""The worst flights as run folders: each records exactly the flight of the campaign."""

from __future__ import annotations

import json

import numpy as np
import pytest

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, Neighbour, Situation
from companion.avoidance.trajectory import Trajectory
from companion.events import Broadcast, Decision, RemoteIdHeard, VelocitySetpoint
from companion.radio.frames_io import radio_address
from ground_tools import cli
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import outcome, run_folder
from ground_tools.campaign.cells import Cell
from ground_tools.inspect.read.flown import TRUE, flown, separations
from ground_tools.inspect.read.read_run import read_run, read_unavoided
from ground_tools.inspect.read.truth import ORIGIN

CELL = Cell(
    generator="crossing", aircraft=3, delay_s=(1.0, 2.0), intruders=0.34, intruder="turning", world="layer"
)
SEED = 4
NAMES = ["uas-001-turning", "uas-002", "uas-003"]


@pytest.fixture(scope="module")
def look():
    return campaign.look(CELL, SEED)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return read_run(run_folder.write(tmp_path_factory.mktemp("runs"), CELL, SEED, 1.8e9))


def of_type(record, kind):
    return [c for step in record.steps() for c in (*step.events, *step.commands) if isinstance(c, kind)]


def test_a_recorded_flight_equals_the_unrecorded_one(look):
    assert look.row == campaign.fly(CELL, [SEED])[0]
    assert look.row.manoeuvres > 0.0


def test_the_record_shows_what_the_law_decides(look, run):
    """`Law` repeats every decision from the record, with the same command, wanted velocity and tracks."""
    assert [record.name for record in run.aircraft] == NAMES
    logged = 0
    for i in (1, 2):
        law = Law(look.avoidance, look.limits[i], Trajectory(look.times[i].tolist(), look.points[i].tolist()))
        steps = list(run.aircraft[i].steps())
        assert len(steps) == len(look.log.time_s) == 1200
        for d, step in enumerate(steps):
            own = outcome.Log(*(array[d, i] for array in look.log))
            heard = []
            for j in np.flatnonzero(np.isfinite(own.message_s)).tolist():
                other = k.Other(*own.others[j].tolist())
                place, velocity = (other.n, other.e, other.d), (other.vn, other.ve, other.vd)
                errors = other.sigma_m, other.sigma_mps, other.growth_mps
                if j != i:
                    heard.append(
                        Neighbour(
                            NAMES[j],
                            place,
                            velocity,
                            other.age_s,
                            *errors,
                            other.silent == 1.0,
                            growth_down_mps=other.growth_down_mps,
                        )
                    )
            now, world = float(own.time_s), look.world
            view = Situation(
                now, now, tuple(own.position.tolist()), tuple(own.velocity.tolist()), world.declared_m, heard,
                -world.floor_m, -world.ceiling_m,
            )  # fmt: skip
            result = law.decide(view)
            assert step.now_s == now
            assert step.commands[-1] == VelocitySetpoint(velocity_ned_mps=result.chosen_ned_mps)
            for decision in (c for c in step.commands if isinstance(c, Decision)):
                logged += 1
                assert decision.tracks == result.tracks
                assert decision.wanted_ned_mps == result.wanted_ned_mps
                assert decision.chosen_ned_mps == result.chosen_ned_mps
                assert decision.feasible == result.feasible
            assert any(isinstance(c, Decision) for c in step.commands) or not result.conflict
    assert logged > 2 * 240


def test_the_record_shows_where_its_commands_lead(look, run):
    """Integrating a vehicle model with the recorded commands gives the recorded positions."""
    every = round(0.2 / look.world.step_s)
    for i, record in enumerate(run.aircraft):
        commands = [c.velocity_ned_mps for c in of_type(record, VelocitySetpoint)]
        position = record.truth[0, 1:].copy()
        velocity = (look.points[i, 1] - look.points[i, 0]) / (look.times[i, 1] - look.times[i, 0])
        for tick, row in enumerate(record.truth[1:]):
            a = (np.array(commands[tick // every]) - velocity) / look.world.lag_s
            a *= min(1.0, look.world.acceleration_mps2 / max(np.linalg.norm(a), 1e-9))
            position += (velocity + 0.5 * look.world.step_s * a) * look.world.step_s
            velocity = velocity + look.world.step_s * a
            assert np.abs(position - row[1:]).max() < 1e-6
    assert len(run.aircraft[0].truth) == 2401


def test_separation_and_messages_are_those_of_the_flight(look, run):
    ways = flown(run)
    assert ways.positions == TRUE
    assert not ways.problems
    nearest = separations(ways.paths)[0]
    assert nearest.minimum_m == pytest.approx(look.row.separation_m, abs=1e-4)
    assert nearest.minimum_time_s == pytest.approx(look.row.time_s, abs=look.world.step_s)
    pair = [NAMES[look.row.first], NAMES[look.row.second]]
    assert sorted([nearest.first, nearest.second]) == sorted(pair) == sorted(run.summary["closest"])
    for record in run.aircraft:
        assert len(of_type(record, Broadcast)) in (239, 240)
        # Two senders with a message per second; few messages are replaced by the next before a decision uses
        # them.
        assert 2 * 225 <= len(of_type(record, RemoteIdHeard)) < 2 * 240
    other = read_unavoided(run.folder)
    unavoided = campaign.fly(campaign.baseline(CELL), [SEED])[0].separation_m
    assert separations(flown(other).paths)[0].minimum_m == pytest.approx(unavoided, abs=1e-4)


def test_what_is_heard_is_where_it_was_sent(look, run):
    """A message's position differs from the sender's true one by at most the GNSS error and half a height
    quantum."""
    record = run.aircraft[1]
    new = look.log.message_s[:, 1, 2]
    times = np.unique(new[np.isfinite(new)])
    truth = run.aircraft[2].truth
    at = np.column_stack([np.interp(times, truth[:, 0] - truth[0, 0], axis) for axis in truth[:, 1:].T])
    address = radio_address(NAMES[2])
    heard = [e for e in of_type(record, RemoteIdHeard) if e.address == address]
    assert len(heard) == len(times)
    heights = np.array([e.messages[0].alt_geodetic_m - ORIGIN[2] for e in heard])
    assert np.abs(heights + at[:, 2]).max() < 8.0
    assert np.abs(heights + at[:, 2]).max() > 0.25


def test_the_worst_are_flown_again_into_folders_that_open(tmp_path, capsys):
    command = ["campaign", "run", "--generator", "crossing", "--aircraft", "3", "--seeds", "1-6",
               "--intruders", "0.34", "--intruder", "turning", "--json", "--processes", "1",
               "--worst", "2", "--runs", str(tmp_path)]  # fmt: skip
    assert cli.main(command) == 0
    found = json.loads(capsys.readouterr().out)
    first, second = found["worst"]
    assert (first["seed"], first["separation_m"]) == (found["worst_seed"], found["min_separation_m"])
    assert first["separation_m"] <= second["separation_m"]
    assert cli.main(["inspect", "--json", first["folder"]]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["separations"][0]["minimum_m"] == pytest.approx(first["separation_m"], abs=1e-4)
    assert [a["name"] for a in shown["aircraft"]] == NAMES
    assert shown["problems"] == []
    pytest.importorskip("rerun")
    file = tmp_path / "worst.rrd"
    assert cli.main(["inspect", first["folder"], "--save", str(file)]) == 0
    assert file.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--worst", "-1"], "--worst: -1 is out of range; allowed: 0 to 1000"),
        (["--worst", "1", "--aircraft", "60"], "60 aircraft is too large; allowed: up to 50"),
        (["--worst", "1", "--runs", "/dev/null/here", "--seeds", "1-1"], "--runs: /dev/null/here"),
    ],
)
def test_what_is_wrong_is_named(options, words, capsys):
    assert cli.main(["campaign", "run", "--generator", "S2", "--processes", "1", *options]) == 2
    assert words in capsys.readouterr().err
