"""Flights in which two aircraft send one identity, and flights by the law of a plug-in.

They use the companion's track code in the campaign's world.

Vehicles, errors, messages and their delays come from `vehicles`, draw for draw. Here each aircraft receives
frames (Basic ID and Location, from a radio address) with the companion's `Traffic` and decides with its
`Law`. Neither knows which aircraft share an identity. Every aircraft also receives its own frames,
as a second receiver would. Such a flight takes about fifty times as long as the compiled one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.arrays import Floats
from companion.avoidance.law import ASIDE, Law, LawResult, Situation
from companion.config import TrafficConfig
from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame, Vec3
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.traffic.tracks import Traffic
from ground_tools.campaign import outcome, vehicles
from ground_tools.campaign.scenarios import missions
from ground_tools.campaign.world import Conditions
from ground_tools.inspect.read.truth import ORIGIN

FRAME = LocalFrame(*ORIGIN)
VICTIM = 1
"""Index of the aircraft whose identity a twin and a clone send."""


def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    laws: Sequence[Law],
    pairs: Floats,
    result: Floats,
) -> None:
    """Fly a fleet along its paths. Arguments that are not listed here are those of `flight.fly`.

    Args:
        world: a world without a loss of GNSS.
        kinds: shape (A,): `vehicles.AVOIDS`, `vehicles.BLIND`, or one of `vehicles.TWINS`.
        laws: law of each aircraft; the law "none" for an aircraft that does not avoid.

    Raises:
        ConfigError: the law of a plug-in failed.
    """
    fleet = len(kinds)
    craft, tally = vehicles.on_the_ground(fleet, world), outcome.nothing_yet(fleet, pairs, result)
    cores = [Core(i, law) for i, law in enumerate(laws)]
    air, late = Air(kinds, world), np.zeros(fleet)
    step = world.step_s
    every, message_every = int(world.period), int(world.message)
    vehicles.begin(rng, world, path_times, path_points, kinds, craft)
    clocks, phases = craft.clock.tolist(), craft.phase.tolist()

    for tick in range(round((world.end_s - world.start_s) / step)):
        now = world.start_s + tick * step
        for i in range(fleet):
            if (tick + phases[i]) % message_every == 0:
                slot = vehicles.send(rng, world, tick, i, kinds, craft)
                air.hear(i, slot, craft.sent[i, slot].tolist(), now)
        places = list(map(tuple, (craft.position + craft.error).tolist()))
        velocities = list(map(tuple, (craft.velocity + craft.own_error).tolist()))
        for core, place, velocity in zip(cores, places, velocities, strict=True):
            core.traffic.note_own(now, place, velocity)
        if tick % every == 0:
            for i, core in enumerate(cores):
                if kinds[i] == vehicles.AVOIDS:
                    core.hear(air.heard(i, now, craft.arrival[i]), now, clocks[i])
                decided = core.decide(world, now, places[i], velocities[i])
                if core.law.fault is not None:
                    raise ConfigError(f"aircraft {i} at {now:.1f} s: {core.law.fault}")
                craft.command[i] = decided.chosen_ned_mps
                late[i] = core.law.late_s
                if kinds[i] == vehicles.AVOIDS:
                    outcome.count_decision(tally, now, i, decided.feasible, decided.conflict)
                    for track in decided.tracks if decided.conflict else ():
                        if track.conflict:
                            j = air.sender(core.traffic.tracks[track.track_id.partition(ASIDE)[0]].content)
                            pairs[max(i, j), min(i, j), outcome.P_ALERT] = 1.0
        vehicles.move(rng, world, craft)
        outcome.measure(
            world, tick, path_times, path_points, late, fence, settings, kinds, craft, tally, result
        )

    outcome.land(kinds, late, tally, pairs, result)


def check(law: str, intruder: str | None, signal: bool, dark: bool) -> None:
    """Check that a plug-in's law can fly an encounter.

    Args:
        intruder: kind of the intruders; None: there are none.
        signal, dark: whether signal strength is weighed, and whether aircraft lose their position.

    Raises:
        ConfigError: the law cannot fly it.
    """
    known = ("blind", *vehicles.TWINS, *missions.MISSIONS)
    if signal or dark or (intruder is not None and intruder not in known):
        raise ConfigError(
            f"--law {law}: the law of a plug-in cannot be combined with --signal, --world blackout or mute, "
            f"or intruders other than {', '.join(known)}"
        )


class Core:
    """The receiving and deciding part of one aircraft: its tracks and its law."""

    def __init__(self, number: int, law: Law) -> None:
        self.law = law
        self.traffic = Traffic(TrafficConfig(), name(number))
        self.traffic.own_addresses = (address(number),)

    def hear(self, frames: Sequence[RemoteIdHeard], now: float, clock_s: float) -> None:
        """Process the frames received since the last decision.

        Args:
            clock_s: how far the aircraft's clock is ahead of the true time.
        """
        for frame in frames:
            self.traffic.hear(frame, now, clock_s, FRAME, 0.0)
        self.traffic.expire(now)

    def decide(self, world: Conditions, now: float, place_ned_m: Vec3, velocity_ned_mps: Vec3) -> LawResult:
        """Decide, given the position and velocity that the aircraft measures for itself."""
        floor, ceiling = (
            limit if math.isfinite(limit) else None for limit in (world.floor_down_m, world.ceiling_down_m)
        )
        return self.law.decide(
            Situation(
                now, now, place_ned_m, velocity_ned_mps, world.declared_m,
                self.traffic.neighbours(now), floor, ceiling,
            )
        )  # fmt: skip


class Air:
    """Frames that were sent and not yet received."""

    def __init__(self, kinds: Floats, world: Conditions) -> None:
        self._kinds = kinds.tolist()
        self._declared, self._sigma_mps = world.declared_m, world.sigma_mps
        self._echo_s = world.delay_low_s
        self._locations: list[dict[int, Location]] = [{} for _ in kinds]
        """Latest messages, by sender and slot."""
        self._echoes: list[list[tuple[float, Location]]] = [[] for _ in kinds]
        self._senders: dict[tuple[float | None, float | None], int] = {}

    def hear(self, sender: int, slot: int, message: list[float], now: float) -> None:
        """Add a message that `vehicles.send` wrote."""
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

    def heard(self, receiver: int, now: float, arrival: Floats) -> list[RemoteIdHeard]:
        """The frames that one aircraft has received by now, including its own.

        Args:
            arrival: shape (A, slots), the receiver's rows; received messages are set to infinity.
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
        """Index of the aircraft that sent a location."""
        return self._senders[location.lat_deg, location.lon_deg]

    def _frame(self, sender: int, receiver: int, location: Location) -> RemoteIdHeard:
        who = where = sender
        kind = self._kinds[sender]
        if kind in (vehicles.TWIN, vehicles.CLONE):
            who = VICTIM
        elif kind in (vehicles.OWN_TWIN, vehicles.OWN_CLONE):
            who = receiver
        if kind in (vehicles.CLONE, vehicles.OWN_CLONE):
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
    """Identity of an aircraft, by its index."""
    return f"uas-{number:03d}"


def address(number: int) -> str:
    """Radio address of an aircraft, by its index."""
    return f"02:00:00:00:00:{number:02x}"
