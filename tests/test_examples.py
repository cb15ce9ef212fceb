"""The example projects in docs/examples do what they say."""

import runpy
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config import AtmcConfig
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
