"""An attacker: its parameters, a transmitter with physical limits, what it knows, and what it sends."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, Protocol

import msgspec
import numpy as np

from companion.events import AdsbVehicle
from companion.geometry import Vec3
from companion.remote_id.messages import Message
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.campaign.attacks.scene import Scene

FRAMES_PER_S: Final = {WIFI_BEACON: 200.0, BLE4: 50.0, BLE5: 50.0}
"""Greatest number of frames per second of one transmitter, by transport. Bluetooth advertises every 20 ms at
most; injected beacons are limited by the processor of a cheap module rather than by their 0.6 ms of
airtime."""
_BURST_S: Final = 0.25
"""Unused frames may be sent later, up to the number that is possible in this time."""
ADSB_PERIOD_S: Final = 1.0
"""Period at which the autopilot reports each aircraft that its ADS-B receiver hears."""


class Parameter(msgspec.Struct, frozen=True):
    """One parameter of an attack, with the range within which it is drawn and searched."""

    name: str
    low: float
    high: float

    def at(self, share: float) -> float:
        """Value at a share (0 to 1) of the range."""
        return self.low + min(max(share, 0.0), 1.0) * (self.high - self.low)


PLACE: Final = (
    Parameter("place_m", 10.0, 400.0),
    Parameter("place_turn", 0.0, 1.0),
    Parameter("power_dbm", 5.0, 30.0),
)
"""Parameters of the transmitter: its position relative to the point below the meeting point, and its
power."""

Values = dict[str, float]
"""Parameters of one attack by name."""


@dataclass(frozen=True, slots=True)
class Aircraft:
    """True state of an aircraft: NED, m and m/s."""

    position: Vec3
    velocity: Vec3


@dataclass(frozen=True, slots=True)
class View:
    """What the attacker knows: the true states, because every aircraft broadcasts its state."""

    own: Aircraft
    honest: tuple[Aircraft, ...]
    names: tuple[str, ...]
    """Identities of the honest aircraft."""
    addresses: tuple[str, ...]
    """Their radio addresses."""


@dataclass(frozen=True, slots=True)
class Sent:
    """One transmission of the attacker: messages to be encoded, or a recorded frame."""

    transport: str
    address: str
    messages: tuple[Message, ...] = ()
    frame: bytes = b""
    quieter_db: float = 0.0
    """Reduction of the transmit power from full power, dB."""


@dataclass(slots=True)
class Budget:
    """Frames that one transmitter may still send on each transport."""

    _left: dict[str, float] = field(
        default_factory=lambda: {t: _BURST_S * n for t, n in FRAMES_PER_S.items()}
    )

    def pass_time(self, elapsed_s: float) -> None:
        """Advance the time; new frames become possible."""
        for transport, rate in FRAMES_PER_S.items():
            self._left[transport] = min(self._left[transport] + rate * elapsed_s, _BURST_S * rate)

    def spend(self, transport: str) -> bool:
        """Use one frame; False if the transmitter cannot send more now."""
        if self._left[transport] < 1.0:
            return False
        self._left[transport] -= 1.0
        return True


class Attacker(Protocol):
    """Computes the attacker's transmissions in one flight."""

    def send(self, now_s: float, view: View) -> list[Sent]:
        """Frames to send in this step, the most important first."""

    def overhear(self, now_s: float, sender: str, transport: str, address: str, frame: bytes) -> None:
        """Receive a frame of an honest aircraft or of the own aircraft."""

    def reports(self, now_s: float, view: View) -> list[AdsbVehicle]:
        """Aircraft that the forged ADS-B signals show to the autopilot's receiver in this step."""

    def lie(self) -> Vec3:
        """Offset (NED, m) of the positions that the first honest aircraft sends."""


class Silent:
    """An attacker that does nothing; base of the others."""

    def __init__(self, values: Values, scene: Scene, rng: np.random.Generator) -> None:
        self.values = values
        self.scene = scene
        self.rng = rng

    def send(self, now_s: float, view: View) -> list[Sent]:
        """See `Attacker.send`."""
        return []

    def overhear(self, now_s: float, sender: str, transport: str, address: str, frame: bytes) -> None:
        """See `Attacker.overhear`."""

    def reports(self, now_s: float, view: View) -> list[AdsbVehicle]:
        """See `Attacker.reports`."""
        return []

    def lie(self) -> Vec3:
        """See `Attacker.lie`."""
        return 0.0, 0.0, 0.0


class Clock:
    """Counts the frames that are due at a rate."""

    def __init__(self, begin_s: float) -> None:
        self._due_s = begin_s

    def due(self, now_s: float, rate: float) -> int:
        """Number of frames that have become due since the last call."""
        count = 0
        while self._due_s <= now_s and count < 200:
            self._due_s += 1.0 / max(rate, 0.05)
            count += 1
        return count


def place_of(values: Values) -> Vec3:
    """Position of the transmitter (NED, m), which is on the ground."""
    away, turn = values.get("place_m", 100.0), 2.0 * math.pi * values.get("place_turn", 0.0)
    return away * math.cos(turn), away * math.sin(turn), -2.0


def turned(vector: Vec3, turn_rad: float) -> Vec3:
    """A vector turned clockwise, seen from above."""
    n, e, d = vector
    cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
    return cosine * n - sine * e, sine * n + cosine * e, d


def plus(a: Vec3, b: Vec3, times: float = 1.0) -> Vec3:
    """`a + times * b`."""
    return a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2]


def unit(vector: Vec3) -> Vec3:
    """The unit vector in a vector's direction; north for a zero vector."""
    length = math.hypot(*vector)
    if length < 1e-9:
        return 1.0, 0.0, 0.0
    return vector[0] / length, vector[1] / length, vector[2] / length
