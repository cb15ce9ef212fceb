"""The set network: its training targets, its learning, and its policy file."""

from __future__ import annotations

import copy
import itertools
import json

import msgspec
import numpy as np
import pytest
import torch

from companion.atmc.actions import SET_ACTIONS
from companion.atmc.observation import OWN_COLUMNS
from companion.atmc.policy import load
from ground_tools.atmc.commands.evaluate import Frozen, Question, evaluate, objective_of
from ground_tools.atmc.env.deciders import Chance, Fixed, settle
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.objective import costs
from ground_tools.atmc.env.search import search
from ground_tools.atmc.env.world import WorldSettings
from ground_tools.atmc.learners import validation
from ground_tools.atmc.learners.flying_policy import FlyingLearner, FlyingSettings
from ground_tools.cli import main

SMALL = FlyingSettings(fleets=((3, 24), (6, 12)), episodes=4, updates=6)
SMALL_PAPER = msgspec.structs.replace(SMALL, objective="paper")


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)


@pytest.fixture(scope="module")
def learned():
    """A short run on the paper's objective."""
    settings = FlyingSettings(objective="paper", fleets=((5, 96), (10, 48)), episodes=4, updates=30)
    learner = FlyingLearner(settings, 1)
    learner.rows = [learner.train() for _ in range(learner.rounds)]
    return learner


@pytest.mark.parametrize("settings", [SMALL, SMALL_PAPER], ids=["awareness", "paper"])
def test_a_resumed_run_is_the_uninterrupted_one(settings, monkeypatch):
    monkeypatch.setattr(validation, "_FLEETS", dict.fromkeys(("paper", "awareness"), ((3, 2),)))
    settings = msgspec.structs.replace(settings, fleets=((3, 8), (6, 4)), updates=2)

    def rounds(learner, number):
        return [(learner.train(), learner.validate(), learner.frozen("x", {})) for _ in range(number)]

    whole = FlyingLearner(settings, 3)
    rounds(whole, 1)
    state = copy.deepcopy(whole.state())
    rest = rounds(whole, 2)
    resumed = FlyingLearner(settings, 99)
    resumed.load(state)
    assert rounds(resumed, 2) == rest
    assert resumed.validate() == whole.validate() == rest[-1][1]


