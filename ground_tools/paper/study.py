"""The fixed modes over the paper's sizes, evaluated once for all figures that need them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.channel.fixed_modes import Reading, Row, Settings, batches_of, evaluate, name_of
from ground_tools.channel.options import SIDES_M, UAVS
from sitl_mocks.channel.parameters import MODES, ChannelParameters, max_rates

SMALL_M = SIDES_M[:3]
"""Sides (m) of the paper's high density, also called small sizes."""
LARGE_M = SIDES_M[3:]
"""Sides (m) of the paper's low density, also called large sizes."""
SIGMA_PAPER_DB = math.sqrt(6.0)
"""Shadowing of the paper's table, a variance of 6 dB. Its published delays come out without shadowing."""


@dataclass(frozen=True, slots=True)
class Curve:
    """Results of one mode over rates and sizes; for Wi-Fi with one of the two ways to assign channels."""

    mode: str
    reading: Reading
    rows: dict[tuple[float, int], Row]
    """Results by side (m) and rate."""

    @property
    def name(self) -> str:
        """Display name."""
        return name_of(self.mode, self.reading)

    @property
    def rates(self) -> tuple[int, ...]:
        """The rates, ascending."""
        return tuple(sorted({rate for _, rate in self.rows}))

    def delay_ms(self, side_m: float, rate: int) -> float:
        """System delay; infinite if some message never arrives."""
        value = self.rows[side_m, rate].system_delay_ms
        return math.inf if value is None else value

    def loss(self, side_m: float, rate: int) -> float:
        """Packet loss; NaN if no aircraft is in range of another, so that no comparison with it holds."""
        value = self.rows[side_m, rate].loss
        return math.nan if value is None else value

    def best_rate(self, sides_m: Sequence[float]) -> int:
        """The rate with the least mean delay over these sizes; the lowest such rate on a tie."""
        return min(self.rates, key=lambda rate: sum(self.delay_ms(side_m, rate) for side_m in sides_m))

    def mean_ms(self, sides_m: Sequence[float], rate: int) -> tuple[float, float]:
        """Mean delay over sizes and its Monte Carlo standard error; the sizes' draws are independent."""
        errors = [self.rows[side_m, rate].system_delay_se_ms or 0.0 for side_m in sides_m]
        mean = sum(self.delay_ms(side_m, rate) for side_m in sides_m) / len(sides_m)
        return mean, math.hypot(*errors) / len(sides_m)


@dataclass
class Study:
    """Environments of the paper's simulation: 10 aircraft in squares of 100 m to 10,000 m."""

    samples: int
    seed: int
    advance: Callable[[], None] = lambda: None
    """Called after each batch of environments."""
    _rows: dict[float, tuple[Row, ...]] = field(default_factory=dict)

    def settings(self, sigma_db: float) -> Settings:
        """The settings for the evaluation of one sigma."""
        parameters = ChannelParameters()
        rates = dict(zip(MODES, (tuple(range(1, n + 1)) for n in max_rates(parameters)), strict=True))
        return Settings(parameters, SIDES_M, rates, (sigma_db,), UAVS, self.samples, self.seed)

    def steps(self) -> int:
        """Number of calls of `advance` for one sigma."""
        return len(SIDES_M) * len(batches_of(self.settings(0.0)))

    def rows(self, sigma_db: float) -> tuple[Row, ...]:
        """Results of all modes and rates in all sizes; evaluated on the first call for a sigma."""
        if sigma_db not in self._rows:
            found = evaluate(self.settings(sigma_db), self.advance)
            self._rows[sigma_db] = tuple(row for rows in found for row in rows)
        return self._rows[sigma_db]


def curves_of(rows: Sequence[Row]) -> dict[str, Curve]:
    """Group the rows of one sigma into curves, by the curve's name."""
    curves: dict[str, Curve] = {}
    for row in rows:
        name = name_of(row.mode, row.wifi_channels)
        curve = curves.setdefault(name, Curve(row.mode, row.wifi_channels, {}))
        curve.rows[row.side_m, row.rate] = row
    return curves


def of_mode(curves: dict[str, Curve], mode: str) -> list[Curve]:
    """The curves of a mode: one for BLE, two for Wi-Fi (one for each way to assign channels)."""
    return [curve for curve in curves.values() if curve.mode == mode]


def trios(curves: dict[str, Curve]) -> list[tuple[Curve, Curve, Curve]]:
    """Triples of BLE 4, BLE 5 and Wi-Fi, one for each Wi-Fi curve."""
    ble4, ble5 = of_mode(curves, BLE4)[0], of_mode(curves, BLE5)[0]
    return [(ble4, ble5, wifi) for wifi in of_mode(curves, WIFI_BEACON)]
