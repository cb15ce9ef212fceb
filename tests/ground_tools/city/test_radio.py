"""The city's radio: probabilities agree with the channel equations, and choices with those aboard."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.arrays import Floats, Integers
from companion.atmc.choice import Choice
from companion.atmc.networks import SetNetwork
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.policy import load
from companion.atmc.policy_file import read
from companion.remote_id.region import Region
from companion.shipped import shipped
from ground_tools.campaign.world import World
from ground_tools.city.cells import CHANNEL, POLICY
from ground_tools.city.draws import Frames, draw_arrivals
from ground_tools.city.links import Grid
from ground_tools.city.loop import State
from ground_tools.city.measure import new_tally
from ground_tools.city.radio.choosing import ByPolicy, Fixed, Seen
from ground_tools.city.radio.network import SetValues, pool
from ground_tools.city.radio.reception import AnalyticRadio
from ground_tools.city.tables import new_air, new_fleet, new_near, new_tracks
from sitl_mocks.channel import Analytic, ChannelParameters, Fleet, all_links, draw_positions, load_parameters
from sitl_mocks.channel.link_budget import path_loss_db, ranges_m
from sitl_mocks.channel.packets.simulation import simulate
from sitl_mocks.channel.packets.timing import REAL

AIRCRAFT = 10


def radio_of(
    parameters: ChannelParameters, rates: Integers, positions: Floats
) -> tuple[AnalyticRadio, State]:
    """A radio that has computed the reception probabilities of aircraft at rest."""
    world, slots = World(delay_s=(0.0, 0.0)).conditions(0.2), len(positions)
    craft, air = new_fleet(slots, world), new_air(slots)
    craft.position[:], air.rates[:] = positions, rates
    air.flight[:] = np.arange(slots)
    grid = Grid(slots, ranges_m(parameters), craft.sent.shape[1], 1.0)
    links = grid.find(craft.position, air, np.zeros(slots, bool))
    state = State(craft, air, new_tracks(2, 2), links, new_near(slots), new_tally(1))
    used = {int(rate) for rate in rates.ravel() if rate}
    radio = AnalyticRadio(parameters, used, Fixed((0, 0, 1)), slots, 1.0, np.random.default_rng(1))
    radio.compute(np.arange(slots), state)
    return radio, state


def mean_delay_s(radio: AnalyticRadio, state: State, rates: Integers, i: int, e: int, mode: int) -> float:
    """Mean delay (s) that corresponds to the probability of a link."""
    j = int(state.links.other[e])
    p = -math.expm1(float(state.links.chance[state.links.back[e], mode]))
    wait_s = float(radio.frames.wait_s[j]) if mode == 2 else 0.0
    return (1.0 / p - 0.5) / int(rates[j, mode]) + float(radio.frames.offset_s[mode]) + wait_s


@pytest.mark.parametrize("channel", ["config/channel/paper.toml", CHANNEL])
def test_mean_delays_are_those_of_the_equations(channel: str) -> None:
    """The paper's ten aircraft at rest, each with a different set."""
    parameters = load_parameters(shipped(channel))
    rng = np.random.default_rng(3)
    positions = draw_positions(1, AIRCRAFT, 500.0, rng)[0]
    rates = np.array([[10, 0, 0], [0, 5, 0], [0, 0, 10], [10, 0, 10], [3, 2, 7]] * 2, np.int64)
    radio, state = radio_of(parameters, rates, positions)
    links = all_links(positions, parameters.propagation)
    found = Analytic(parameters).evaluate(links, Fleet(rates.astype(np.intp), np.full(AIRCRAFT, 1)))
    compared = 0
    for sender, receiver, carried, delays in zip(
        links.transmitter.tolist(), links.receiver.tolist(), found.carried, found.delay_s, strict=True
    ):
        start, end = state.links.start[receiver], state.links.start[receiver + 1]
        (e,) = [e for e in range(start, end) if state.links.other[e] == sender]
        for mode in np.flatnonzero(carried).tolist():
            here = mean_delay_s(radio, state, rates, receiver, e, mode)
            # The tables are interpolated, and probabilities are stored in single precision.
            assert here == pytest.approx(delays[mode], rel=0.003)
            compared += 1
    assert compared > 60


