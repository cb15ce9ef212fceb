"""Positions and reception in training, against numbers computed by hand; and the training of the set network:
allowed actions, targets, and changes during a run."""

from __future__ import annotations

import itertools
import math

import pytest
import torch

from companion.atmc.actions import SET_ACTIONS, TRANSPORTS, able
from companion.atmc.observation import NEIGHBOUR_COLUMNS
from ground_tools.atmc.commands.evaluate import objective_of
from ground_tools.atmc.env.environment import Env, EnvSettings
from ground_tools.atmc.env.objective import difference_costs
from ground_tools.atmc.env.tasks import REGIONS, legal_sets
from ground_tools.atmc.env.world import MAX_ALTITUDE_M, MIN_ALTITUDE_M, World, WorldSettings, draw, move
from ground_tools.atmc.learners.flying_policy import FlyingLearner, FlyingSettings

BLE4 = NEIGHBOUR_COLUMNS.index("ble4")
CONFLICT = NEIGHBOUR_COLUMNS.index("conflict")
MOST = SET_ACTIONS.index((10, 10, 10))


@pytest.fixture(scope="module")
def objective():
    return objective_of("awareness")[0]


def world_of(position_m, velocity_mps, side_m=10_000.0):
    """Fleets (lists of aircraft) in squares of one size."""
    position = torch.tensor(position_m)
    fleets, aircraft, _ = position.shape
    return World(
        position,
        torch.tensor(velocity_mps),
        torch.full((fleets,), side_m),
        torch.zeros(fleets, aircraft, aircraft),
        torch.ones(fleets, aircraft, dtype=torch.long),
        torch.zeros(fleets, aircraft, 3),
    )


def pairs():
    """Pairs of aircraft 210 m apart: approaching at 20 m/s, departing, in formation, and one of them
    crossing."""
    apart = [[1000.0, 500.0, 60.0], [1210.0, 500.0, 60.0]]
    velocity = [
        [[15.0, 0.0, 0.0], [-5.0, 0.0, 0.0]],
        [[-15.0, 0.0, 0.0], [5.0, 0.0, 0.0]],
        [[20.0, 0.0, 0.0], [20.0, 0.0, 0.0]],
        [[0.0, 20.0, 0.0], [0.0, 0.0, 0.0]],
    ]
    return world_of([apart] * 4, velocity)


# ---------------------------------------------------------------- places


def test_closing_speed_is_the_decrease_of_distance():
    world = pairs()
    closing = world.closing_mps(world.distance_m())
    assert closing[:, 0, 1].tolist() == [20.0, -20.0, 0.0, 0.0]
    assert torch.equal(closing, closing.transpose(1, 2))
    before, after = world.distance_m(), move(world, 0.01).distance_m()
    assert ((before - after)[:, 0, 1] / 0.01).tolist() == pytest.approx([20.0, -20.0, 0.0, 0.0], abs=0.05)


def test_approaching_aircraft_have_more_weight(objective):
    env = Env(EnvSettings(), objective, 4, 2, torch.Generator().manual_seed(1))
    env.place(pairs())
    wanted = [0.5, 0.0625, 0.0625, 0.0625]
    assert env.observe().rows[:, 0, 1, CONFLICT].tolist() == pytest.approx(wanted)
    assert env.air.weight[:, 1, 0].tolist() == pytest.approx(wanted)
    assert (env.air.weight.diagonal(dim1=1, dim2=2) == 0.0).all()


@pytest.mark.parametrize(
    ("seconds", "position", "velocity"),
    [
        (1.0, [[90.0, 60.0, 115.0], [15.0, 49.0, 31.0]], [[-20.0, 10.0, -10.0], [20.0, -1.0, 2.0]]),
        (0.1, [[92.0, 51.0, 116.0], [3.0, 49.9, 30.8]], [[20.0, 10.0, 10.0], [-20.0, -1.0, -2.0]]),
        # In one step, one aircraft crosses the small square and the other crosses it and comes back.
        (11.0, [[90.0, 40.0, 45.0], [15.0, 39.0, 51.0]], [[-20.0, -10.0, 10.0], [20.0, -1.0, 2.0]]),
    ],
)
def test_they_turn_back_at_the_edges(seconds, position, velocity):
    start = [[90.0, 50.0, 115.0], [5.0, 50.0, 31.0]]
    begins = [[20.0, 10.0, 10.0], [-20.0, -1.0, -2.0]]
    world = move(world_of([start], [begins], side_m=100.0), seconds)
    assert world.position_m[0].tolist() == [pytest.approx(place, abs=1e-3) for place in position]
    assert world.velocity_mps[0].tolist() == velocity


def test_nobody_leaves_the_square():
    world = draw(WorldSettings(sides="paper"), 60, 5, torch.Generator().manual_seed(1))
    before = world
    for _ in range(50):
        world = move(world, 7.0)
        level, height = world.position_m[..., :2], world.position_m[..., 2]
        assert (level >= 0.0).all()
        assert (level <= world.side_m[:, None, None] + 1e-3).all()
        assert ((height >= MIN_ALTITUDE_M) & (height <= MAX_ALTITUDE_M + 1e-3)).all()
    assert torch.equal(world.velocity_mps.abs(), before.velocity_mps.abs())
    assert not torch.equal(world.velocity_mps, before.velocity_mps)


