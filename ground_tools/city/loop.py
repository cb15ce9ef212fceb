"""The steps of all aircraft in the air, in compiled code: send, receive, decide, move, measure.

A step does the same as a step of `ground_tools.campaign.flight`: the same vehicles, messages and decisions,
in the same order and with the same random draws. Tests compare the commands of both, bit for bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import OLDEST_S
from ground_tools.campaign.vehicles import Fleet, move, send
from ground_tools.campaign.world import Conditions
from ground_tools.city.compiled import compiled
from ground_tools.city.draws import Frames, draw_arrivals, put_arrival
from ground_tools.city.flights import Flights
from ground_tools.city.judging import Judge
from ground_tools.city.measure import Tally, measure, note_decision
from ground_tools.city.tables import NOBODY, Air, Links, Near, Tracks
from ground_tools.city.tracks import (
    Desk,
    Scope,
    certain,
    everything,
    look,
    look_perfectly,
    note_turns,
    receive,
)

PERFECT, GIVEN, RADIO = 0.0, 1.0, 2.0
"""How aircraft learn of each other. PERFECT: the true state of all in reach. GIVEN: messages with given
delays and losses. RADIO: messages by the channel equations."""
_LEAST_CHANGE_MPS = 2.0
_compiled = compiled()
_inlined = compiled(forceinline=True)


class State(NamedTuple):
    """Everything that changes during a run."""

    craft: Fleet
    air: Air
    tracks: Tracks
    links: Links
    near: Near
    tally: Tally


class Rules(NamedTuple):
    """Everything that stays constant during a run."""

    world: Conditions
    knows: float
    """PERFECT, GIVEN or RADIO."""
    judge: Judge


@_inlined
def _alone(craft: Fleet, i: int) -> Fleet:
    """A view of the fleet that holds aircraft i alone."""
    a, b = i, i + 1
    return Fleet(
        craft.position[a:b], craft.before[a:b], craft.velocity[a:b], craft.command[a:b], craft.error[a:b],
        craft.own_error[a:b], craft.gust[a:b], craft.clock[a:b], craft.phase[a:b], craft.frozen[a:b],
        craft.lie[a:b], craft.sent[a:b], craft.arrival[a:b],
    )  # fmt: skip


@_inlined
def _send_all(
    rng: np.random.Generator, radio_rng: np.random.Generator, rules: Rules, tick: int, kinds: Floats,
    frames: Frames, state: State,
) -> None:  # fmt: skip
    """Send the messages that are due, and draw when each receiver gets them."""
    world, air, links = rules.world, state.air, state.links
    every, now = int(world.message), world.start_s + tick * world.step_s
    for j in range(len(air.flight)):
        if air.flight[j] == NOBODY or (tick + state.craft.phase[j]) % every != 0:
            continue
        slot = send(rng, world, tick, 0, kinds, _alone(state.craft, j))
        if rules.knows == RADIO:
            draw_arrivals(radio_rng, now, j, slot, air.rates, links, frames)
        elif rules.knows == GIVEN:
            for e in range(links.start[j], links.start[j + 1]):
                delay = radio_rng.uniform(world.delay_low_s, world.delay_high_s)
                lost = world.loss > 0.0 and radio_rng.random() < world.loss
                put_arrival(links, links.back[e], slot, math.inf if lost else now + delay, 1)


@_inlined
def _own(rules: Rules, now: float, i: int, craft: Fleet, air: Air) -> k.Own:
    p, e, v, f = craft.position, craft.error, craft.velocity, craft.own_error
    world = rules.world
    return k.Own(
        k.Vector(p[i, 0] + e[i, 0], p[i, 1] + e[i, 1], p[i, 2] + e[i, 2]),
        k.Vector(v[i, 0] + f[i, 0], v[i, 1] + f[i, 1], v[i, 2] + f[i, 2]),
        world.declared_m, now, now - air.begun_s[i], world.floor_down_m, world.ceiling_down_m,
    )  # fmt: skip


@_inlined
def _turned(i: int, own: k.Own, air: Air) -> float:
    """Upper bound of how much the own velocity has differed from the present one since the oldest message was
    sent, m/s: the sum of the velocity's changes in the present and the previous interval."""
    last = air.samples[i] - 1
    if last < 0:
        air.changed[i, 0], air.changed[i, 1], air.changed[i, 2] = 0.0, 0.0, own.now_s
        return 0.0
    if own.now_s - air.changed[i, 2] > OLDEST_S + 1.0:
        air.changed[i, 1], air.changed[i, 0], air.changed[i, 2] = air.changed[i, 0], 0.0, own.now_s
    v, u = own.velocity, air.velocities[i, last]
    air.changed[i, 0] += math.sqrt((v.n - u[0]) ** 2 + (v.e - u[1]) ** 2 + (v.d - u[2]) ** 2)
    return float(air.changed[i, 0] + air.changed[i, 1])