def test_draws_have_the_mean_delay_of_their_chance() -> None:
    parameters = load_parameters(shipped(CHANNEL))
    positions = np.array([[0.0, 0.0, 50.0], [100.0, 0.0, 60.0]])
    rates = np.array([[0, 0, 10], [0, 0, 2]], np.int64)
    radio, state = radio_of(parameters, rates, positions)
    rng = np.random.default_rng(4)
    delays, open_s, latest = [], [], -1.0
    for second in range(4000):
        draw_arrivals(rng, float(second), 0, 0, state.air.rates, state.links, radio.frames)
        open_s.append(float(second))
        at = float(state.links.arrival[state.links.start[1], 0])
        if math.isfinite(at):
            # A message also ends the delay of all earlier ones that did not arrive.
            delays += [at - sample for sample in open_s]
            open_s, latest = [], at
    wanted = mean_delay_s(radio, state, rates, 1, int(state.links.start[1]), 2)
    error = float(np.std(delays)) / math.sqrt(len(delays))
    assert latest > 0.0
    assert float(np.mean(delays)) == pytest.approx(wanted, abs=4.0 * error)


def test_draws_that_need_no_logarithm_are_those_of_the_logarithm() -> None:
    """Chances down to the least number in single precision: the same arrivals and the same state of the
    generator. Foreign transmissions for 0.98 of the time leave one beacon in 10^18."""
    rng, ours, theirs = (np.random.default_rng(seed) for seed in (1, 2, 2))
    air, grid = new_air(2), Grid(2, np.array([1.0, 1.0, 1.0]), 2, 1.0)
    air.flight[:] = 0, 1
    links, frames = grid.find(np.zeros((2, 3)), air, np.ones(2, bool)), Frames(1.0, np.zeros(3), np.zeros(2))
    arrived = 0
    for _ in range(5000):
        air.rates[0] = rng.integers(0, 11, 3)
        links.chance[links.start[0]] = -(10.0 ** rng.uniform(rng.choice([-6.0, -45.0]), 1.0, 3))
        draw_arrivals(ours, 5.0, 0, 0, air.rates, links, frames)
        wanted = math.inf
        for m, rate in enumerate(air.rates[0].tolist()):
            fails = links.chance[links.start[0], m].item()
            if rate > 0 and fails < 0.0:
                number = math.floor(math.log(1.0 - theirs.random()) / fails)
                if number < rate:
                    wanted = min(wanted, 5.0 + (number + theirs.random()) / rate)
        assert float(links.arrival[links.start[1], 0]) == wanted
        assert ours.bit_generator.state == theirs.bit_generator.state
        arrived += wanted < math.inf
    assert 1000 < arrived < 4000


def mean_age_s(arrivals: list[tuple[float, float]], from_s: float, to_s: float) -> float:
    """Mean age over a period, from the times at which messages arrive and were sent; NaN before the first
    message."""
    grid = np.arange(from_s, to_s, 0.02)
    newest = np.full(len(grid), np.nan)
    for at, sent in sorted(arrivals):
        later = grid >= at
        newest[later] = np.fmax(newest[later], sent)
    known = np.isfinite(newest)
    return float((grid - newest)[known].mean()) if known.any() else math.nan


@pytest.mark.parametrize(
    ("row", "side_m"), [((10, 0, 0), 700.0), ((0, 10, 0), 700.0), ((0, 0, 10), 2200.0), ((10, 0, 10), 700.0)]
)
def test_mean_ages_are_those_of_the_packets(row: tuple[int, int, int], side_m: float) -> None:
    """Fifty aircraft at rest, compared with the packet simulation: within 15 %."""
    parameters, number, length_s = load_parameters(shipped(CHANNEL)), 50, 25.0
    rng = np.random.default_rng(7)
    positions = draw_positions(1, number, side_m, rng)[0]
    rates = np.tile(np.array(row, np.int64), (number, 1))
    apart = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    loss_db = path_loss_db(apart, parameters.propagation)
    np.fill_diagonal(loss_db, np.nan)
    found = simulate(parameters, REAL, loss_db, rates, np.full(number, 1), length_s, rng)
    pairs = np.argwhere(found.carried.any(axis=2))
    some = {tuple(pair) for pair in pairs[rng.permutation(len(pairs))[:150]].tolist()}
    there: dict[tuple[int, ...], list[tuple[float, float]]] = {pair: [] for pair in some}
    here: dict[tuple[int, ...], list[tuple[float, float]]] = {pair: [] for pair in some}
    for event, by, at in zip(found.heard_event, found.heard_by, found.heard_s, strict=True):
        pair = int(found.transmitter[event]), int(by)
        if pair in some:
            there[pair].append((float(at), float(found.sample_s[event])))
    radio, state = radio_of(parameters, rates, positions)
    links, first_s = state.links, rng.random(number).tolist()
    for second, sender in np.ndindex(int(length_s), number):
        sent_s = second + first_s[sender]
        draw_arrivals(rng, sent_s, sender, 0, state.air.rates, links, radio.frames)
        for e in range(links.start[sender], links.start[sender + 1]):
            pair = sender, int(links.other[e])
            if pair in some and math.isfinite(links.arrival[links.back[e], 0]):
                here[pair].append((float(links.arrival[links.back[e], 0]), sent_s))
    packets, city = (
        float(np.nanmean([mean_age_s(heard[pair], 8.0, length_s) for pair in sorted(some)]))
        for heard in (there, here)
    )
    assert city == pytest.approx(packets, rel=0.15)


