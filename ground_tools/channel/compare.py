"""`ground-tools channel compare`: the equations beside the packet-by-packet simulator, assumption by
assumption.

Three studies. "link": one sender and many receivers that hear nobody else, so that only schedules and scans
matter. "collision": everybody near everybody, so that only packets that meet matter. "fleet": system delays
of the fixed modes over the sizes, on the same positions for both models.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from companion.errors import ConfigError
from sitl_mocks.channel import packet_metrics, parameters
from sitl_mocks.channel.analytic import Analytic, fixed_mode, system_delay_s
from sitl_mocks.channel.delay import single_link_s
from sitl_mocks.channel.events import simulate
from sitl_mocks.channel.link_budget import Links, all_links, draw_positions
from sitl_mocks.channel.packet_timing import PAPER, REAL, Assumptions
from sitl_mocks.channel.parameters import MODES, ChannelParameters

Floats = NDArray[np.float64]

_EXACT = replace(PAPER, slotted=False)
_RUNNING_ON = replace(_EXACT, advertiser="standard", phases="free")
LINK_VARIANTS: dict[str, Assumptions] = {
    "as the equations": PAPER,
    "exact time": _EXACT,
    "phases run on": _RUNNING_ON,
    "phases run on, clocks drift": replace(_RUNNING_ON, clock_ppm=REAL.clock_ppm),
    "real radios": REAL,
}
"""Only schedules and scans differ; the last one adds the advertiser's random delay."""
COLLISION_VARIANTS: dict[str, Assumptions] = {
    "as the equations": PAPER,
    "exact time": _EXACT,
    "deaf while sending": replace(_EXACT, half_duplex=True),
    "real radios": REAL,
    "real radios, capture 6 dB": replace(REAL, capture_db=6.0),
}
FLEET_VARIANTS: dict[str, Assumptions] = {"as the equations": PAPER, "real radios": REAL}
BEST_RATES = {"ble4": 9, "ble5": 10, "wifi": 10}
SIDES_M = (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10_000.0)
DENSE_M = 100.0
FLEETS = (10, 30, 100)
_RECEIVERS = 200
_Z = 1.96


@dataclass(frozen=True, slots=True)
class Row:
    """One comparison. Delays in ms, losses as shares; intervals of 95 %."""

    study: str
    variant: str
    mode: str
    rate: int
    uavs: int
    side_m: float | None
    quantity: str
    analytic: float
    events: float
    events_low: float
    events_high: float
    ratio: float
    """Events over analytic."""
    never_heard: float
    """Share of the pairs in range that heard nothing in the whole run; they are left out of a mean delay."""
    waiting: float
    """Share of the counted samples that still waited at the end; where above 0, the delay is a lower
    bound."""


@dataclass(frozen=True, slots=True)
class Effort:
    """How long and how often is simulated."""

    seconds: float
    environments: int
    seed: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `ground-tools channel compare`."""
    parser.epilog = "example: ground-tools channel compare --seconds 60 --environments 20 --out runs/channel"
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated seconds of a run (default 60)")
    parser.add_argument(
        "--environments", type=int, default=20, help="positions drawn for each case (default 20)"
    )
    parser.add_argument("--seed", type=int, default=1, help="what chance draws from (default 1)")
    parser.add_argument("--parameters", type=Path, help="parameter file (TOML); default: the paper's table")
    parser.add_argument("--out", type=Path, help="folder for compare.png and compare.json")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")


def run(arguments: argparse.Namespace) -> int:
    """Compare and print.

    Raises:
        ConfigError: an option is wrong, or matplotlib is missing for --out.
    """
    if not 10.0 <= arguments.seconds <= 86_400.0:
        raise ConfigError(f"--seconds: {arguments.seconds:g}: allowed 10 to 86400")
    if not 2 <= arguments.environments <= 10_000:
        raise ConfigError(f"--environments: {arguments.environments}: allowed 2 to 10000")
    if arguments.seed < 0:
        raise ConfigError(f"--seed: {arguments.seed}: allowed 0 and above")
    p = ChannelParameters() if arguments.parameters is None else parameters.load(arguments.parameters)
    console = Console(stderr=arguments.json)
    rows = list(compare(p, Effort(arguments.seconds, arguments.environments, arguments.seed), console))
    if arguments.json:
        for row in rows:
            print(json.dumps(as_dict(row)))
    else:
        for study in dict.fromkeys(row.study for row in rows):
            console.print(_table(study, [row for row in rows if row.study == study]))
    if arguments.out is not None:
        from ground_tools.channel.compare_plot import draw

        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "compare.json").write_text("".join(json.dumps(as_dict(r)) + "\n" for r in rows))
        draw(rows, arguments.out / "compare.png")
        console.print(f"picture: {arguments.out / 'compare.png'}", soft_wrap=True)
    return 0


def as_dict(row: Row) -> dict[str, object]:
    """For JSON: what is not finite is null."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in asdict(row).items()}