# ---------------------------------------------------------------- what is heard


def test_a_sender_is_heard_if_a_message_came_in_the_last_three_seconds(objective):
    """Receptions form a Poisson stream with the channel's mean delay."""
    world = WorldSettings(sides=100.0, load=(0.0, 0.8), bluetooth_load=(0.7, 0.7))
    env = Env(EnvSettings(world=world, lossy=True), objective, 3000, 2, torch.Generator().manual_seed(1))
    env.act(torch.full_like(env.action, SET_ACTIONS.index((3, 0, 0))))
    channel, link = env.channel, (slice(None), 0, 1)
    packets = channel.packets(env.air.reach, channel.loads(env.air.reach, env.action))
    level = channel.level_of[env.action][:, None, :, 0]
    delay_s = torch.exp(channel.log_delay_at(0, level, packets))[link]
    assert 1.0 < float(delay_s.min()) < 2.0 < float(delay_s.max()) < 5.0
    wanted = float((1.0 - torch.exp(-3.0 / delay_s)).mean())
    seen = env.observe()
    assert float(seen.heard[link].mean()) == pytest.approx(wanted, abs=0.03)
    assert torch.equal(seen.rows[..., BLE4], seen.heard)


# ---------------------------------------------------------------- who may send what


def learner_of(seed=1, **settings):
    small = {"fleets": ((4, 8),), "episodes": 4, "updates": 5, "anew": 0.0, "going_on": 0.0}
    return FlyingLearner(FlyingSettings(**{**small, **settings}), seed)


def patterns():
    """For each region, the allowed actions with its rules and every set of radios; without the radios if none
    is left."""
    found = []
    for law in legal_sets(SET_ACTIONS):
        kept = {tuple(law)}
        for count in range(1, 4):
            for radios in itertools.combinations(TRANSPORTS, count):
                left = law & able(SET_ACTIONS, radios)
                kept.add(tuple(left if left.any() else law))
        found.append(kept)
    return found


@pytest.mark.parametrize("masked", [0.0, 1.0])
def test_groups_contain_all_regions_and_all_sets_of_radios(masked):
    (group,) = learner_of(fleets=((4, 500),), masked=masked)._groups
    drawn = [{tuple(each) for each in fleet} for fleet in group.allowed.tolist()]
    if masked:
        # In half of the environments every aircraft's radios lack a transport.
        by_law = patterns()
        assert set().union(*drawn) == set().union(*by_law)
        assert all(any(fleet <= kept for kept in by_law) for fleet in drawn)
        assert 150 < sum(len(fleet) > 1 for fleet in drawn) < 350
    else:
        laws = {tuple(law) for law in legal_sets(SET_ACTIONS)}
        assert len(laws) == len(REGIONS) == 3
        assert set().union(*drawn) == laws
        assert all(len(fleet) == 1 for fleet in drawn)


# ---------------------------------------------------------------- what is learned


def test_an_aircraft_that_hears_nobody_sends_as_often_as_possible():
    """Without listeners, each message per second is worth a tenth of a millisecond."""
    learner = learner_of(fleets=((2, 3),))
    (group,) = learner._groups
    group.allowed[:] = True
    far = [[0.0, 0.0, 50.0], [9000.0, 9000.0, 50.0]]
    group.env.place(world_of([far] * 3, [[[0.0, 0.0, 0.0]] * 2] * 3))
    target = learner._target(group, torch.arange(2))
    wanted = torch.tensor([-1e-4 * (30 - sum(action)) for action in SET_ACTIONS])
    assert torch.allclose(target, wanted.expand_as(target), atol=1e-7)
    assert (target.argmax(-1) == MOST).all()


def test_targets_are_seconds_per_aircraft_that_needs_the_information():
    learner = learner_of(fleets=((5, 16),), regret_limit_s=100.0)
    (group,) = learner._groups
    acting = torch.tensor([3, 0, 1])
    target = learner._target(group, acting)
    _, cost = difference_costs(learner._objective, group.env.air, group.env.action, acting)
    others = 0.01 + group.env.air.weight.sum(1)[:, acting]
    # The weights range from almost 0 to more than one aircraft.
    assert float(others.min()) < 0.1
    assert float(others.max()) > 1.0
    price = 1e-4 * torch.tensor([float(sum(action)) for action in SET_ACTIONS])
    each = cost / others[..., None] - price
    allowed = group.allowed[:, acting]
    best = each.masked_fill(~allowed, torch.inf).amin(-1, keepdim=True)
    wanted = -(each - best).clamp(min=0.0)
    assert torch.allclose(target, wanted, atol=1e-6)
    assert float(wanted.min()) < -0.3


def zero(net):
    for parameter in net.parameters():
        parameter.data.zero_()


