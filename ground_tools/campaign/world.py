"""The conditions under which a fleet flies: navigation errors, messages and gusts."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from companion.arrays import Floats

# Indices of the array `world`, as `World.row` fills it.
(
    W_START,  # s, on the paths' clock
    W_END,  # s
    W_STEP,  # s
    W_PERIOD,  # steps from one decision to the next
    W_MESSAGE,  # steps from one message to the next
    W_DELAY_LOW,  # s
    W_DELAY_HIGH,  # s
    W_LOSS,  # share of messages that a receiver does not get
    W_SIGMA,  # m for each axis
    W_SIGMA_MEMORY,  # s
    W_SIGMA_VELOCITY,  # m/s for each axis
    W_DECLARED,  # m, position error that every aircraft declares of itself
    W_QUANTISED,  # 0 or 1
    W_LAG,  # s
    W_ACCELERATION,  # m/s^2
    W_GUST,  # m/s^2 for each axis
    W_GUST_MEMORY,  # s
    W_OWN_VELOCITY,  # m/s for each axis, error of the own velocity; correlation time as for the position
    W_CLOCK,  # s, largest clock error
    W_FLOOR,  # NED down, m
    W_CEILING,  # NED down, m
    W_SILENT,  # m, range within which a silent aircraft is received
    W_LIE,  # m, error of the position that a liar sends
    W_BLACKOUT,  # s, how long one aircraft has no GNSS
    WORLD_ENTRIES,
) = range(25)


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
    """Acceleration that gusts cause on a vehicle that holds its velocity, one standard deviation for each
    axis. Steady wind is not modelled: the vehicle compensates it."""
    gust_memory_s: Annotated[float, Meta(gt=0)] = 3.0
    own_sigma_mps: Annotated[float, Meta(ge=0)] = 0.0
    clock_s: Annotated[float, Meta(ge=0)] = 0.0
    """Largest error of a clock, either way. Each aircraft's error is drawn once."""
    floor_m: float = -math.inf
    """Height (the negative of NED down) in the local frame of the generators; unlimited by default."""
    ceiling_m: float = math.inf
    silent_m: Annotated[float, Meta(ge=0)] = 100.0
    lie_m: Annotated[float, Meta(ge=0)] = 50.0
    blackout_s: Annotated[float, Meta(ge=0)] = 0.0
    """How long one avoiding aircraft has no GNSS, around the middle of the flight. Meanwhile it sends
    nothing, decides nothing and stands still."""

    def row(self, period_s: float) -> Floats:
        """The same as an array for the compiled code, shape (WORLD_ENTRIES,).

        Args:
            period_s: time between two decisions of the law.
        """
        row = np.zeros(WORLD_ENTRIES)
        row[W_START], row[W_END], row[W_STEP] = self.start_s, self.end_s, self.step_s
        row[W_PERIOD] = max(1, round(period_s / self.step_s))
        row[W_MESSAGE] = max(1, round(self.message_s / self.step_s))
        row[W_DELAY_LOW], row[W_DELAY_HIGH] = self.delay_s
        row[W_LOSS], row[W_QUANTISED] = self.loss, self.quantised
        row[W_SIGMA], row[W_SIGMA_MEMORY] = self.sigma_m, self.sigma_memory_s
        row[W_SIGMA_VELOCITY], row[W_DECLARED] = self.sigma_mps, self.declared_m
        row[W_LAG], row[W_ACCELERATION] = self.lag_s, self.acceleration_mps2
        row[W_GUST], row[W_GUST_MEMORY] = self.gust_mps2, self.gust_memory_s
        row[W_OWN_VELOCITY], row[W_CLOCK] = self.own_sigma_mps, self.clock_s
        row[W_FLOOR], row[W_CEILING] = -self.floor_m, -self.ceiling_m
        row[W_SILENT], row[W_LIE] = self.silent_m, self.lie_m
        row[W_BLACKOUT] = self.blackout_s
        return row
