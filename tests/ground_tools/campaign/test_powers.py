"""Signal strength in the campaign: the measurement, the companion's evaluation, and the effect."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec.structs import replace

from companion.avoidance import kernels as k
from companion.traffic.signal_strength import FARTHEST_M, SignalWitness
from ground_tools.campaign import cells, powers, vehicles
from ground_tools.campaign.cells import Cell
from ground_tools.campaign.world import World
from sitl_mocks.channel.parameters import ChannelParameters

LIARS = Cell(
    generator="circle", aircraft=5, delay_s=(1.0, 2.0), intruders=0.2, intruder="liar", rate=5, signal=True
)
WORLD = World(signal=True, delay_s=(0.0, 0.0)).conditions(0.2)


def two(position, world=WORLD):
    """Two aircraft. The first one avoids, and a message of the second arrives at time 0."""
    craft = vehicles.on_the_ground(2, world)
    craft.position[1] = position
    craft.arrival[0, 1, 0] = 0.0
    heard = np.zeros((2, 2, vehicles.MESSAGE_COLUMNS))
    heard[0, 1, vehicles.M_POSITION : vehicles.M_VELOCITY] = position
    kinds = np.array([vehicles.AVOIDS, vehicles.BLIND], float)
    return craft, heard, kinds


def test_the_power_is_that_of_the_channel_model() -> None:
    """Mean and standard deviation of 4,000 measurements, with a link that is 3 dB too strong."""
    craft, heard, kinds = two((30.0, 40.0, 0.0))
    rng, measured = np.random.default_rng(1), []
    for _ in range(4000):
        state = powers.unmeasured(rng, WORLD, 2)
        state.link_db[0, 1] = 3.0
        powers.measure_powers(rng, WORLD, 0, kinds, craft, heard, state)
        measured.append(state.means[0, 1, 0, k.HYPOTHESES - 1])  # without a loss: the power itself
        assert math.isinf(state.covariance[1, 0, 0]), "who does not avoid measures nothing"
    channel = ChannelParameters()
    loss_db = channel.propagation.loss_at_1m_db + 10.0 * channel.propagation.exponent * math.log10(50.0)
    assert np.mean(measured) == pytest.approx(channel.wifi.transmit_power_dbm - loss_db + 3.0, abs=0.3)
    assert np.std(measured) == pytest.approx(4.5, abs=0.2)


def test_links_differ_by_power_and_shadowing() -> None:
    """All links of a sender share its power, so their covariance is the variance of that power."""
    links = np.array([powers.unmeasured(np.random.default_rng(n), WORLD, 3).link_db for n in range(3000)])
    assert np.std(links) == pytest.approx(math.hypot(4.0, 4.0), abs=0.15)
    assert np.cov(links[:, 0, 2], links[:, 1, 2])[0, 1] == pytest.approx(16.0, abs=1.5)
    assert np.cov(links[:, 0, 1], links[:, 0, 2])[0, 1] == pytest.approx(0.0, abs=1.5)


def test_nothing_is_weighed_from_afar_or_before_the_first_message_is_known() -> None:
    rng = np.random.default_rng(2)
    for place, known in (((FARTHEST_M + 1.0, 0.0, 0.0), True), ((50.0, 0.0, 0.0), False)):
        craft, heard, kinds = two(place)
        heard[0, 1, vehicles.M_TIME] = 0.0 if known else -math.inf
        state = powers.unmeasured(rng, WORLD, 2)
        powers.measure_powers(rng, WORLD, 0, kinds, craft, heard, state)
        assert math.isinf(state.covariance[0, 1, 0])


def test_powers_are_weighed_as_aboard(monkeypatch) -> None:
    """Agrees bit for bit with the companion's `SignalWitness`, given each power that the campaign weighs."""
    witness, state = SignalWitness(), powers.unmeasured(np.random.default_rng(3), WORLD, 2)
    now, weighed = 0.0, 0

    def note_power(log, means, covariance, passed_s, rssi_dbm, north, east, down):
        nonlocal weighed
        weighed += 1
        assert witness.add("wifi/a", rssi_dbm, (north, east, down), now)
        k.note_power(log, means, covariance, passed_s, rssi_dbm, north, east, down)

    watched = SimpleNamespace(note_power=note_power, suspicion=k.suspicion)
    monkeypatch.setattr(powers, "k", watched)
    monkeypatch.setattr(powers, "_measure_power", powers._measure_power.py_func)
    rng = np.random.default_rng(4)
    for tick in range(0, 400, 2):
        now = WORLD.start_s + tick * WORLD.step_s
        true = 120.0 - 3.0 * now, 4.0, 0.0
        craft, heard, kinds = two(true)
        craft.arrival[0, 1, 0] = now
        heard[0, 1, vehicles.M_TIME] = now
        heard[0, 1, vehicles.M_POSITION + 1] += 50.0
        powers.measure_powers.py_func(rng, WORLD, tick, kinds, craft, heard, state)
    found = state.suspicion[0, 1]
    assert weighed == 200
    assert tuple(witness.suspicion) == tuple(found[: powers.S_EAST + 1].tolist())
    assert found[powers.S_FLAGGED] == 1.0


@pytest.mark.parametrize("intruder", ["blind", "liar"])
def test_without_signal_strength_nothing_changes(intruder) -> None:
    """Powers use a separate random stream: while nobody is suspected, a flight is the same bit for bit."""
    cell = replace(LIARS, intruder=intruder)
    seen, without = cells.look(cell, 1), cells.look(replace(cell, signal=False), 1)
    suspected = np.flatnonzero((seen.trace != without.trace).any(axis=(1, 2)))
    if intruder == "blind":
        assert not len(suspected)
    else:
        assert len(suspected), "a liar is suspected"
        assert suspected[0] > 300, "but not from the start"


def test_liars_lose_less() -> None:
    """Sixteen flights; docs/safety-results.md has a thousand."""
    seeds = range(300001, 300017)
    with_signal, without = cells.fly(LIARS, seeds), cells.fly(replace(LIARS, signal=False), seeds)
    assert cells.lost(without) >= 11
    assert cells.lost(with_signal) <= 0.7 * cells.lost(without)
    assert sum(bool(row.flagged) for row in with_signal) >= 14
    assert not any(sender for row in with_signal for _, sender in row.flagged), "only aircraft 0 lies"
    assert not any(row.flagged for row in without)