def compare(p: ChannelParameters, effort: Effort, console: Console) -> Iterator[Row]:
    """All three studies, on all cores."""
    tasks: list[Callable[[], Row]] = []
    for variant, assumptions in LINK_VARIANTS.items():
        for mode in MODES:
            rates = range(1, 1 + parameters.max_rates(p)[MODES.index(mode)])
            tasks += [partial(link_row, p, effort, variant, assumptions, mode, rate) for rate in rates]
    for variant, assumptions in COLLISION_VARIANTS.items():
        for mode, rate in BEST_RATES.items():
            tasks += [
                partial(collision_row, p, effort, variant, assumptions, mode, rate, uavs) for uavs in FLEETS
            ]
    for variant, assumptions in FLEET_VARIANTS.items():
        for mode, rate in BEST_RATES.items():
            tasks += [
                partial(fleet_row, p, effort, variant, assumptions, mode, rate, side) for side in SIDES_M
            ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        futures = [pool.submit(task) for task in tasks]
        for future in track(
            futures, "simulating", console=console, transient=True, disable=not console.is_terminal
        ):
            yield future.result()


def link_row(
    p: ChannelParameters, effort: Effort, variant: str, assumptions: Assumptions, mode: str, rate: int
) -> Row:
    """One sender in the midst of receivers that do not send."""
    nodes = 1 + _RECEIVERS
    rates = np.zeros((nodes, 3), np.intp)
    rates[0, MODES.index(mode)] = rate
    near = np.zeros((nodes, nodes))
    # As much simulated time as the fleets get together; a run long enough for the slowest mode.
    seconds = max(effort.seconds, 60.0) * 2.0
    result = simulate(
        p,
        assumptions,
        near,
        rates,
        np.ones(nodes, np.intp),
        seconds,
        _rng(effort, "link", variant, mode, rate),
    )
    delay = packet_metrics.sample_delay_s(result)
    index = MODES.index(mode)
    each = delay.mean_s[0, 1:, index]
    heard = np.isfinite(each)
    mean, error = _mean_and_error(1000.0 * each[heard])
    counted = max(1, round(0.8 * seconds * 1000.0 / p.gnss_period_ms)) * max(1, int(heard.sum()))
    waiting = float(delay.open_samples[0, 1:, index][heard].sum()) / counted
    return _row(
        "link", variant, mode, rate, nodes, None, "delay_ms", 1000.0 * single_link_s(mode, rate, p), mean,
        error, packet_metrics.never_heard(result), waiting,
    )  # fmt: skip


def collision_row(
    p: ChannelParameters,
    effort: Effort,
    variant: str,
    assumptions: Assumptions,
    mode: str,
    rate: int,
    uavs: int,
) -> Row:
    """Everybody near everybody; positions matter only for capture."""
    index = MODES.index(mode)
    places, rng = _rng(effort, "collision", uavs), _rng(effort, "collision", variant, mode, uavs)
    lost, expected, silent = [], [], []
    # Schedules that meet once may meet in every period: many short runs say more than a few long ones.
    for _ in range(max(effort.environments, 100 * effort.environments // uavs)):
        links = all_links(draw_positions(1, uavs, DENSE_M, places), p.propagation, places)
        fleet = fixed_mode(uavs, mode, rate, p, rng)
        seconds = max(5.0, effort.seconds / uavs)
        result = simulate(p, assumptions, _matrix(links), fleet.rates, fleet.wifi_channel, seconds, rng)
        lost.append(float(result.lost[:, :, index].sum() / result.hearable[:, :, index].sum()))
        expected.append(float(np.nanmean(Analytic(p).evaluate(links, fleet).loss[:, index])))
        silent.append(packet_metrics.never_heard(result))
    mean, error = _mean_and_error(np.array(lost))
    return _row(
        "collision", variant, mode, rate, uavs, DENSE_M, "loss", float(np.mean(expected)), mean, error,
        float(np.mean(silent)), 0.0,
    )  # fmt: skip


def fleet_row(
    p: ChannelParameters,
    effort: Effort,
    variant: str,
    assumptions: Assumptions,
    mode: str,
    rate: int,
    side_m: float,
) -> Row:
    """System delay of ten aircraft; both models see the same positions. Pairs that never heard count
    nothing."""
    uavs, index = 10, MODES.index(mode)
    # The same positions for every mode and variant.
    places, rng = _rng(effort, "fleet", round(side_m)), _rng(effort, "fleet", variant, mode, round(side_m))
    simulated, expected, silent, waiting = [], [], [], []
    for _ in range(effort.environments):
        links = all_links(draw_positions(1, uavs, side_m, places), p.propagation, places)
        fleet = fixed_mode(uavs, mode, rate, p, rng)
        expected.append(1000.0 * float(system_delay_s(Analytic(p).evaluate(links, fleet), 1)[0]))
        seconds = max(effort.seconds, 30.0)
        result = simulate(p, assumptions, _matrix(links), fleet.rates, fleet.wifi_channel, seconds, rng)
        delay = packet_metrics.sample_delay_s(result)
        mean_s = delay.mean_s[:, :, index]
        heard = np.isfinite(mean_s)
        each = np.where(heard, mean_s, 0.0).sum(axis=1) / np.maximum(heard.sum(axis=1), 1)
        simulated.append(1000.0 * float(each.sum()))
        silent.append(packet_metrics.never_heard(result))
        counted = max(1, round(0.8 * seconds * 1000.0 / p.gnss_period_ms)) * max(1, int(heard.sum()))
        waiting.append(float(delay.open_samples[:, :, index][heard].sum()) / counted)
    # The positions' own spread is common to both models: the interval is that of the paired difference.
    paired, error = _mean_and_error(np.array(simulated) - np.array(expected))
    analytic = float(np.mean(expected))
    return _row(
        "fleet", variant, mode, rate, uavs, side_m, "system_delay_ms", analytic, analytic + paired, error,
        float(np.nanmean(silent)) if np.isfinite(silent).any() else math.nan, float(np.mean(waiting)),
    )  # fmt: skip


def _row(
    study: str,
    variant: str,
    mode: str,
    rate: int,
    uavs: int,
    side_m: float | None,
    quantity: str,
    analytic: float,
    events: float,
    error: float,
    never_heard: float,
    waiting: float,
) -> Row:
    ratio = events / analytic if analytic else math.nan
    return Row(
        study, variant, mode, rate, uavs, side_m, quantity, analytic, events,
        events - _Z * error, events + _Z * error, ratio, never_heard, waiting,
    )  # fmt: skip


def _rng(effort: Effort, *what: str | int) -> np.random.Generator:
    """A stream for each case, whatever else is simulated."""
    words = [int.from_bytes(str(w).encode(), "little") for w in what]
    return np.random.default_rng([effort.seed, *words])


def _matrix(links: Links) -> Floats:
    """Path loss from row to column (dB)."""
    loss = np.full((links.nodes, links.nodes), np.nan)
    loss[links.transmitter, links.receiver] = links.path_loss_db
    return loss


def _mean_and_error(values: Floats) -> tuple[float, float]:
    """Mean and standard error; NaN for what cannot be said."""
    if not len(values):
        return math.nan, math.nan
    return float(values.mean()), float(values.std(ddof=1) / len(values) ** 0.5) if len(
        values
    ) > 1 else math.nan


def _table(study: str, rows: list[Row]) -> Table:
    table = Table(title={"link": "One link", "collision": "Packets that meet", "fleet": "Fixed modes"}[study])
    for name in ("assumptions", "mode", "rate", "UAVs", "side"):
        table.add_column(name)
    for name in ("equations", "packets (95 %)", "ratio", "never heard", "waiting"):
        table.add_column(name, justify="right")
    for row in rows:
        unit, scale, digits = ("%", 100.0, 2) if row.quantity == "loss" else ("ms", 1.0, 0)
        half = scale * (row.events_high - row.events_low) / 2.0
        place = "" if row.side_m is None else f"{row.side_m:g} m"
        packets = f"{scale * row.events:.{digits}f} ± {half:.{digits}f} {unit}"
        table.add_row(
            row.variant,
            row.mode,
            str(row.rate),
            str(row.uavs),
            place,
            f"{scale * row.analytic:.{digits}f} {unit}",
            packets,
            f"{row.ratio:.3f}",
            f"{100 * row.never_heard:.1f} %",
            f"{100 * row.waiting:.2f} %",
        )
    return table
