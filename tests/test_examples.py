"""The example projects in docs/examples do what they say."""

import os
import runpy
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.avoidance.law import LawResult, Neighbour, Situation
from companion.config import AtmcConfig, AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from companion.events import TrackView
from sitl_mocks.air.air_settings import AirSettings
from sitl_mocks.encounters import choosing, lockstep
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"


@pytest.fixture(scope="module")
def example():
    pytest.importorskip("torch")
    pytest.importorskip("pettingzoo")
    return runpy.run_path(str(EXAMPLES / "outside_learner.py"))


@pytest.fixture(scope="module")
def trained(example):
    """The environment and the learner after 60 steps."""
    env = example["AtmcParallelEnv"](aircraft=3)
    return env, example["train"](env, 60, 1)


def test_an_outside_learner_learns_from_all_agents(example, trained):
    env, q = trained
    assert example["mean_delay_ms"](env, q, 1, seed=3) < 0.7 * example["mean_delay_ms"](env, 25, 1, seed=3)


def test_its_policy_flies_and_chooses_what_the_network_chooses(example, trained, tmp_path):
    env, q = trained
    layers = [
        (layer.weight.detach().numpy().T, layer.bias.detach().numpy())
        for layer in q
        if hasattr(layer, "bias")
    ]
    observations, _ = env.reset(seed=9)
    rows = np.stack([observations[agent] for agent in env.possible_agents])
    path = tmp_path / "outside.safetensors"
    path.write_bytes(example["freeze_layers"](layers, rows, name="outside"))
    scenario = Scenario(
        path=(
            PathSettings(points=((0.0, -25.0, 60.0, -60.0), (6.0, 25.0, 60.0, -60.0))),
            PathSettings(points=((0.0, 25.0, 0.0, -60.0), (6.0, -25.0, 0.0, -60.0))),
        ),
        air=AirSettings(model="packets", rate=5),
        atmc=AtmcConfig(policy=str(path)),
        duration_s=6.0,
    )
    data = choosing.read_policy(scenario)  # its golden cases are computed again by NumPy
    chosen = lockstep.fly(scenario, 1, policy=data).chosen
    assert msgspec.json.encode(chosen)


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        ([((4, 5), (5,)), ((6, 30), (30,))], r"expected \(5, 30\)"),
        ([((4, 30), (29,))], "expected"),
        ([((4, 7), (7,))], "7 outputs for 30 actions"),
    ],
)
def test_layers_that_do_not_fit_are_refused(example, layers, words):
    with pytest.raises(ValueError, match=words):
        example["freeze_layers"](
            [(np.zeros(weight), np.zeros(bias)) for weight, bias in layers], np.zeros((2, 4)), name="x"
        )


def daidalus():
    return runpy.run_path(str(EXAMPLES / "plugin-daidalus" / "dmuca_daidalus.py"))


def test_a_missing_library_of_daidalus_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("DMUCA_DAIDALUS", str(tmp_path / "none.so"))
    with pytest.raises(ConfigError, match=r"DAIDALUS: .*none.so: .*build.sh"):
        daidalus()["Daidalus"](AvoidanceConfig())


@pytest.mark.skipif(
    "DMUCA_DAIDALUS" not in os.environ, reason="DMUCA_DAIDALUS names no library (docs/peers.md#daidalus)"
)
def test_daidalus_advises_the_nearest_direction_or_speed_once_a_second():
    law = daidalus()["Daidalus"](AvoidanceConfig())
    wanted, here = (5.0, 0.0, 0.0), (0.0, 0.0, -50.0)

    def asked(now_s, *others):
        tracks = tuple(
            TrackView(
                track_id=str(n), position_ned_m=place, velocity_ned_mps=velocity, age_s=0.0, radius_m=24.0,
                conflict=True, time_to_closest_s=9.0, closest_m=0.0,
            )
            for n, (place, velocity) in enumerate(others)
        )  # fmt: skip
        follow = LawResult(wanted, wanted, True, bool(others), False, (), tracks)
        neighbours = tuple(
            Neighbour(t.track_id, t.position_ned_m, t.velocity_ned_mps, 0.0, 3.0) for t in tracks
        )
        situation = Situation(now_s, now_s, here, wanted, 1.5, neighbours)
        return law.choose(situation, follow, LimitsConfig(max_speed_mps=8.0))

    head_on = ((100.0, 0.0, -50.0), (-5.0, 0.0, 0.0))
    assert asked(0.0) == wanted
    assert asked(0.5, head_on) == wanted
    n, e, d = asked(1.0, head_on)
    assert np.hypot(n, e) == pytest.approx(5.0)
    # The least turn that passes 30 m aside, in steps of two degrees. They close in by 8 m during the turn.
    turn_deg = np.degrees(np.arctan2(abs(e), n))
    at_once, after = (np.degrees(2.0 * np.arcsin(30.0 / away)) for away in (100.0, 92.0))
    assert at_once <= turn_deg <= after + 2.0
    assert d == 0.0
    far_above = ((100.0, 0.0, -90.0), (-5.0, 0.0, 0.0))
    assert asked(2.0, far_above) == wanted
    caught_up = ((-40.0, 0.0, -50.0), (7.5, 0.0, 0.0))
    assert asked(3.0, caught_up) != wanted
