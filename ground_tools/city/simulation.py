"""Flies a city: departures and arrivals, links and choices of transports, with the compiled loop between
them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.arrays import Bools, Floats, Integers
from companion.avoidance import kernels as k
from companion.avoidance.kernels.neighbours import NEWS_S
from companion.avoidance.kernels.timelines import HISTORY_SPACING_S
from companion.config import AvoidanceConfig, TrafficConfig
from companion.errors import ConfigError
from ground_tools.campaign.vehicles import AVOIDS, Fleet, begin
from ground_tools.campaign.world import World
from ground_tools.city.draws import Frames
from ground_tools.city.flights import Flights, largest_number_in_the_air
from ground_tools.city.judging import COLUMNS, PLACES, judge_of
from ground_tools.city.links import Grid
from ground_tools.city.loop import PERFECT, Rules, State, advance
from ground_tools.city.measure import T_BEGUN, T_ENDED, new_tally
from ground_tools.city.tables import NOBODY, new_air, new_fleet, new_near, new_tracks
from ground_tools.city.tracks import TURNS, Desk

PART_S = 0.5
"""Length of a part of a run. Transports are chosen and loads computed after each part."""
PARTS = 4
"""Number of parts after which links are searched again and aircraft depart and arrive."""
LINKS_S = PART_S * PARTS
ARRIVED_M = 10.0
"""An aircraft has arrived when its path is over and it is this near to the end of the path."""
CLEAR_M = 30.0
"""An aircraft departs only if no other is this near to the beginning of its path."""
_ROOM = 1.2
"""Slots per aircraft in the air as planned. More than 1, because delayed aircraft stay longer."""


class Radio(Protocol):
    """Model of the radio: decides who receives which message."""

    frames: Frames

    def choose(self, part: int, now: float, state: State) -> None:
        """Let the aircraft whose turn it is choose their transports, and compute their reception
        probabilities."""
        ...


@dataclass(frozen=True, slots=True)
class Result:
    """Result of a run."""

    state: State
    waiting: int
    """Flights that were due and could not depart."""
    not_due: int
    in_the_air: int
    arrived: int
    step_s: float
    due_s: Floats
    """(F,): when each flight was due."""
    purpose: Integers
    """(F,): index into `demand.PURPOSES`."""
    waited_s: Floats
    """(F,): waiting time of each flight before its departure; NaN: it did not depart."""
    near_overflow: int
    """Number of near pairs that were left unmeasured, because an aircraft had too many at that time."""


class Simulation:
    """One run of a city.

    Args:
        flights: the planned flights.
        avoidance: configuration of the law, from which the flights' settings were made.
        world: errors and delays; begins at 0 s.
        knows: `loop.PERFECT`, `loop.GIVEN` or `loop.RADIO`.
        reach_m: range of each transport, shape (3,); PERFECT and GIVEN use the first number only.
        radio: the radio model, for `loop.RADIO`.
        rng: source of the errors of navigation.
        radio_rng: source of delays and losses.
        most_tracks: capacity of each aircraft's table of tracks.
        slots: most aircraft in the air; None: some more than are in the air if all fly as planned.
        clear_m: see `CLEAR_M`.

    Raises:
        ConfigError: messages are more frequent than `kernels.note_track` takes in, or decisions more frequent
            than `kernels.note_velocity` does.
    """

    def __init__(
        self,
        flights: Flights,
        avoidance: AvoidanceConfig,
        world: World,
        knows: float,
        reach_m: Floats,
        rng: np.random.Generator,
        radio_rng: np.random.Generator,
        *,
        radio: Callable[[int, float], Radio] | None = None,
        most_tracks: int = TrafficConfig().max_tracks,
        slots: int | None = None,
        clear_m: float = CLEAR_M,
    ) -> None:
        self._flights, self._rng, self._radio_rng = flights, rng, radio_rng
        self._world = conditions = world.conditions(avoidance.period_s)
        if conditions.message * world.step_s <= NEWS_S:
            raise ConfigError(f"message_s must be above {NEWS_S:g}, so that every message counts for a track")
        if avoidance.period_s < HISTORY_SPACING_S:
            raise ConfigError(
                f"avoidance.period_s: {avoidance.period_s:g}; a city allows {HISTORY_SPACING_S:g} or more, "
                "so that every decision counts for the history of velocities"
            )
        planned = math.ceil(_ROOM * largest_number_in_the_air(flights)) + 4
        self.slots = slots = planned if slots is None else slots
        self._steps_of_part = round(PART_S / world.step_s)
        self._clear_m = clear_m
        craft = new_fleet(slots, conditions)
        fastest = float(flights.settings[:, k.Settings._fields.index("speed_mps")].max(initial=1.0))
        near_m = 2.0 * LINKS_S * 1.1 * fastest + 20.0
        reach = np.maximum(np.asarray(reach_m, float), 0.0)
        reach[0] = max(reach[0], near_m if knows == PERFECT else reach[0])
        self._grid = Grid(slots, reach, craft.sent.shape[1], near_m)
        few = 2 if knows == PERFECT else slots
        self.state = State(
            craft,
            new_air(slots),
            new_tracks(few, most_tracks),
            self._grid.links,
            new_near(slots),
            new_tally(len(flights.depart_s)),
        )
        self._rules = Rules(conditions, knows, judge_of(avoidance))
        self._desk = Desk(
            np.zeros((most_tracks, k.OTHER_COLUMNS)),
            np.zeros(most_tracks, np.int64),
            np.zeros(most_tracks, np.int64),
            np.zeros(slots, np.int64),
            np.zeros((2, TURNS)),
            np.zeros((most_tracks + 1, COLUMNS), np.int64),
            np.zeros(PLACES, np.int64),
        )
        self._work = k.workspace(0, most_tracks)
        self._kinds = np.full(1, float(AVOIDS))
        self._radio = None if radio is None else radio(slots, conditions.message * world.step_s)
        self._still = Frames(1.0, np.zeros(3), np.zeros(slots))
        self._fresh: Bools = np.zeros(slots, bool)
        self._next = 0
        self._waiting: list[int] = []
        self._waited = np.full(len(flights.depart_s), math.nan)
        self._overflow = 0
        self._part = 0
        self._tick = 0

    @property
    def now_s(self) -> float:
        """Time of the run."""
        return self._tick * self._world.step_s

    def fly(
        self, duration_s: float, trace: Floats | None = None, after: Callable[[], None] | None = None
    ) -> Result:
        """Continue the run for a duration that is a multiple of `PART_S`.

        Args:
            trace: as in `loop.advance`.
            after: called after each part.
        """
        trace = np.zeros((0, self.slots, 3)) if trace is None else trace
        for _ in range(round(duration_s / PART_S)):
            if self._part % PARTS == 0:
                self._turn_over(self.now_s)
                self._relink()
            if self._radio is not None:
                self._radio.choose(self._part, self.now_s, self.state)
            frames = self._still if self._radio is None else self._radio.frames
            advance(
                self._rng, self._radio_rng, self._rules, self._tick, self._steps_of_part, self._flights,
                k.NO_WALLS, self._kinds, frames, self._desk, self._work, self.state, trace,
            )  # fmt: skip
            self._part += 1
            self._tick += self._steps_of_part
            if after is not None:
                after()
        return self._result()

    def _relink(self) -> None:
        state = self.state
        links = self._grid.find(state.craft.position, state.air, self._fresh)
        self.state = state = state._replace(links=links)
        self._overflow += self._grid.pair(state.craft, state.near, self._fresh)
        self._fresh[:] = False

    def _turn_over(self, now: float) -> None:
        """Remove the aircraft that have arrived, and let those depart that are due."""
        flights, air = self._flights, self.state.air
        flying = np.flatnonzero(air.flight != NOBODY)
        f = air.flight[flying]
        length_s = flights.times[flights.first[f] + flights.corners[f] - 1]
        over = now - air.begun_s[flying] - air.late_s[flying] >= length_s
        for slot in flying[over & (air.gap_m[flying] <= ARRIVED_M)].tolist():
            self.state.tally.flights[air.flight[slot], T_ENDED] = now
            air.flight[slot] = NOBODY
            self._fresh[slot] = True
        while self._next < len(flights.depart_s) and flights.depart_s[self._next] <= now:
            self._waiting.append(self._next)
            self._next += 1
        self._waiting = [f for f in self._waiting if not self._depart(f, now)]

    def _depart(self, f: int, now: float) -> bool:
        """Begin a flight if there is a slot and its place of departure is free."""
        air, craft = self.state.air, self.state.craft
        free = np.flatnonzero(air.flight == NOBODY)
        at = self._flights.points[self._flights.first[f]]
        near = np.flatnonzero(np.abs(craft.position[:, 0] - at[0]) < self._clear_m)
        near = near[air.flight[near] != NOBODY]
        if not len(free) or (np.linalg.norm(craft.position[near] - at, axis=1) < self._clear_m).any():
            return False
        self._begin(int(free[0]), f, now)
        self._waited[f] = now - self._flights.depart_s[f]
        self.state.tally.flights[f, T_BEGUN] = now
        return True

    def _begin(self, slot: int, f: int, now: float) -> None:
        flights, air, tracks = self._flights, self.state.air, self.state.tracks
        rows = slice(flights.first[f], flights.first[f] + flights.corners[f])
        one = Fleet._make(array[slot : slot + 1] for array in self.state.craft)
        begin(self._rng, self._world, flights.times[None, rows], flights.points[None, rows], self._kinds, one)
        one.before[:] = one.position
        one.gust[:] = 0.0
        first = k.first_state(k.Settings(*flights.settings[f].tolist()), 0)
        air.flight[slot], air.begun_s[slot] = f, now
        air.command[slot], air.decided_s[slot] = first.command, first.time_s
        air.quiet[slot], air.late_s[slot], air.samples[slot] = first.quiet, first.delay_s, first.samples
        air.rates[slot] = 0
        air.conflict[slot] = air.gap_m[slot] = air.change[slot] = 0.0
        if slot < len(tracks.who):
            tracks.who[slot], tracks.used[slot] = NOBODY, 0
            tracks.opened_s[slot], tracks.opened[slot] = -math.inf, 0
            tracks.anchor[slot] = -math.inf
        self._fresh[slot] = True

    def _result(self) -> Result:
        tally = self.state.tally.flights
        return Result(
            state=self.state,
            waiting=len(self._waiting),
            not_due=len(tally) - self._next,
            in_the_air=int((self.state.air.flight != NOBODY).sum()),
            arrived=int(np.isfinite(tally[:, T_ENDED]).sum()),
            step_s=self._world.step_s,
            due_s=self._flights.depart_s,
            purpose=self._flights.purpose,
            waited_s=self._waited,
            near_overflow=self._overflow,
        )