def test_the_same_seed_gives_the_same_run_and_another_seed_another_one():
    runs = [FlyingLearner(SMALL, seed).train() for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


def test_measured_survival_is_unbiased_and_noisier_with_fewer_packets():
    objective, _ = objective_of("awareness")
    errors = []
    for rate in ((10, 0, 10), (3, 0, 2)):
        world = WorldSettings(sides=100.0, load=(0.5, 0.5))
        env = Env(EnvSettings(world=world, lossy=True), objective, 200, 5, torch.Generator().manual_seed(3))
        env.action = torch.full_like(env.action, SET_ACTIONS.index(rate))
        channel = env.channel
        packets = channel.packets(env.air.reach, channel.loads(env.air.reach, env.action))
        alive = torch.exp(packets.ble4).sum(2) - torch.exp(packets.ble4).diagonal(dim1=1, dim2=2)
        own = env.observe().own
        told, known = (
            own[..., OWN_COLUMNS.index("ble4_success")],
            own[..., OWN_COLUMNS.index("ble4_measured")],
        )
        assert float(known.mean()) > 0.9
        error = told[known > 0] - (alive / 4.0)[known > 0]
        assert abs(float(error.mean())) < 0.03
        errors.append(float(error.std()))
    assert 0.03 < errors[0] < 0.8 * errors[1]


def test_an_aircraft_without_listeners_learns_the_fastest_action():
    learner = FlyingLearner(msgspec.structs.replace(SMALL_PAPER, fleets=((2, 8),)), 1)
    (group,) = learner._groups
    world = group.env.world
    world.position_m[:] = torch.tensor([[0.0, 0.0, 50.0], [9000.0, 0.0, 50.0]])
    group.env.place(world)
    target = learner._target(group, torch.arange(2))
    delay_s = group.env.channel.undisturbed_s()
    assert (target.argmax(-1) == delay_s.argmin()).all()
    assert (target[..., delay_s.argmax()] < -0.05).all()


def test_rare_large_losses_count_with_their_mean(monkeypatch):
    """Of ten targets, one is -1 s, independent of the observation. The mean is learned, so it is not treated
    as an outlier."""
    settings = msgspec.structs.replace(SMALL, fleets=((3, 64),), episodes=2, updates=120, average=0.95)
    learner = FlyingLearner(settings, 1)
    drawn = torch.Generator().manual_seed(2)

    def target(group, acting):
        shape = group.allowed[:, acting].shape
        return -(torch.rand(shape, generator=drawn) < 0.1).float()

    monkeypatch.setattr(learner, "_target", target)
    learner.train()
    learner.train()
    seen = learner._select(learner._groups[0].env.observe())
    learned = learner._average(seen.own, seen.rows, seen.heard)
    assert float(learned.detach().mean()) == pytest.approx(-0.1, abs=0.02)


def test_samples_are_weighted_by_the_aircrafts_importance_in_its_fleet():
    learner = FlyingLearner(msgspec.structs.replace(SMALL, fleets=((4, 8),)), 1)
    (group,) = learner._groups
    position = torch.tensor([[0.0, 0.0, 50.0], [60.0, 0.0, 50.0], [400.0, 0.0, 50.0], [9000.0, 0.0, 50.0]])
    group.env.world.position_m[:] = position
    group.env.world.velocity_mps[:] = 0.0
    group.env.place(group.env.world)
    weight = learner._importance(group, torch.arange(4))
    matters = 0.01 + group.env.air.weight.sum(1)
    ratio = matters / matters.mean(1, keepdim=True)
    assert (weight[:, :2] == ratio[:, :2]).all()
    assert (weight[:, 0] > 1.5).all()
    assert (ratio[:, 3] < 0.1).all()
    assert (weight[:, 3] == 0.1).all()
    paper = FlyingLearner(msgspec.structs.replace(SMALL_PAPER, fleets=((4, 8),)), 1)
    assert (paper._importance(paper._groups[0], torch.arange(4)) == 1.0).all()


def test_regret_falls_in_training(learned):
    assert learned.rows[-1]["regret_ms"] < 0.5 * learned.rows[0]["regret_ms"]


@pytest.mark.usefixtures("brief")
def test_no_method_beats_the_search(learned):
    found = evaluate(learned.frozen("short", {}), "short", Question("paper", samples=8))
    for other in ("dynamic_ms", "best_fixed_dynamic_ms", "best_fixed_by_side_dynamic_ms", "rule_dynamic_ms"):
        assert found[other] >= found["search_dynamic_ms"]
    assert found["best_fixed_dynamic_ms"] >= found["best_fixed_by_side_dynamic_ms"]
    assert found["dynamic_ms"] == pytest.approx((found["high_ms"] + found["low_ms"]) / 2.0, abs=0.01)


def test_numpy_aboard_and_pytorch_agree(learned):
    data = learned.frozen("short", {})
    fleet, policy = Frozen(data, "short"), load(data, "short")
    objective, _ = objective_of("paper")
    env = Env(EnvSettings(), objective, 20, 10, torch.Generator().manual_seed(5))
    seen = env.observe()
    choice = fleet.decide(seen, env.action)
    allowed = np.ones(30, bool)
    differences = []
    for e in range(20):
        for n in range(10):
            heard = seen.heard[e, n] > 0
            own, rows = seen.own[e, n].double().numpy(), seen.rows[e, n][heard].double().numpy()
            values = policy.values(own, rows)
            assert policy.choose(own, rows, allowed, int(env.action[e, n])).index == int(choice[e, n])
            with torch.no_grad():
                theirs = learned._average(
                    seen.own[e, n][learned._own], seen.rows[e, n][:, learned._columns], seen.heard[e, n]
                )
            differences.append(np.abs(values - theirs.numpy()).max())
    assert max(differences) <= 1e-5


def test_forbidden_actions_are_never_targets():
    learner = FlyingLearner(SMALL, 5)
    for group in learner._groups:
        target = learner._target(group, torch.arange(group.env.aircraft))
        assert group.allowed.any(-1).all()
        best = target.masked_fill(~group.allowed, -torch.inf).amax(-1)
        assert (best == 0.0).all()
        # Some radios lack a transport, and some regions do not allow one.
        assert not group.allowed.all()


def test_the_search_is_never_above_where_it_began_and_finds_the_best_of_two_aircraft():
    objective, actions = objective_of("awareness")
    generator = torch.Generator().manual_seed(1)
    env = Env(EnvSettings(world=WorldSettings(sides=500.0)), objective, 8, 2, generator)
    allowed = torch.tensor([action[1] == 0 for action in actions])
    env.action = allowed.nonzero()[:, 0][env.action % int(allowed.sum())]
    found = search(objective, env.air, [env.action], allowed, generator)
    least = torch.full((8,), torch.inf)
    for first, second in itertools.product(allowed.nonzero()[:, 0].tolist(), repeat=2):
        pair = torch.tensor([first, second]).expand(8, 2)
        least = torch.minimum(least, costs(objective, env.air, pair).sum(1))
    total = costs(objective, env.air, found).sum(1)
    assert (total <= costs(objective, env.air, env.action).sum(1) + 1e-9).all()
    assert total.numpy() == pytest.approx(least.numpy(), rel=0.01, abs=1e-5)


def test_the_search_keeps_to_what_is_allowed():
    objective, actions = objective_of("awareness")
    generator = torch.Generator().manual_seed(1)
    env = Env(EnvSettings(world=WorldSettings(sides=500.0)), objective, 4, 6, generator)
    allowed = torch.tensor([action[2] == 0 for action in actions])
    start = torch.full_like(env.action, SET_ACTIONS.index((10, 10, 0)))
    found = search(objective, env.air, [start], allowed, generator)
    assert allowed[found].all()


def test_settle_lets_every_aircraft_decide_once_per_round():
    objective, _ = objective_of("paper")
    generator = torch.Generator().manual_seed(1)
    env = Env(EnvSettings(), objective, 3, 10, generator)
    assert len(settle(env, Fixed(7), 1, generator)) == 4
    assert (env.action == 7).all()
    allowed = torch.zeros(30, dtype=torch.bool)
    allowed[3] = True
    settle(env, Chance(allowed, generator), 1, generator)
    assert (env.action == 3).all()


# ---------------------------------------------------------------- the command


@pytest.mark.usefixtures("brief")
def test_evaluate_prints_one_object(learned, tmp_path, capsys):
    path = tmp_path / "p.safetensors"
    path.write_bytes(learned.frozen("short", {}))
    options = ["--policy", str(path), "--uavs", "5", "--samples", "2", "--json"]
    assert main(["atmc", "evaluate", *options]) == 0
    first = json.loads(capsys.readouterr().out)
    wanted = {
        "high_ms",
        "low_ms",
        "dynamic_ms",
        "best_fixed_dynamic_ms",
        "rule_dynamic_ms",
        "search_dynamic_ms",
        "decision_us_median",
        "switches_per_min",
        "vs_best_fixed_pct",
        "places_worse_pct",
        "ratio_p99",
        "worse_side_10000",
    }
    assert wanted <= first.keys()
    assert main(["atmc", "evaluate", *options]) == 0
    second = json.loads(capsys.readouterr().out)
    del first["decision_us_median"], second["decision_us_median"]
    assert first == second
    assert main(["atmc", "evaluate", *options[:-1]]) == 0
    assert "one-line rule" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--uavs", "1"], "--uavs: 1 is out of range; allowed: 2 to"),
        (["--uavs", "50"], "trained with up to 10 aircraft"),
        (["--objective", "awareness"], "trained for 'paper'"),
        (["--load", "0.5"], "--load: the paper's objective"),
        (["--load", "2"], "--load: 2 is out of range; allowed: 0 to 0.95"),
        (["--samples", "0"], "--samples: 0 is out of range; allowed: 1 or more"),
        (["--seed", "-1"], "--seed: -1 is out of range; allowed: 0 to 4294967295"),
        (["--sigma", "99"], "--sigma: 99 is out of range; allowed: 0 to 30"),
    ],
)
def test_evaluate_refuses_wrong_options(learned, tmp_path, capsys, options, words):
    path = tmp_path / "p.safetensors"
    path.write_bytes(learned.frozen("short", {}))
    assert main(["atmc", "evaluate", "--policy", str(path), *options]) == 2
    assert words in capsys.readouterr().err


def test_a_damaged_policy_file_is_named(tmp_path, capsys):
    path = tmp_path / "p.safetensors"
    assert main(["atmc", "evaluate", "--policy", str(path)]) == 2
    assert "p.safetensors: cannot be read: No such file" in capsys.readouterr().err
    path.write_bytes(b"nothing")
    assert main(["atmc", "evaluate", "--policy", str(path)]) == 2
    assert "not a safetensors file" in capsys.readouterr().err
