"""Flights in which two send with one identity: the heart's own tracks, in the campaign's world.

Vehicles, errors, messages and their delays are `flight`'s, draw for draw. Here each aircraft hears frames
(Basic ID and Location, from a radio address) with the heart's `Traffic` and decides by its `Law`: who is
whose twin is not known to either. Everybody hears the own frames, too, as a second receiver does. It takes
some fifty times as long as the compiled flight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from companion.avoidance import kernels as k
from companion.avoidance.law import Law, Situation
from companion.config import TrafficConfig
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.traffic.tracks import Traffic
from ground_tools.campaign import flight
from ground_tools.inspect.truth import ORIGIN

Array = NDArray[np.float64]

FRAME = LocalFrame(*ORIGIN)
VICTIM = 1
"""The aircraft whose identity a twin and a clone send with."""


def fly(
    rng: np.random.Generator,
    world: Array,
    path_times: Array,
    path_points: Array,
    fence: Array,
    settings: Array,
    kinds: Array,
    laws: Sequence[Law],
    pairs: Array,
    result: Array,
) -> None:
    """Fly a fleet along its paths; arguments as of `flight.fly`.

    Args:
        world: without a loss of GNSS.
        kinds: shape (A,): `flight.AVOIDS`, `BLIND`, or of `flight.TWINS`.
        laws: of each aircraft; of one that does not avoid "none".
    """
    fleet = len(kinds)
    craft = flight.on_the_ground(fleet, world)
    hearts = [Heart(i, law) for i, law in enumerate(laws)]
    state = np.zeros((fleet, k.STATE_ENTRIES))
    air = Air(kinds, world)
    step = world[flight.W_STEP]
    every, message_every = int(world[flight.W_PERIOD]), int(world[flight.W_MESSAGE])
    steps = round((world[flight.W_END] - world[flight.W_START]) / step)
    floor, ceiling = (
        limit if math.isfinite(limit) else None
        for limit in world[[flight.W_FLOOR, flight.W_CEILING]].tolist()
    )
    declared = float(world[flight.W_DECLARED])
    manoeuvres = infeasible = decisions = 0
    result[:] = 0.0
    result[flight.F_SEPARATION] = result[flight.F_CREWED] = math.inf
    pairs[:, :, flight.P_ALERT] = 0.0
    flight.begin(rng, world, path_times, path_points, kinds, craft)
    clocks, phases = craft.clock.tolist(), craft.phase.tolist()

    for tick in range(steps):
        now = float(world[flight.W_START] + tick * step)
        for i in range(fleet):
            if (tick + phases[i]) % message_every == 0:
                slot = flight.send(rng, world, tick, i, kinds, craft)
                air.take(i, slot, craft.sent[i, slot].tolist(), now)
        places = list(map(tuple, (craft.position + craft.error).tolist()))
        velocities = list(map(tuple, (craft.velocity + craft.own_error).tolist()))
        for heart, place, velocity in zip(hearts, places, velocities, strict=True):
            heart.traffic.note_own(now, place, velocity)
        if tick % every == 0:
            for i, heart in enumerate(hearts):
                if kinds[i] == flight.AVOIDS:
                    for frame in air.heard(i, now, craft.arrival[i]):
                        heart.traffic.hear(frame, now, clocks[i], FRAME, 0.0)
                    heart.traffic.expire(now)
                decided = heart.law.decide(
                    Situation(
                        now, now, places[i], velocities[i], declared,
                        heart.traffic.neighbours(now), floor, ceiling,
                    )
                )  # fmt: skip
                craft.command[i] = decided.chosen_ned_mps
                state[i, k.L_DELAY] = heart.law.late_s
                if kinds[i] != flight.AVOIDS:
                    continue
                decisions += 1
                infeasible += not decided.feasible
                manoeuvres += decided.conflict and not heart.in_conflict
                heart.in_conflict = decided.conflict
                if decided.conflict:
                    craft.conflict_at[i], craft.recovery[i] = now, math.inf
                    for track in decided.tracks:
                        if track.conflict:
                            j = air.sender(heart.traffic.tracks[track.track_id].content)
                            pairs[max(i, j), min(i, j), flight.P_ALERT] = 1.0
        flight.move(
            rng, world, tick, tick == steps - 1, path_times, path_points, fence, settings, kinds, state,
            craft, _NO_TRACE, result,
        )  # fmt: skip

    flight.land(craft, pairs, result)
    result[flight.F_MANOEUVRES] = manoeuvres
    result[flight.F_INFEASIBLE] = infeasible / max(decisions, 1)


_NO_TRACE = np.zeros((0, 0, 3))


class Heart:
    """What one aircraft hears and decides with."""

    def __init__(self, number: int, law: Law) -> None:
        self.law = law
        self.traffic = Traffic(TrafficConfig(), name(number))
        self.traffic.own_addresses = (address(number),)
        self.in_conflict = False


class Air:
    """Frames on their way."""

    def __init__(self, kinds: Array, world: Array) -> None:
        self._kinds = kinds.tolist()
        self._declared, self._sigma_mps = (
            float(world[entry]) for entry in (flight.W_DECLARED, flight.W_SIGMA_VELOCITY)
        )
        self._echo_s = float(world[flight.W_DELAY_LOW])
        self._locations: list[dict[int, Location]] = [{} for _ in kinds]
        """By sender and slot."""
        self._echoes: list[list[tuple[float, Location]]] = [[] for _ in kinds]
        self._senders: dict[tuple[float | None, float | None], int] = {}

    def take(self, sender: int, slot: int, message: list[float], now: float) -> None:
        """A message of `flight.send`."""
        at, north, east, down, *velocity = message
        lat, lon, alt = FRAME.to_geodetic(north, east, down)
        location = Location(
            lat_deg=lat,
            lon_deg=lon,
            alt_geodetic_m=alt,
            direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
            speed_mps=math.hypot(velocity[0], velocity[1]),
            vertical_speed_mps=-velocity[2],
            horizontal_accuracy_m=self._declared,
            speed_accuracy_mps=self._sigma_mps,
            timestamp_s=at % 3600.0,
        )
        self._locations[sender][slot] = location
        self._echoes[sender].append((now + self._echo_s, location))
        self._senders[lat, lon] = sender

    def heard(self, receiver: int, now: float, arrival: Array) -> list[RemoteIdHeard]:
        """The frames that came to one aircraft.

        Args:
            arrival: shape (A, slots), its own; what came is taken out.
        """
        frames = []
        for sender, slot in np.argwhere(arrival <= now).tolist():
            arrival[sender, slot] = math.inf
            frames.append(self._frame(sender, receiver, self._locations[sender][slot]))
        echoes = self._echoes[receiver]
        while echoes and echoes[0][0] <= now:
            frames.append(self._frame(receiver, receiver, echoes.pop(0)[1]))
        return frames

    def sender(self, location: Location) -> int:
        """Who sent it."""
        return self._senders[location.lat_deg, location.lon_deg]

    def _frame(self, sender: int, receiver: int, location: Location) -> RemoteIdHeard:
        who = where = sender
        kind = self._kinds[sender]
        if kind in (flight.TWIN, flight.CLONE):
            who = VICTIM
        elif kind in (flight.OWN_TWIN, flight.OWN_CLONE):
            who = receiver
        if kind in (flight.CLONE, flight.OWN_CLONE):
            where = who
        return RemoteIdHeard(
            transport="wifi",
            address=address(where),
            messages=(
                BasicId(
                    id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=name(who)
                ),
                location,
            ),
        )


def name(number: int) -> str:
    """Identity of an aircraft."""
    return f"uas-{number:03d}"


def address(number: int) -> str:
    """Of its radio."""
    return f"02:00:00:00:00:{number:02x}"
