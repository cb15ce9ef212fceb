"""The policy of a plug-in: evaluation, demo flights, and the closed loop."""

from __future__ import annotations

import argparse
import json

import numpy as np
import pytest
import torch

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.plugin_policy import plugin_policy
from companion.config import AtmcConfig
from companion.shipped import shipped
from ground_tools.atmc.commands import evaluate
from ground_tools.atmc.env.deciders import Fixed
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.plugged import Plugged
from ground_tools.cli import main
from ground_tools.paper.closed_loop import command as closed_loop
from ground_tools.paper.closed_loop.cells import cell
from ground_tools.paper.closed_loop.flights import ATMC, scenario_of
from sitl_mocks.encounters import lockstep
from sitl_mocks.encounters.scenario_file import PathSettings, Scenario
from tests.support import plugged


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    """Install the policies of `plugged.POLICIES`."""
    yield from plugged.installed(tmp_path, monkeypatch, "plugged_policies", plugged.policies)


def test_the_decider_asks_the_policy_for_each_aircraft():
    objective, _ = evaluate.objective_of("awareness")
    generator = torch.Generator().manual_seed(1)
    env = Env(EnvSettings(), objective, 2, 3, generator)
    decider = Plugged(plugin_policy("plugin:first"), np.arange(len(SET_ACTIONS)) >= 7)
    assert torch.equal(decider.decide(env.observe(), env.action), Fixed(7).decide(env.observe(), env.action))


@pytest.mark.usefixtures("brief")
def test_a_constant_policy_is_evaluated_like_its_fixed_mode(capsys):
    assert (
        main(
            [
                "atmc",
                "evaluate",
                "--policy",
                "plugin:first",
                "--samples",
                "2",
                "--uavs",
                "3",
                "--no-guard",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert (found["policy"], found["objective"], found["switches_per_min"]) == ("first", "awareness", 0.0)
    question = evaluate.Question("awareness", uavs=3, samples=2)
    again = evaluate.evaluate_plugin(plugin_policy("plugin:first"), question)
    assert again["dynamic_ms"] == found["dynamic_ms"] > found["best_fixed_dynamic_ms"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("far", "its actions are neither companion.atmc.actions.PAPER_ACTIONS nor SET_ACTIONS"),
        ("lost", "failed: KeyError: 'weights'"),
        ("gone", "'gone': no plug-in of dmuca.policies"),
    ],
)
def test_policies_with_other_actions_are_not_evaluated(name, words, capsys):
    assert main(["atmc", "evaluate", "--policy", f"plugin:{name}", "--samples", "2", "--uavs", "3"]) == 2
    assert words in capsys.readouterr().err


def test_a_plugin_policy_flies_in_the_demo():
    scenario = Scenario(
        path=(
            PathSettings(points=((0.0, -25.0, 60.0, -60.0), (8.0, 25.0, 60.0, -60.0))),
            PathSettings(points=((0.0, 25.0, 0.0, -60.0), (8.0, -25.0, 0.0, -60.0))),
        ),
        atmc=AtmcConfig(policy="plugin:far"),
    )
    for flown in lockstep.fly(scenario, 1).chosen.values():
        assert "ble4 5 + ble5 5 + wifi 5" in flown.seconds, "as it hears the other one"
        assert flown.fallback_s == 0.0


def test_a_plugin_policy_flies_in_the_closed_loop(site):
    region = shipped("config/regions/us.toml")
    args = argparse.Namespace(policy="plugin:far", region=region, seed=1, encounters=2, crowd=1)
    flights = closed_loop.flights_of(args, "sparse", ATMC)
    assert {flight.plugin for flight in flights} == {"plugin:far"}
    assert scenario_of(flights[0])[0].atmc.policy == "plugin:far"
    kept = cell(site, flights[0], 1)
    kept.add([])
    written = kept.path.read_text()
    assert '"policy":null' not in written.replace(" ", "")
