"""The conditions under which a fleet flies: navigation errors, messages and gusts."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta


class Conditions(NamedTuple):
    """A `World` and the period of the law in the form that compiled code takes: all fields are numbers."""

    start_s: float
    """Start of the flight on the paths' clock; `end_s` is its end."""
    end_s: float
    step_s: float
    period: float
    """Steps from one decision to the next."""
    message: float
    """Steps from one message to the next."""
    delay_low_s: float
    delay_high_s: float
    loss: float
    """Share of messages that a receiver does not get."""
    sigma_m: float
    sigma_memory_s: float
    sigma_mps: float
    declared_m: float
    """Position error that every aircraft declares of itself."""
    quantised: float
    """0 or 1: whether messages are quantised as in Remote ID."""
    lag_s: float
    acceleration_mps2: float
    gust_mps2: float
    gust_memory_s: float
    own_sigma_mps: float
    """Error of the own velocity, one standard deviation for each axis; its correlation time is that of the
    position error."""
    clock_s: float
    floor_down_m: float
    ceiling_down_m: float
    """NED down coordinate of the ceiling."""
    silent_m: float
    """Range within which a silent aircraft is received."""
    lie_m: float
    """Error of the position that a liar sends."""
    blackout_s: float
    """Duration for which one aircraft has no position."""
    mute: float
    """0 or 1: whether that aircraft sends nothing meanwhile."""
    signal: float
    """0 or 1: whether receivers measure the power of messages."""
    sender_db: float
    """Standard deviation of a sender's power. `link_db` and `message_db` are those of the shadowing."""
    link_db: float
    message_db: float


class World(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The conditions under which a fleet flies."""

    start_s: float = 0.0
    end_s: float = 500.0
    step_s: Annotated[float, Meta(gt=0)] = 0.1
    delay_s: tuple[float, float] = (0.0, 1.0)
    """Bounds of the message delay, drawn uniformly for every message and every receiver."""
    loss: Annotated[float, Meta(ge=0, le=1)] = 0.0
    sigma_m: Annotated[float, Meta(ge=0)] = 1.5
    """GNSS error, one standard deviation for each axis."""
    sigma_memory_s: Annotated[float, Meta(gt=0)] = 30.0
    sigma_mps: Annotated[float, Meta(ge=0)] = 0.3
    declared_m: Annotated[float, Meta(ge=0)] = 1.5
    quantised: bool = True
    message_s: Annotated[float, Meta(gt=0)] = 1.0
    lag_s: Annotated[float, Meta(gt=0)] = 0.5
    acceleration_mps2: Annotated[float, Meta(gt=0)] = 2.5
    gust_mps2: Annotated[float, Meta(ge=0)] = 0.0
    """Acceleration by gusts on a vehicle that holds its velocity, one standard deviation for each axis.
    Steady wind is not modelled, because the vehicle compensates for it."""
    gust_memory_s: Annotated[float, Meta(gt=0)] = 3.0
    own_sigma_mps: Annotated[float, Meta(ge=0)] = 0.0
    clock_s: Annotated[float, Meta(ge=0)] = 0.0
    """Largest clock error, either way. Each aircraft's error is drawn once."""
    floor_m: float = -math.inf
    """Height (the negative of NED down) in the local frame of the generators; unlimited by default."""
    ceiling_m: float = math.inf
    silent_m: Annotated[float, Meta(ge=0)] = 100.0
    lie_m: Annotated[float, Meta(ge=0)] = 50.0
    blackout_s: Annotated[float, Meta(ge=0)] = 0.0
    """Duration for which one avoiding aircraft has no position, around the middle of the flight. During this
    time it sends messages without a position, decides nothing and stands still."""
    mute: bool = False
    """Whether that aircraft sends nothing during this time: its companion has failed, or its radios have."""
    signal: bool = False
    """Whether receivers measure the power of messages and weigh it (`companion.avoidance.kernels.powers`)."""
    sender_db: Annotated[float, Meta(ge=0)] = 4.0
    """Standard deviation of a sender's power, drawn once for each aircraft."""
    link_db: Annotated[float, Meta(ge=0)] = 4.0
    """Standard deviation of the shadowing of a link, drawn once for each pair of sender and receiver."""
    message_db: Annotated[float, Meta(ge=0)] = 4.5
    """Standard deviation of the shadowing of a message; 6 dB together with that of the link."""

    def conditions(self, period_s: float) -> Conditions:
        """The same conditions for compiled code.

        Args:
            period_s: time between two decisions of the law.
        """
        same = {
            name: float(getattr(self, name)) for name in Conditions._fields if name in self.__struct_fields__
        }
        low_s, high_s = self.delay_s
        return Conditions(
            **same,
            period=float(max(1, round(period_s / self.step_s))),
            message=float(max(1, round(self.message_s / self.step_s))),
            delay_low_s=float(low_s),
            delay_high_s=float(high_s),
            floor_down_m=-float(self.floor_m),
            ceiling_down_m=-float(self.ceiling_m),
        )
