"""The cities of the figure: every density with every method, without and with background load."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from ground_tools.city.cells import City
from ground_tools.city.traffic.demand import Demand
from sitl_mocks.channel.link_budget import ranges_m

DENSITIES: Final = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Aircraft in the air per square kilometre."""
LOADS: Final = (0.0, 0.6)
"""Shares of time for which foreign transmissions fill the Wi-Fi channel, as in `paper closed-loop`."""
AIRCRAFT: Final = 400
LEAST_SIDE_M, MOST_SIDE_M = 2000.0, 20_000.0
START_S: Final = 15.0
"""CPU time that a worker process needs to start and to load its compiled functions, s."""


@dataclass(frozen=True, slots=True)
class Method:
    """How aircraft learn of each other, and by which transports."""

    words: str
    """Display name."""
    settings: dict[str, Any]
    """Values of fields of `City`."""
    cost_us: tuple[float, float, float, float]
    """CPU time (us) per aircraft and simulated second, measured at 1, 10, 30 and 100 aircraft per km²."""
    talks: bool = True
    """Whether the method uses radio, so that background load has an effect."""


PERFECT, NOBODY = "perfect", "none"
METHODS: Final = {
    "ble4": Method("BLE 4 at 10", {"transports": "ble4"}, (51, 52, 75, 77)),
    "ble5": Method("BLE 5 at 10", {"transports": "ble5"}, (51, 74, 93, 74)),
    "wifi": Method("Wi-Fi at 10", {"transports": "wifi"}, (67, 118, 143, 108)),
    "wifi-2": Method("Wi-Fi at 2", {"transports": "wifi-2"}, (67, 118, 143, 108)),
    "wifi-1": Method("Wi-Fi at 1", {"transports": "wifi-1"}, (67, 118, 143, 108)),
    "ble4-wifi-2": Method("BLE 4 at 10, Wi-Fi at 2", {"transports": "ble4-wifi-2"}, (62, 121, 135, 134)),
    "all-2": Method("all three at 2", {"transports": "all-2"}, (62, 121, 135, 134)),
    "fixed": Method("best fixed legal set", {"transports": "fixed"}, (62, 121, 135, 134)),
    "rule": Method("rule", {"transports": "rule"}, (64, 128, 138, 136)),
    "policy": Method("policy", {"transports": "policy"}, (74, 152, 174, 152)),
    "ideal": Method(
        "ideal radio", {"knows": "given", "delay_s": (0.0, 0.0)}, (37, 83, 266, 482), talks=False
    ),
    PERFECT: Method("perfect information", {"knows": "perfect"}, (37, 43, 49, 68), talks=False),
    NOBODY: Method("nobody avoids", {"law": "none", "knows": "perfect"}, (30, 27, 25, 26), talks=False),
}
"""The methods. The single transports ignore the region's rules: BLE 4 or BLE 5 alone is legal nowhere.
With the ideal radio every message, one a second, arrives at once at all within 2 km. With perfect information
the law knows the true state of everybody at every decision; it has no tracks then, and so no growth."""
_COSTS_AT: Final = (1.0, 10.0, 30.0, 100.0)


@dataclass(frozen=True, slots=True)
class Cell:
    """One point of one curve: runs that differ in their seeds."""

    load: float
    density: float
    method: str


@dataclass(frozen=True, slots=True)
class Grid:
    """Which cells are flown, and how."""

    densities: tuple[float, ...] = DENSITIES
    methods: tuple[str, ...] = tuple(METHODS)
    loads: tuple[float, ...] = LOADS
    seeds: range = range(1, 4)
    aircraft: int = AIRCRAFT
    """Mean number of aircraft in the air, which determines the area."""
    pattern: str = "mixed"
    region: str = "us"
    """Region whose rules decide which sets of transports are legal."""
    duration_s: float = 300.0
    settle_s: float = 60.0

    def cells(self) -> Iterator[Cell]:
        """All cells. A method without radio has one cell for each load, with the same runs in each."""
        for load in self.loads:
            for density in self.densities:
                for method in self.methods:
                    yield Cell(load, density, method)

    @property
    def options(self) -> str:
        """The command-line options that give this grid, without those at their defaults."""
        usual = Grid()
        given = {
            "--densities": words_of(self.densities, usual.densities),
            "--methods": words_of(self.methods, usual.methods),
            "--loads": words_of(self.loads, usual.loads),
            "--seeds": words_of((f"{self.seeds[0]}-{self.seeds[-1]}",), ("1-3",)),
            "--aircraft": words_of((self.aircraft,), (usual.aircraft,)),
            "--pattern": words_of((self.pattern,), (usual.pattern,)),
            "--region": words_of((self.region,), (usual.region,)),
            "--minutes": words_of((self.duration_s / 60.0,), (usual.duration_s / 60.0,)),
            "--settle": words_of((self.settle_s,), (usual.settle_s,)),
        }
        return "".join(f" {option} {words}" for option, words in given.items() if words)

    def side_m(self, density: float) -> float:
        """Side of the square city, m."""
        side = 1000.0 * math.sqrt(self.aircraft / density)
        return min(max(round(side, -1), LEAST_SIDE_M), MOST_SIDE_M)

    def city(self, cell: Cell) -> City:
        """The city that is flown for a cell."""
        side, method = self.side_m(cell.density), METHODS[cell.method]
        demand: dict[str, Any] = {"pattern": self.pattern, "per_km2": cell.density}
        flown: dict[str, Any] = dict(method.settings)
        if method.talks:
            flown |= {"load": cell.load, "region": self.region}
        return City(
            demand=Demand(**demand, north_m=side, east_m=side),
            duration_s=self.duration_s,
            settle_s=self.settle_s,
            **flown,
        )


def words_of(values: tuple[float | str, ...], usual: tuple[float | str, ...]) -> str:
    """The values of an option as text; empty if they are the defaults."""
    if values == usual:
        return ""
    return " ".join(value if isinstance(value, str) else f"{value:g}" for value in values)


def cost_s(city: City, method: str) -> float:
    """Expected CPU time of one run (s), from measured values."""
    at = np.log(np.clip(city.demand.per_km2, _COSTS_AT[0], _COSTS_AT[-1]))
    each = float(np.interp(at, np.log(_COSTS_AT), METHODS[method].cost_us))
    return 1e-6 * each * city.demand.aircraft * city.duration_s


def inside(range_m: float, side_m: float) -> float:
    """Mean share of the disc around an aircraft that lies inside the square, for an aircraft anywhere in it.
    A boundless city of this density would have more neighbours in range; this is the share that exists
    here."""
    radii = range_m * np.sqrt((np.arange(200) + 0.5) / 200.0)
    angles = 2.0 * math.pi * (np.arange(200) + 0.5) / 200.0
    north = np.abs(np.outer(radii, np.cos(angles)))
    east = np.abs(np.outer(radii, np.sin(angles)))
    shares = np.maximum(1.0 - north / side_m, 0.0) * np.maximum(1.0 - east / side_m, 0.0)
    return float(shares.mean())


def ranges_of(city: City) -> tuple[float, float, float]:
    """Ranges of BLE 4, BLE 5 and Wi-Fi, m."""
    from ground_tools.city.cells import channel_of

    ble4, ble5, wifi = ranges_m(channel_of(city)).tolist()
    return ble4, ble5, wifi
