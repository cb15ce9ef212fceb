"""Assumptions of the packet simulator about schedules and receivers, and its durations in slots.

They follow section "Packet Reception Model" of the paper. Effects that it leaves out (drift, random delay,
half-duplex) can be switched on one by one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from companion.arrays import Floats, Indices
from companion.errors import ConfigError
from sitl_mocks.channel.parameters import BleParameters, ChannelParameters, Slots

BLE4, BLE5, WIFI = range(3)
"""Columns of `parameters.MODES`."""


_MAX_CLOCK_PPM = 1000.0


@dataclass(frozen=True, slots=True)
class Assumptions:
    """Assumptions about the radios. See `PAPER` and `REAL`.

    Raises:
        ConfigError: a value is not allowed.
    """

    slotted: bool
    """True: durations are rounded down to whole slots and every drawn time is a whole slot. False: times are
    exact and continuous.
    """
    advertiser: Literal["paper", "standard"]
    """"paper": the schedule restarts at each GNSS sample. "standard": it runs on at its own interval, and
    each event carries the latest sample."""
    phases: Literal["redrawn", "free"]
    """"redrawn": a receiver's scan phase is drawn anew for every GNSS cycle of every transmitter and mode.
    "free": one phase for each receiver and mode, running on."""
    random_delay: bool
    """Bluetooth events get the pseudo-random delay R_D."""
    half_duplex: bool
    """A radio that sends on Bluetooth receives no Bluetooth during that time. The same applies to Wi-Fi."""
    capture_db: float | None
    """A packet survives if it is this much stronger than each overlapping packet. None: it never survives."""
    clock_ppm: float
    """Each aircraft's clock error is drawn uniformly up to this, in either direction. It affects
    advertising intervals and scan patterns; GNSS samples keep true time.
    """
    carrier_sense: bool
    """A station that wants to send a beacon while it hears another station's waits as in `packets.access`.
    Bluetooth never waits. Foreign transmissions are drawn separately at each receiver, so no station waits
    for them.
    """

    def __post_init__(self) -> None:
        if self.advertiser not in ("paper", "standard"):
            raise ConfigError(f"advertiser: {self.advertiser!r}; allowed: 'paper', 'standard'")
        if self.phases not in ("redrawn", "free"):
            raise ConfigError(f"phases: {self.phases!r}; allowed: 'redrawn', 'free'")
        # The negated comparisons also refuse NaN.
        if self.capture_db is not None and not 0.0 <= self.capture_db < math.inf:
            raise ConfigError(
                f"capture_db: {self.capture_db:g} is out of range; allowed: None, or finite and >= 0"
            )
        if not 0.0 <= self.clock_ppm <= _MAX_CLOCK_PPM:
            raise ConfigError(
                f"clock_ppm: {self.clock_ppm:g} is out of range; allowed: 0 to {_MAX_CLOCK_PPM:g}"
            )
        if self.carrier_sense and self.slotted:
            raise ConfigError(
                "carrier_sense cannot be combined with slotted, because backoffs are shorter than a slot"
            )


PAPER = Assumptions(
    slotted=True,
    advertiser="paper",
    phases="redrawn",
    random_delay=False,
    half_duplex=False,
    capture_db=None,
    clock_ppm=0.0,
    carrier_sense=False,
)
"""Assumptions of the equations, except that scan phases are redrawn. A phase that stays the same in all
cycles may never deliver.
"""
REAL = Assumptions(
    slotted=False,
    advertiser="standard",
    phases="free",
    random_delay=True,
    half_duplex=True,
    capture_db=None,
    clock_ppm=20.0,
    carrier_sense=True,
)
"""Behaviour of radios that follow the standards. Not modelled: beacon intervals are whole time units of 1.024
ms, so that ten a second are only approximate. Effects that `packets.access` lists are not modelled either.
"""


@dataclass(frozen=True, slots=True)
class Durations:
    """Durations in slots, whole ones if slotted. Rows are modes in the order of `parameters.MODES`.

    A part is one packet of an event. Parts 0, 1, 2 are the packets on channels 37, 38, 39; part 3 is the
    auxiliary packet. A beacon is part 0.
    """

    slotted: bool
    slot_s: float
    gnss_period: float
    """T_GNSS in slots."""
    parts: Indices
    """Shape (3,): packets in one event."""
    offset: Floats
    """Shape (3, 4): time from the beginning of the event to that of the part."""
    length: Floats
    """Shape (3, 4): duration of the part, A_P, T_AUX or B_D."""
    span: Floats
    """Shape (3,): longest time from the beginning to the end of an event."""
    dwell: Floats
    """Shape (3,): time from one scanned channel to the next, S_I or T_S + C_T. A scan cycle has three."""
    window: Floats
    """Shape (3,): time within a dwell during which the receiver listens, S_W or T_S."""
    random_delay: Floats
    """Shape (3,): greatest random delay R_D; 0 for Wi-Fi."""
    uncertainty: float
    """O_U: greatest extra delay of an auxiliary packet."""

    @staticmethod
    def of(parameters: ChannelParameters, slotted: bool) -> Durations:
        """Compute the durations from the parameters."""
        slots = Slots(parameters)

        def count(duration_ms: float) -> float:
            return float(slots.of(duration_ms)) if slotted else duration_ms / parameters.slot_ms

        ble4, ble5, wifi = parameters.ble4, parameters.ble5, parameters.wifi
        offset, length = np.zeros((3, 4)), np.zeros((3, 4))
        primary: tuple[BleParameters, BleParameters] = (ble4, ble5)
        for mode, ble in enumerate(primary):
            offset[mode, :3] = np.arange(3) * (count(ble.packet_ms) + count(ble.gap_ms))
            length[mode, :3] = count(ble.packet_ms)
        offset[BLE5, 3] = count(ble5.auxiliary_offset_ms)
        length[BLE5, 3] = count(ble5.auxiliary_ms)
        length[WIFI, 0] = count(wifi.beacon_ms)
        span = np.max(offset + length, axis=1)
        uncertainty = count(ble5.auxiliary_uncertainty_ms)
        span[BLE5] += uncertainty
        wifi_dwell = count(wifi.scan_ms) + count(wifi.switch_ms)
        return Durations(
            slotted=slotted,
            slot_s=parameters.slot_ms / 1000.0,
            gnss_period=count(parameters.gnss_period_ms),
            parts=np.array([3, 4, 1], np.intp),
            offset=offset,
            length=length,
            span=span,
            dwell=np.array([count(ble4.scan_interval_ms), count(ble5.scan_interval_ms), wifi_dwell]),
            window=np.array([count(ble4.scan_window_ms), count(ble5.scan_window_ms), count(wifi.scan_ms)]),
            random_delay=np.array([count(ble4.random_delay_ms), count(ble5.random_delay_ms), 0.0]),
            uncertainty=uncertainty,
        )

    def uniform(self, upper: float, shape: int | tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Uniform times in [0, upper]. If slotted, they are whole slots including both ends."""
        if self.slotted:
            return rng.integers(0, int(upper), shape, endpoint=True).astype(float)
        return rng.uniform(0.0, upper, shape)

    def phase(self, period: float, shape: int | tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Uniform phases in [0, period). If slotted, they are whole slots."""
        if self.slotted:
            return rng.integers(0, int(period), shape).astype(float)
        return rng.uniform(0.0, period, shape)


def coprime_interval(rate: int, mode: int, parameters: ChannelParameters) -> int:
    """A-hat (B-hat) in slots: coprime to the scan cycle, nearest to floor(T_GNSS / psi), or the lower one."""
    durations = Durations.of(parameters, slotted=True)
    wanted = int(durations.gnss_period) // rate
    cycle = 3 * int(durations.dwell[mode])
    # A neighbour of a multiple of the cycle is coprime to it, so one cycle on each side is enough.
    near = (a for a in range(max(1, wanted - cycle), wanted + cycle + 1) if math.gcd(a, cycle) == 1)
    return min(near, key=lambda a: (abs(a - wanted), a))