def test_the_loss_weights_allowed_actions_by_importance(monkeypatch):
    learner = learner_of(acting=(1.0, 1.0))
    (group,) = learner._groups
    zero(learner._net)
    group.allowed[:] = True
    group.allowed[..., 5] = False

    def target(group, acting):
        found = torch.full((8, len(acting), len(SET_ACTIONS)), -3.0)
        found[:, 0] = -1.0
        found[..., 5] = -1000.0
        return found

    def importance(group, acting):
        weight = torch.ones(8, len(acting))
        weight[:, 0] = len(acting) - 1.0
        return weight

    monkeypatch.setattr(learner, "_target", target)
    monkeypatch.setattr(learner, "_importance", importance)
    # The first aircraft has the same weight as all others together.
    loss, _ = learner._update(group, 0.0)
    assert float(loss) == pytest.approx(50.0 * (1.0 + 9.0) / 2.0)


@pytest.mark.parametrize("random", [0.0, 1.0])
def test_forbidden_actions_are_neither_learned_nor_sent(random):
    learner = learner_of(fleets=((4, 100),), acting=(1.0, 1.0), exploration=(random, random))
    (group,) = learner._groups
    refused = torch.zeros(len(SET_ACTIONS), dtype=torch.bool)
    refused[[3, 17, MOST]] = True
    group.allowed[:] = ~refused
    # The network prefers the actions that are not allowed.
    learner._net.out.bias.data[refused] = 10.0
    before = learner._net.out.weight.detach().clone()
    learner.train()
    changed = (learner._net.out.weight.detach() != before).any(1)
    assert torch.equal(changed, ~refused)
    assert group.allowed[..., 0].all()
    assert not refused[group.env.action].any()


# ---------------------------------------------------------------- how a run goes on


def test_learning_slows_down_along_a_cosine(monkeypatch):
    learner = learner_of(learning_rate=(1e-2, 1e-3))
    rates, shares = [], []

    def update(group, share):
        rates.append(learner._optimiser.param_groups[0]["lr"])
        shares.append(share)
        return torch.zeros(()), torch.zeros(())

    monkeypatch.setattr(learner, "_update", update)
    rows = [learner.train() for _ in range(learner.rounds)]
    assert shares == pytest.approx([k / 20 for k in range(20)])
    assert (rates[0], rates[10]) == pytest.approx((1e-2, 5.5e-3))
    assert rates == pytest.approx([1e-3 + 9e-3 * math.cos(math.pi * k / 40) ** 2 for k in range(20)])
    assert [row["learning_rate"] for row in rows] == rates[4::5]


@pytest.mark.parametrize(("share", "random"), [(0.0, 0.8), (0.5, 0.5), (1.0, 0.2)])
def test_exploration_decreases(share, random):
    learner = learner_of(fleets=((4, 500),), exploration=(0.8, 0.2))
    (group,) = learner._groups
    group.allowed[:] = True
    greedy = torch.full((500, 4), MOST)
    learner._act(group, torch.arange(4), greedy, share)
    others = (group.env.action != MOST).float().mean()
    actions = len(SET_ACTIONS)
    assert float(others) == pytest.approx(random * (actions - 1) / actions, abs=0.05)


def state_of(group):
    env = group.env
    return env.world.position_m, env.world.side_m, env.identity, group.allowed


@pytest.mark.parametrize(
    ("anew", "going_on", "kept"),
    [
        (0.0, 0.0, [True, True, True, True]),
        (0.0, 1.0, [False, True, True, True]),
        (1.0, 0.0, [False, False, False, False]),
    ],
)
def test_positions_advance_or_environments_are_redrawn(anew, going_on, kept):
    learner = learner_of(fleets=((4, 20),), anew=anew, going_on=going_on)
    (group,) = learner._groups
    before = [part.clone() for part in state_of(group)]
    learner._act(group, torch.arange(4), group.env.action, 0.5)
    assert [torch.equal(a, b) for a, b in zip(before, state_of(group), strict=True)] == kept


def test_positions_advance_and_environments_are_redrawn_with_their_probabilities(monkeypatch):
    learner = learner_of(anew=0.2, going_on=0.5)
    (group,) = learner._groups
    counts = {"reset": 0, "go_on": 0}
    for name in counts:

        def count(name=name):
            counts[name] += 1

        monkeypatch.setattr(group.env, name, count)
    for _ in range(400):
        learner._act(group, torch.arange(4), group.env.action, 0.5)
    assert counts["reset"] == pytest.approx(80, abs=30)
    assert counts["go_on"] == pytest.approx(200, abs=40)


def test_a_group_continues_in_its_redrawn_environments():
    """In whole rounds, every update leaves new positions, rules and radios."""
    learner = learner_of(anew=1.0, fleets=((4, 20), (3, 20)))
    seen = [[part.clone() for part in state_of(group)] for group in learner._groups]
    learner.train()
    for group, before in zip(learner._groups, seen, strict=True):
        for part, old in zip(state_of(group), before, strict=True):
            assert not torch.equal(part, old)
