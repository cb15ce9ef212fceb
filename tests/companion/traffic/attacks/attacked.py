"""Flights with the real tracks and the real law, in a sky that an attacker fills; Remote ID as real bytes.

The own aircraft flies north on its path. An honest aircraft that does not avoid crosses or meets it, so that
both would hit without avoidance, and sends one Location a second. `Sky.attack` adds what the attacker sends.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from companion.avoidance.law import Law, Situation
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig, TrafficConfig
from companion.events import RemoteIdHeard
from companion.geometry import Vec3
from companion.remote_id.codec import decode, encode
from companion.remote_id.messages import BasicId, IdType, Location, Status, UaType
from companion.traffic.tracks import Traffic
from tests.support.place import HOME

STEP_S = 0.05
UTC_OFFSET_S = 1_767_225_600.0
SEPARATION_M = 47.0
HEIGHT_M = 50.0
NAME, ADDRESS = "HONEST", "00:1a:2b:3c:4d:5e"


@dataclass
class Sky:
    """What an attacker sees and sends."""

    now_s: float
    own: Vec3
    own_velocity: Vec3
    honest: Vec3
    honest_velocity: Vec3
    frames: list[RemoteIdHeard] = field(default_factory=list)

    def send(
        self,
        name: str,
        address: str,
        position: Vec3,
        velocity: Vec3,
        lead_s: float = 0.0,
        accuracy_m: float = 3.0,
        rssi_dbm: float | None = None,
    ) -> None:
        """Send Basic ID and Location; the timestamp is now and `lead_s`."""
        lat, lon, alt = HOME.to_geodetic(position[0], position[1], -HEIGHT_M + position[2])
        location = Location(
            status=Status.AIRBORNE,
            lat_deg=lat,
            lon_deg=lon,
            alt_geodetic_m=alt + SEPARATION_M,
            speed_mps=math.hypot(velocity[0], velocity[1]),
            direction_deg=math.degrees(math.atan2(velocity[1], velocity[0])) % 360.0,
            vertical_speed_mps=-velocity[2],
            horizontal_accuracy_m=accuracy_m,
            vertical_accuracy_m=3.0,
            speed_accuracy_mps=1.0,
            timestamp_s=round((self.now_s + lead_s) % 3600.0, 1) % 3600.0,
        )
        basic = BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=name)
        messages = tuple(decode(encode(message)) for message in (basic, location))
        self.frames.append(
            RemoteIdHeard(transport="wifi", address=address, messages=messages, rssi_dbm=rssi_dbm)
        )


Attack = Callable[[Sky], None]


@dataclass
class Flown:
    """Outcome of a flight."""

    least_m: float = math.inf
    """Least distance from the honest aircraft."""
    unseen_s: float = 0.0
    """Time for which no track was within 15 m of the honest aircraft, while it was heard and less than 15 s
    from the meeting."""
    traffic: Traffic | None = None


def fly(
    attack: Attack,
    own_mps: float,
    other_mps: float,
    angle_deg: float,
    *,
    appears_s: float = 1.0,
    meet_s: float = 35.0,
    delay_s: float = 0.3,
    seed: int = 1,
    avoids: bool = True,
    sends: bool = True,
) -> Flown:
    """One flight.

    Args:
        angle_deg: 180 is head-on, 90 from the left.
        appears_s: when the honest aircraft is first heard.
        meet_s: when both would be at one place.
        delay_s: age of its messages when they arrive.
    """
    draw = random.Random(seed)
    path = Trajectory([0.0, 200.0], [(0.0, 0.0, 0.0), (200.0 * own_mps, 0.0, 0.0)])
    limits = LimitsConfig(max_speed_mps=max(10.0, 1.5 * own_mps))
    law = Law(AvoidanceConfig(), limits, path)
    traffic = Traffic(TrafficConfig(), "OWN")
    course = math.radians(angle_deg)
    velocity = (other_mps * math.cos(course), other_mps * math.sin(course), 0.0)
    meeting = own_mps * meet_s
    own, own_velocity = (0.0, 0.0, 0.0), (own_mps, 0.0, 0.0)
    command = own_velocity
    waiting: list[tuple[float, RemoteIdHeard]] = []
    flown = Flown(traffic=traffic)
    phase = draw.random()
    for number in range(round((meet_s + 12.0) / STEP_S)):
        now_s = round(100.0 + number * STEP_S, 3)
        t = number * STEP_S
        ahead = t - meet_s
        other = (meeting + ahead * velocity[0], ahead * velocity[1], 0.0)
        sky = Sky(now_s, own, own_velocity, other, velocity)
        if sends and t >= appears_s and (t + phase) % 1.0 < STEP_S:
            sky.send(NAME, ADDRESS, other, velocity)
            waiting.append((now_s + delay_s, sky.frames.pop()))
        attack(sky)
        frames = sky.frames + [frame for at_s, frame in waiting if at_s <= now_s]
        waiting = [(at_s, frame) for at_s, frame in waiting if at_s > now_s]
        traffic.note_own(now_s, own, own_velocity)
        for frame in frames:
            traffic.hear(frame, now_s, UTC_OFFSET_S, HERE, SEPARATION_M)
        traffic.expire(now_s)
        traffic.flagged(now_s)
        law.note_velocity(now_s, own_velocity)
        if number % 4 == 0:
            others = traffic.neighbours(now_s)
            if avoids:
                situation = Situation(now_s, t, own, own_velocity, 1.0, others, floor_down_m=35.0)
                command = law.decide(situation).chosen_ned_mps
            if appears_s + 2.0 <= t and -15.0 <= ahead <= 0.0:
                places = [
                    tuple(p + n.age_s * v for p, v in zip(n.position_ned_m, n.velocity_ned_mps, strict=True))
                    for n in others
                ]
                if not any(math.dist(place, other) < 15.0 for place in places):
                    flown.unseen_s += 0.2
        own_velocity = tuple(v + 0.25 * (c - v) for v, c in zip(own_velocity, command, strict=True))
        own = tuple(p + STEP_S * v for p, v in zip(own, own_velocity, strict=True))
        flown.least_m = min(flown.least_m, math.dist(own, other))
    return flown


HERE = HOME.__class__(*HOME.to_geodetic(0.0, 0.0, -HEIGHT_M))
"""The frame: its origin is where the own aircraft starts."""


def crowd(
    count: int,
    per_s: float,
    nearest_m: float,
    farthest_m: float,
    *,
    from_s: float = 0.0,
    to_s: float = 1e9,
    sector: tuple[float, float] = (0.0, math.tau),
    follows: bool = True,
    seed: int = 1,
    churn: bool = False,
    imitates: bool = False,
    loud: bool = True,
    extra: Vec3 = (0.0, 0.0, 0.0),
) -> Attack:
    """Fakes that fly along beside us, in conflict with nobody; their turns are `per_s` frames a second.

    Args:
        sector: directions from us, rad.
        churn: each frame has a new name and address.
        imitates: the manufacturer and signal strength of the honest aircraft.
        loud: one signal strength; otherwise each fake has its own.
        extra: added to their velocity, m/s.
    """
    draw = random.Random(seed)
    places = [(draw.uniform(*sector), draw.uniform(nearest_m, farthest_m)) for _ in range(count)]
    state = {"sent": 0.0, "next": 0, "begun": None}

    def attack(sky: Sky) -> None:
        state["begun"] = sky.now_s if state["begun"] is None else state["begun"]
        if not from_s <= sky.now_s - state["begun"] < to_s:
            return
        state["sent"] += per_s * STEP_S
        while state["sent"] >= 1.0:
            state["sent"] -= 1.0
            number = state["next"] % count
            who = state["next"] if churn else number
            state["next"] += 1
            angle, away = places[number]
            place = (sky.own[0] + away * math.cos(angle), sky.own[1] + away * math.sin(angle), sky.own[2])
            velocity = tuple(v + e for v, e in zip(sky.own_velocity, extra, strict=True))
            address = f"00:1a:2b:{who >> 16 & 255:02x}:{who >> 8 & 255:02x}:{who & 255:02x}"
            if not imitates:
                address = "02:11:22" + address[8:]
            rssi = None if imitates else (-60.0 if loud else -40.0 - number % 50)
            sky.send(f"FAKE{who}", address, place, velocity, rssi_dbm=rssi)

    return attack


def clone(
    per_s: float, away: Vec3, *, lead_s: float = 0.0, from_s: float = 0.0, velocity: Vec3 | None = None,
    accuracy_m: float = 3.0,
) -> Attack:  # fmt: skip
    """A copy of the honest aircraft's name and address, beside it."""
    state = {"sent": 0.0, "begun": None}

    def attack(sky: Sky) -> None:
        state["begun"] = sky.now_s if state["begun"] is None else state["begun"]
        if sky.now_s - state["begun"] < from_s:
            return
        state["sent"] += per_s * STEP_S
        while state["sent"] >= 1.0:
            state["sent"] -= 1.0
            place = tuple(p + a for p, a in zip(sky.honest, away, strict=True))
            sky.send(NAME, ADDRESS, place, velocity or sky.honest_velocity, lead_s, accuracy_m)

    return attack


def nobody(sky: Sky) -> None:
    """No attack."""