@_inlined
def _look(
    rules: Rules, now: float, i: int, own: k.Own, law: k.Settings, scope: Scope, desk: Desk, state: State
) -> tuple[int, int]:
    """Write the neighbours that matter to `desk`. Returns the numbers that `tracks.look` returns."""
    if rules.knows != PERFECT:
        return look(now, rules.world, i, own, law, scope, state.craft, state.tracks, desk)
    if law.law == k.NONE:
        return 0, 0
    count = look_perfectly(i, own, law, scope, state.craft, state.links, desk)
    return count, count


@_compiled
def _decided(
    rules: Rules, now: float, i: int, law: k.Settings, path: k.Path, fence: Floats, desk: Desk,
    work: k.Workspace, state: State,
) -> tuple[int, k.Decision]:  # fmt: skip
    """The decision of aircraft i, and the number of neighbours that could matter to it.

    First, only the neighbours are considered that matter for a small change of velocity. If the result could
    differ from the decision with all neighbours, the decision is repeated with all that can matter.
    """
    air = state.air
    own = _own(rules, now, i, state.craft, air)
    turned = _turned(i, own, air)
    command = k.Vector(air.command[i, 0], air.command[i, 1], air.command[i, 2])
    before = k.State(command, air.decided_s[i], air.quiet[i], air.late_s[i], air.samples[i])
    history = k.History(air.times_s[i], air.velocities[i])
    note_turns(own, history, air.samples[i], desk.turns)
    most = everything(own, law)
    change = min(air.change[i], most) if law.law == k.DMUCA else most
    asked, count = _look(rules, now, i, own, law, Scope(change, turned), desk, state)
    decision = k.decide(desk.neighbours, count, own, path, fence, law, before, history, work)
    if change < most and not certain(own, law, decision, change):
        air.change[i] = 1.5 * air.change[i] + 1.0
        asked, count = _look(rules, now, i, own, law, Scope(most, turned), desk, state)
        # The velocity history already holds the present velocity.
        before = k.State(command, air.decided_s[i], air.quiet[i], air.late_s[i], decision.state.samples)
        decision = k.decide(desk.neighbours, count, own, path, fence, law, before, history, work)
    else:
        air.change[i] = max(0.98 * air.change[i], _LEAST_CHANGE_MPS)
    return asked, decision


@_compiled
def _decide(
    rules: Rules, now: float, i: int, flights: Flights, fence: Floats, desk: Desk, work: k.Workspace,
    state: State,
) -> None:  # fmt: skip
    """One decision of aircraft i."""
    craft, air = state.craft, state.air
    f = air.flight[i]
    law = k.settings_at(flights.settings, f)
    if rules.knows != PERFECT:
        receive(now, rules.world, i, craft, air, state.tracks, state.links, rules.judge, desk)
    first, after = flights.first[f], flights.first[f] + flights.corners[f]
    path = k.Path(flights.times[first:after], flights.points[first:after])
    asked, decision = _decided(rules, now, i, law, path, fence, desk, work, state)
    kept = decision.state
    for c, value in enumerate(kept.command):
        air.command[i, c] = value
    air.decided_s[i], air.quiet[i], air.late_s[i] = kept.time_s, kept.quiet, kept.delay_s
    air.samples[i] = kept.samples
    for c, value in enumerate(decision.chosen):
        craft.command[i, c] = value
    note_decision(state.tally, air, i, asked, decision.feasible, decision.conflict)


@_compiled
def advance(
    rng: np.random.Generator, radio_rng: np.random.Generator, rules: Rules, first_tick: int, ticks: int,
    flights: Flights, fence: Floats, kinds: Floats, frames: Frames, desk: Desk, work: k.Workspace,
    state: State, trace: Floats,
) -> None:  # fmt: skip
    """Compute the given number of steps.

    Args:
        rng: source of the errors of navigation.
        radio_rng: source of delays and losses.
        first_tick, ticks: number of the first step, and number of steps.
        fence: as in `kernels.decide`, the same for all aircraft.
        kinds: shape (1,): AVOIDS.
        trace: shape (decisions, slots, 3): receives the commands, for as many decisions as it has room.
    """
    world, craft, air = rules.world, state.craft, state.air
    every = int(world.period)
    for tick in range(first_tick, first_tick + ticks):
        now = world.start_s + tick * world.step_s
        _send_all(rng, radio_rng, rules, tick, kinds, frames, state)
        if tick % every == 0:
            for i in range(len(air.flight)):
                if air.flight[i] != NOBODY:
                    _decide(rules, now, i, flights, fence, desk, work, state)
                    if tick // every < len(trace):
                        for c in range(3):
                            trace[tick // every, i, c] = craft.command[i, c]
        move(rng, world, craft)
        measure(now, world, flights, craft, air, state.near, state.tally)
