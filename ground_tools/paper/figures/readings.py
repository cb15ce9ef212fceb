"""The published delays under each reading of the paper's channel model.

Each row changes one choice among those that docs/readings.md lists, and keeps the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from ground_tools.channel.fixed_modes import NAMES, Reading, Row, Settings, evaluate
from ground_tools.channel.options import SIDES_M, UAVS
from ground_tools.channel.plot import COLOURS
from ground_tools.common.figure import drawn
from ground_tools.paper.figures.fixed_modes import DENSITIES, PUBLISHED_MS
from ground_tools.paper.report import Numbers, Report, Value
from ground_tools.paper.study import SIGMA_PAPER_DB
from sitl_mocks.channel.equations.delay import single_link_s
from sitl_mocks.channel.parameters import (
    MODES,
    Ble5Parameters,
    BleParameters,
    ChannelParameters,
    WifiParameters,
)

RATES: Final = {BLE4: 9, BLE5: 10, WIFI_BEACON: 10}
"""The best rates, as published and as ours."""
_PARAMETERS: Final = ChannelParameters()
_LINK_RATES: Final = (1, 5, 10)


@dataclass(frozen=True, slots=True)
class Alternative:
    """One choice that differs from ours."""

    name: str
    parameters: ChannelParameters = _PARAMETERS
    wifi_channels: Reading = "shared"
    sigma_db: float = 0.0


ALTERNATIVES: Final = (
    Alternative("ours"),
    Alternative("I_xi to the letter", ChannelParameters(ble5=Ble5Parameters(pointers="interval"))),
    Alternative("same phase, empty sum 0", ChannelParameters(phases="same")),
    Alternative(
        "random phase of each event",
        ChannelParameters(ble4=BleParameters(schedule="random"), ble5=Ble5Parameters(schedule="random")),
    ),
    Alternative("shadowing of 6 dB variance", sigma_db=SIGMA_PAPER_DB),
    Alternative("random Wi-Fi channels", wifi_channels="random"),
    Alternative("both, as the table is printed", wifi_channels="random", sigma_db=SIGMA_PAPER_DB),
    Alternative(
        "Wi-Fi listens before it sends", ChannelParameters(wifi=WifiParameters(access="carrier_sense"))
    ),
    Alternative("Bluetooth deaf while it sends", ChannelParameters(bluetooth_half_duplex=True)),
)


def report(samples: int, seed: int) -> Report:
    """Both tables.

    Args:
        samples: environments of each size.
    """
    return Report(
        title="The published delays under each reading of the channel model",
        notes=(
            "docs/readings.md explains the readings. BLE 4 sends 9 messages a second, BLE 5 and Wi-Fi 10. "
            "high, low, dynamic: means over squares of 100 to 1,000 m, 3,000 to 10,000 m, and all six. "
            f"{samples:,} environments of each size.",
        ),
        numbers=(_links(), _systems(samples, seed)),
    )


def _links() -> Numbers:
    rows: list[dict[str, Value]] = []
    for one in ALTERNATIVES:
        if one.sigma_db == 0.0 and one.wifi_channels == "shared":
            delays: dict[str, Value] = {
                f"{mode}_{rate}_ms": 1000.0 * single_link_s(mode, rate, one.parameters)
                for mode in MODES
                for rate in _LINK_RATES
            }
            rows.append({"reading": one.name, **delays})
    heads = {f"{mode}_{rate}_ms": f"{NAMES[mode]}\n{rate}/s" for mode in MODES for rate in _LINK_RATES}
    title = "Mean delay of one link without interference (ms), by messages a second."
    return Numbers(title, {"reading": "reading", **heads}, tuple(rows))


def _systems(samples: int, seed: int) -> Numbers:
    rows: list[dict[str, Value]] = [
        {
            "reading": "published",
            **{
                f"{mode}_{density}_ms": PUBLISHED_MS.get((mode, density))
                for mode in MODES
                for density in DENSITIES
            },
        }
    ]
    for one in ALTERNATIVES:
        found = delays_ms(one, samples, seed)
        rows.append({"reading": one.name, **{f"{m}_{d}_ms": value for (m, d), value in found.items()}})
    heads = {f"{mode}_{d}_ms": f"{NAMES[mode]}\n{d}" for mode in MODES for d in DENSITIES}
    title = "System delay of ten aircraft (ms), by density."
    return Numbers(title, {"reading": "reading", **heads}, tuple(rows))


@lru_cache(maxsize=2 * len(ALTERNATIVES))
def delays_ms(one: Alternative, samples: int, seed: int) -> dict[tuple[str, str], float]:
    """System delay (ms) of each mode at each density. Cached, so that picture and table share it."""
    settings = Settings(
        one.parameters,
        SIDES_M,
        {mode: (rate,) for mode, rate in RATES.items()},
        (one.sigma_db,),
        UAVS,
        samples,
        seed,
    )
    rows = [row for side in evaluate(settings) for row in side]
    by_place: dict[tuple[str, float], Row] = {
        (row.mode, row.side_m): row
        for row in rows
        if row.mode != WIFI_BEACON or row.wifi_channels == one.wifi_channels
    }
    return {
        (mode, density): sum(by_place[mode, side].system_delay_ms or 0.0 for side in sides) / len(sides)
        for mode in MODES
        for density, sides in DENSITIES.items()
    }


def draw(samples: int, seed: int, path: Path, advance: Callable[[], None]) -> None:
    """Draw the system delay at dynamic density under each alternative, with the published numbers.

    Args:
        samples: environments of each size.
        advance: called after each alternative.

    Raises:
        ConfigError: `path` cannot be written, or matplotlib is missing.
    """
    with drawn(path, (12.0, 6.0)) as figure:
        axes = figure.subplots()
        figure.suptitle("System delay at dynamic density under each reading", fontsize=16, fontweight="bold")
        for place, one in enumerate(ALTERNATIVES):
            found = delays_ms(one, samples, seed)
            for mode in MODES:
                label = NAMES[mode] if place == 0 else None
                axes.plot(found[mode, "dynamic"], place, "o", ms=9, color=COLOURS[mode], label=label)
            advance()
        for mode in MODES:
            published = PUBLISHED_MS.get((mode, "dynamic"))
            if published is not None:
                label = f"{NAMES[mode]}, published"
                axes.axvline(published, color=COLOURS[mode], lw=1.5, ls="--", label=label)
        axes.set_yticks(range(len(ALTERNATIVES)), [one.name for one in ALTERNATIVES])
        axes.invert_yaxis()
        axes.set_xlim(left=0.0)
        axes.set_xlabel("system delay (ms)")
        figure.legend(loc="outside lower center", ncols=5, frameon=False)