def test_a_policy_chooses_as_aboard() -> None:
    data = shipped(POLICY).read_bytes()
    policy = load(data, "policy")
    rng = np.random.default_rng(5)
    counts = np.array([0, 1, 7, 40, 99, 100, 3])
    rows = rng.random((int(counts.sum()), len(NEIGHBOUR_COLUMNS))).astype(np.float32)
    rows[:, 0] *= 0.9
    own = rng.random((len(counts), len(OWN_COLUMNS)))
    ends = np.cumsum(counts)
    rows[ends[6] - 1, 2] = 7.0  # far outside of what the policy was trained with
    chooser = ByPolicy(data, "policy", Region(), 10, 200)
    values, refused = chooser.values(Seen(own, rows, counts, np.zeros(len(counts))))
    assert refused.tolist() == [False] * 5 + [True, True]
    for one in range(5):
        seen = rows[ends[one] - counts[one] : ends[one]]
        choice = policy.choose(own[one], seen, np.ones(len(policy.actions), bool), None)
        assert isinstance(choice, Choice)
        assert values[one].argmax() == choice.index
        wanted = policy.values(own[one], seen)
        assert values[one] == pytest.approx(wanted, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("most", [1, 7, 9, 40, 128])
def test_sums_and_largest_values_of_each_aircraft_are_those_of_numpy_to_the_bit(most: int) -> None:
    rng = np.random.default_rng(most)
    count = np.array([most, 1, *rng.integers(1, most + 1, 30), most])
    h = np.maximum(1e3 * rng.normal(size=(count.sum(), 5)), 0.0).astype(np.float32)
    h[count[0], 2], h[-1, 0] = math.nan, math.inf
    starts, some = np.cumsum(count) - count, 2 * np.arange(len(count))
    found = np.zeros((2 * len(count), 12), np.float32)
    pool(h, starts, some, np.zeros((8, 5), np.float32), found)
    wanted = [np.add.reduceat(h, starts, axis=0), np.maximum.reduceat(h, starts, axis=0)]
    assert np.array_equal(found[some, :10], np.hstack(wanted), equal_nan=True)
    assert not found[1::2].any()
    assert not found[:, 10:].any()


def test_a_policy_that_admits_more_neighbours_has_the_values_of_one_aircraft_alone() -> None:
    """NumPy sums more than 128 numbers recursively."""
    _, tensors = read(shipped(POLICY).read_bytes(), "policy")
    rng = np.random.default_rng(8)
    count = np.array([3, 200, 0, 131])
    rows = rng.random((int(count.sum()), len(NEIGHBOUR_COLUMNS))).astype(np.float32)
    own = rng.random((len(count), len(OWN_COLUMNS))).astype(np.float32)
    found = SetValues(tensors).of(own, rows, count)
    network = SetNetwork(tensors, len(OWN_COLUMNS), len(NEIGHBOUR_COLUMNS), found.shape[1], "policy")
    ends = np.cumsum(count)
    for one in range(len(count)):
        wanted = network.values(own[one], rows[ends[one] - count[one] : ends[one]], 0)
        assert found[one] == pytest.approx(wanted, rel=1e-4, abs=1e-4)
