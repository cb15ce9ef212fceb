"""The fixed modes over the paper's sizes, computed once for all figures that need them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.channel.fixed_modes import Reading, Row, Settings, batches_of, evaluate, name_of
from ground_tools.channel.options import SIDES_M, UAVS
from sitl_mocks.channel.parameters import MODES, ChannelParameters, max_rates

SMALL_M = SIDES_M[:3]
"""The paper's high density; also "small" sizes."""
LARGE_M = SIDES_M[3:]
"""The paper's low density."""
SIGMA_PAPER_DB = math.sqrt(6.0)
"""Shadowing as the paper's table has it, a variance of 6 dB; its published delays come out without any."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One mode over rates and sizes; Wi-Fi in one of its two readings."""

    mode: str
    reading: Reading
    rows: dict[tuple[float, int], Row]
    """By side (m) and rate."""

    @property
    def name(self) -> str:
        """For people."""
        return name_of(self.mode, self.reading)

    @property
    def rates(self) -> tuple[int, ...]:
        """Ascending."""
        return tuple(sorted({rate for _, rate in self.rows}))

    def delay_ms(self, side_m: float, rate: int) -> float:
        """System delay; infinite where some message never arrives."""
        value = self.rows[side_m, rate].system_delay_ms
        return math.inf if value is None else value

    def loss(self, side_m: float, rate: int) -> float:
        """Packet loss; NaN, with which no comparison holds, where nobody is in range."""
        value = self.rows[side_m, rate].loss
        return math.nan if value is None else value

    def best_rate(self, sides_m: Sequence[float]) -> int:
        """The rate of least mean delay over these sizes; the lowest one on a tie."""
        return min(self.rates, key=lambda rate: sum(self.delay_ms(side_m, rate) for side_m in sides_m))

    def mean_ms(self, sides_m: Sequence[float], rate: int) -> tuple[float, float]:
        """Mean delay over sizes and its Monte Carlo standard error; the sizes are drawn independently."""
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
        """What one sigma takes."""
        parameters = ChannelParameters()
        rates = dict(zip(MODES, (tuple(range(1, n + 1)) for n in max_rates(parameters)), strict=True))
        return Settings(parameters, SIDES_M, rates, (sigma_db,), UAVS, self.samples, self.seed)

    def steps(self) -> int:
        """Calls of `advance` for one sigma."""
        return len(SIDES_M) * len(batches_of(self.settings(0.0)))

    def rows(self, sigma_db: float) -> tuple[Row, ...]:
        """All modes and rates in all sizes."""
        if sigma_db not in self._rows:
            found = evaluate(self.settings(sigma_db), self.advance)
            self._rows[sigma_db] = tuple(row for rows in found for row in rows)
        return self._rows[sigma_db]


def curves_of(rows: Sequence[Row]) -> dict[str, Curve]:
    """The rows of one sigma, by the curve's name."""
    curves: dict[str, Curve] = {}
    for row in rows:
        name = name_of(row.mode, row.wifi_channels)
        curve = curves.setdefault(name, Curve(row.mode, row.wifi_channels, {}))
        curve.rows[row.side_m, row.rate] = row
    return curves


def of_mode(curves: dict[str, Curve], mode: str) -> list[Curve]:
    """One curve for BLE, both readings for Wi-Fi."""
    return [curve for curve in curves.values() if curve.mode == mode]


def trios(curves: dict[str, Curve]) -> list[tuple[Curve, Curve, Curve]]:
    """BLE 4, BLE 5 and Wi-Fi side by side, once for each reading of Wi-Fi."""
    ble4, ble5 = of_mode(curves, BLE4)[0], of_mode(curves, BLE5)[0]
    return [(ble4, ble5, wifi) for wifi in of_mode(curves, WIFI_BEACON)]
