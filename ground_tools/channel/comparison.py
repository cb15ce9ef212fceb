"""One comparison of the equations with the packet-by-packet simulator, and the assumptions that it varies."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

from sitl_mocks.channel.packets.timing import PAPER, REAL, Assumptions
from sitl_mocks.channel.parameters import MODES

_EXACT = replace(PAPER, slotted=False)
_NOT_LISTENING = replace(REAL, carrier_sense=False)
_RUNNING_ON = replace(_EXACT, advertiser="standard", phases="free")
VARIANTS: dict[str, dict[str, Assumptions]] = {
    "link": {
        "as the equations": PAPER,
        "exact time": _EXACT,
        "phases run on": _RUNNING_ON,
        "phases run on, clocks drift": replace(_RUNNING_ON, clock_ppm=REAL.clock_ppm),
        "real radios": REAL,
    },
    "collision": {
        "as the equations": PAPER,
        "exact time": _EXACT,
        "deaf while sending": replace(_EXACT, half_duplex=True),
        "real radios, no carrier sense": _NOT_LISTENING,
        "real radios": REAL,
        "real radios, capture 6 dB": replace(REAL, capture_db=6.0),
    },
    "fleet": {
        "as the equations": PAPER,
        "real radios, no carrier sense": _NOT_LISTENING,
        "real radios": REAL,
    },
}
"""Assumptions of the packet-by-packet simulator in each study, from those of the paper to those of the
standards."""


@dataclass(frozen=True, slots=True)
class Case:
    """The conditions of one comparison."""

    study: str
    variant: str
    mode: str
    rate: int
    uavs: int
    side_m: float | None = None

    @property
    def assumptions(self) -> Assumptions:
        """Assumptions of the packet-by-packet simulator."""
        return VARIANTS[self.study][self.variant]

    @property
    def column(self) -> int:
        """Index of the mode in `MODES`."""
        return MODES.index(self.mode)


@dataclass(frozen=True, slots=True)
class Row:
    """Result of one comparison. Delays in ms, losses as fractions; intervals of 95 %."""

    case: Case
    quantity: str
    equations: float
    """Value of the paper's equations."""
    equations_random: float
    """Value of the equations with Bluetooth events at random phases (`BleParameters.schedule`)."""
    packets: float
    packets_low: float
    packets_high: float
    never_heard: float
    """Share of the pairs in range that received nothing in the whole run. They do not enter a mean delay."""
    waiting: float
    """Share of the counted samples that had not arrived at the end. Above 0, the delay is a lower bound."""

    @property
    def ratio(self) -> float:
        """Value of the packets divided by that of the equations."""
        return self.packets / self.equations if self.equations else math.nan

    @property
    def ratio_random(self) -> float:
        """Value of the packets divided by that of the equations with random phases."""
        return self.packets / self.equations_random if self.equations_random else math.nan

    def as_dict(self) -> dict[str, object]:
        """The row as a flat dictionary for JSON; numbers that are not finite become None."""
        fields = asdict(self)
        flat = {**fields.pop("case"), **fields, "ratio": self.ratio, "ratio_random": self.ratio_random}
        return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in flat.items()}
