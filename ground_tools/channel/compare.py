"""The command `ground-tools channel compare`: the equations against the packet-by-packet simulator.

The comparison varies the simulator's assumptions one by one, in three studies. "link": one sender and many
receivers that receive no other sender, so that only schedules and scans matter. "collision": all aircraft are
near each other, so that only colliding packets matter. "fleet": system delays of the fixed modes over the
sizes, on the same positions for both models.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import structs
from rich.console import Console
from rich.table import Table

from companion.arrays import Floats
from companion.errors import ConfigError
from ground_tools.channel import compare_plot, options
from ground_tools.channel.comparison import VARIANTS, Case, Row
from ground_tools.channel.options import SIDES_M, UAVS
from ground_tools.common.figure import drawn
from ground_tools.common.progress import progress
from ground_tools.common.workers import in_parallel
from sitl_mocks.channel import parameters
from sitl_mocks.channel.equations.analytic import Analytic, fixed_mode, system_delay_s
from sitl_mocks.channel.equations.delay import single_link_s
from sitl_mocks.channel.link_budget import Links, all_links, draw_positions
from sitl_mocks.channel.packets import metrics as packet_metrics
from sitl_mocks.channel.packets.simulation import Result, simulate
from sitl_mocks.channel.parameters import MODES, ChannelParameters

BEST_RATES = {"ble4": 9, "ble5": 10, "wifi": 10}
DENSE_M = 100.0
FLEETS = (10, 30, 100)
RECEIVERS = 200
_Z = 1.96
_TABLE_WIDTH = 170


@dataclass(frozen=True, slots=True)
class Effort:
    """Duration and number of the simulations."""

    seconds: float
    environments: int
    seed: int


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools channel compare`."""
    parser.description = (
        "Compare the channel model's equations with a packet-by-packet simulation: one link, colliding\n"
        "packets, and whole fleets. This takes minutes on all cores."
    )
    parser.epilog = "example: ground-tools channel compare --seconds 60 --environments 20 --out runs/channel"
    parser.add_argument(
        "--seconds",
        type=float,
        default=60.0,
        metavar="S",
        help="simulated time of a fleet, at least 30 s. One link is simulated for twice as long, at least "
        "120 s; colliding packets for S divided by the number of aircraft, at least 5 s (default: 60)",
    )
    parser.add_argument(
        "--environments",
        type=int,
        default=20,
        metavar="N",
        help="sets of positions for each case, except for one link (default: 20)",
    )
    options.add_seed(parser)
    options.add_parameters(parser)
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="folder in which to write compare.png and compare.jsonl"
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object per line instead of tables"
    )


def run(arguments: argparse.Namespace) -> int:
    """Run `ground-tools channel compare`. Returns 0.

    Raises:
        ConfigError: an option is wrong, or matplotlib is missing for --out.
    """
    if not 10.0 <= arguments.seconds <= 86_400.0:
        raise ConfigError(f"--seconds: {arguments.seconds:g} is out of range; allowed: 10 to 86400")
    # With fewer environments, 95 % intervals from the normal distribution would be far too narrow.
    if not 10 <= arguments.environments <= 10_000:
        raise ConfigError(f"--environments: {arguments.environments} is out of range; allowed: 10 to 10000")
    options.check_seed(arguments.seed)
    p = with_schedule(options.parameters_of(arguments), "coprime")
    for (mode, rate), largest in zip(BEST_RATES.items(), parameters.max_rates(p), strict=True):
        if rate > largest:
            raise ConfigError(
                f"--parameters: {arguments.parameters}: {mode}.max_rate: {largest} is too low; "
                f"allowed in this comparison: {rate} or more"
            )
    effort = Effort(arguments.seconds, arguments.environments, arguments.seed)
    console = Console(stderr=arguments.json)
    if arguments.out is None:
        _print(compare(p, effort), console, as_json=arguments.json)
        return 0
    options.make_folder(arguments.out)
    # The picture is opened first, so that a missing matplotlib is reported before the simulation.
    with drawn(arguments.out / "compare.png", compare_plot.SIZE_IN) as figure:
        rows = compare(p, effort)
        lines = "".join(_json_line(row) + "\n" for row in rows)
        (arguments.out / "compare.jsonl").write_text(lines, encoding="utf-8")
        _print(rows, console, as_json=arguments.json)
        compare_plot.draw(figure, rows)
    console.print(f"wrote {arguments.out / 'compare.png'}", soft_wrap=True, highlight=False)
    return 0


_LEGEND = """\
assumptions: those of the packet-by-packet simulation. The equations always use the paper's assumptions.
random phases: the equations with every Bluetooth event at a random phase.
packets: the packet-by-packet simulation. ratio: packets divided by equations.
One link: mean delay from one sender to all receivers; nobody else sends.
Colliding packets: share of packets lost because others sent at the same time.
Fixed modes: system delay, the sum over the aircraft of each one's mean delay to those it reaches.
never heard: pairs in range of which one heard nothing of the other in the whole run; not in the mean delay.
waiting: share of messages that had not arrived at the end. Where it is above 0, the delay is a lower bound.
-: no pair is in range."""


def _print(rows: list[Row], console: Console, *, as_json: bool) -> None:
    if as_json:
        for row in rows:
            print(_json_line(row))
        return
    # In the default 80 columns of a pipe or a file, numbers would be truncated.
    console = Console(width=max(console.width, _TABLE_WIDTH))
    for study in VARIANTS:
        console.print(_table(study, [row for row in rows if row.case.study == study]))
    console.print(_LEGEND, highlight=False)


def _json_line(row: Row) -> str:
    return json.dumps(row.as_dict(), allow_nan=False)


def with_schedule(p: ChannelParameters, schedule: Literal["coprime", "random"]) -> ChannelParameters:
    """The same parameters with the given schedule for both Bluetooth modes."""
    return structs.replace(
        p,
        ble4=structs.replace(p.ble4, schedule=schedule),
        ble5=structs.replace(p.ble5, schedule=schedule),
    )


def cases(p: ChannelParameters) -> list[Case]:
    """All cases of the three studies."""
    largest = dict(zip(MODES, parameters.max_rates(p), strict=True))
    found = [
        Case("link", variant, mode, rate, 1 + RECEIVERS)
        for variant in VARIANTS["link"]
        for mode in MODES
        for rate in range(1, 1 + largest[mode])
    ]
    found += [
        Case("collision", variant, mode, rate, uavs, DENSE_M)
        for variant in VARIANTS["collision"]
        for mode, rate in BEST_RATES.items()
        for uavs in FLEETS
    ]
    found += [
        Case("fleet", variant, mode, rate, UAVS, side_m)
        for variant in VARIANTS["fleet"]
        for mode, rate in BEST_RATES.items()
        for side_m in SIDES_M
    ]
    return found


def compare(p: ChannelParameters, effort: Effort) -> list[Row]:
    """Simulate every case, on all cores. Returns the rows in the order of `cases`."""
    asked = [(number, p, effort, case) for number, case in enumerate(cases(p))]
    found: dict[int, Row] = {}
    with progress("simulating", len(asked)) as advance:
        # Nothing is kept of an interrupted comparison, so nothing is said about it.
        for (number, *_), row in in_parallel(_row_of, asked, os.cpu_count() or 1, Console(quiet=True)):
            found[number] = row
            advance()
    return [found[number] for number in range(len(asked))]


def _row_of(item: tuple[int, ChannelParameters, Effort, Case]) -> Row:
    return row_of(*item[1:])


def row_of(p: ChannelParameters, effort: Effort, case: Case) -> Row:
    """The result of one comparison. It does not depend on which other cases are compared."""
    return {"link": _link, "collision": _collision, "fleet": _fleet}[case.study](p, effort, case)


def _link(p: ChannelParameters, effort: Effort, case: Case) -> Row:
    """Compare the delay of one sender to receivers that do not send."""
    rates = np.zeros((case.uavs, 3), np.intp)
    rates[0, case.column] = case.rate
    near, channels = np.zeros((case.uavs, case.uavs)), np.ones(case.uavs, np.intp)
    seconds = 2.0 * max(effort.seconds, 60.0)  # enough for the slowest mode
    result = simulate(p, case.assumptions, near, rates, channels, seconds, _rng(effort, case))
    delay = packet_metrics.sample_delay_s(result)
    each = delay.mean_s[0, 1:, case.column]
    mean, error = _mean_and_error(1000.0 * each[np.isfinite(each)])
    return Row(
        case,
        "delay_ms",
        1000.0 * single_link_s(case.mode, case.rate, p),
        1000.0 * single_link_s(case.mode, case.rate, with_schedule(p, "random")),
        mean,
        mean - _Z * error,
        mean + _Z * error,
        packet_metrics.never_heard(result),
        _waiting(delay, result, case),
    )


def _collision(p: ChannelParameters, effort: Effort, case: Case) -> Row:
    """Compare the loss among aircraft that are all near each other. Positions matter only for capture."""
    places, rng = _places(effort, case), _rng(effort, case)
    lost, expected, silent = [], [], []
    # Schedules that collide once may collide in every period: many short runs tell more than a few long ones.
    for _ in range(max(effort.environments, 100 * effort.environments // case.uavs)):
        links = all_links(draw_positions(1, case.uavs, DENSE_M, places), p.propagation, places)
        fleet = fixed_mode(case.uavs, case.mode, case.rate, p, rng)
        seconds = max(5.0, effort.seconds / case.uavs)
        result = simulate(p, case.assumptions, _matrix(links), fleet.rates, fleet.wifi_channel, seconds, rng)
        lost.append(result.lost[:, :, case.column].sum() / result.hearable[:, :, case.column].sum())
        expected.append(np.nanmean(Analytic(p).evaluate(links, fleet).loss[:, case.column]))
        silent.append(packet_metrics.never_heard(result))
    mean, error = _mean_and_error(np.array(lost))
    product = float(np.mean(expected))
    low, high = mean - _Z * error, mean + _Z * error
    return Row(case, "loss", product, product, mean, low, high, float(np.mean(silent)), 0.0)


def _fleet(p: ChannelParameters, effort: Effort, case: Case) -> Row:
    """Compare the system delay of a fixed mode, on the same positions for both models. Pairs of which one
    received nothing from the other do not count."""
    assert case.side_m is not None
    places, rng = _places(effort, case), _rng(effort, case)
    models = Analytic(p), Analytic(with_schedule(p, "random"))
    simulated, silent, waiting = [], [], []
    expected: list[float] = []
    at_random: list[float] = []
    for _ in range(effort.environments):
        links = all_links(draw_positions(1, case.uavs, case.side_m, places), p.propagation, places)
        fleet = fixed_mode(case.uavs, case.mode, case.rate, p, rng)
        for model, found in zip(models, (expected, at_random), strict=True):
            found.append(1000.0 * float(system_delay_s(model.evaluate(links, fleet), 1)[0]))
        seconds = max(effort.seconds, 30.0)
        result = simulate(p, case.assumptions, _matrix(links), fleet.rates, fleet.wifi_channel, seconds, rng)
        delay = packet_metrics.sample_delay_s(result)
        mean_s = delay.mean_s[:, :, case.column]
        heard = np.isfinite(mean_s)
        each = np.where(heard, mean_s, 0.0).sum(axis=1) / np.maximum(heard.sum(axis=1), 1)
        simulated.append(1000.0 * float(each.sum()))
        if result.carried.any():
            silent.append(packet_metrics.never_heard(result))
            waiting.append(_waiting(delay, result, case))
    # The spread of the positions is common to both models, so the interval is that of the paired difference.
    paired, error = _mean_and_error(np.array(simulated) - np.array(expected))
    equations = float(np.mean(expected))
    mean = equations + paired
    return Row(
        case,
        "system_delay_ms",
        equations,
        float(np.mean(at_random)),
        mean,
        mean - _Z * error,
        mean + _Z * error,
        float(np.mean(silent)) if silent else math.nan,
        float(np.mean(waiting)) if waiting else math.nan,
    )


def _waiting(delay: packet_metrics.SampleDelay, result: Result, case: Case) -> float:
    """Share of the samples of pairs with a finite mean delay that had not arrived at the end."""
    heard = np.isfinite(delay.mean_s[:, :, case.column])
    samples = 0.8 * result.duration_s / result.gnss_period_s * max(1, int(heard.sum()))
    return float(delay.open_samples[:, :, case.column][heard].sum() / samples)


def _places(effort: Effort, case: Case) -> np.random.Generator:
    """Random generator for the positions, the same for every mode and variant."""
    return np.random.default_rng([effort.seed, case.uavs, round(case.side_m or 0.0)])


def _rng(effort: Effort, case: Case) -> np.random.Generator:
    """Random generator of one case, independent of which other cases are simulated."""
    words = (case.study, case.variant, case.mode, case.rate, case.uavs, case.side_m)
    return np.random.default_rng([effort.seed, *(int.from_bytes(str(w).encode(), "little") for w in words)])


def _matrix(links: Links) -> Floats:
    """Matrix of the path loss from row to column (dB)."""
    loss = np.full((links.nodes, links.nodes), np.nan)
    loss[links.transmitter, links.receiver] = links.path_loss_db
    return loss


def _mean_and_error(values: Floats) -> tuple[float, float]:
    """Mean and standard error; NaN for a quantity that the number of values does not permit."""
    if len(values) < 2:
        return (float(values[0]) if len(values) else math.nan), math.nan
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))


def _table(study: str, rows: list[Row]) -> Table:
    table = Table(title={"link": "One link", "collision": "Colliding packets", "fleet": "Fixed modes"}[study])
    for name in ("assumptions", "mode", "rate", "UAVs", "side"):
        table.add_column(name)
    table.add_column("equations", justify="right")
    table.add_column("random phases", justify="right")
    for name in ("packets (95 %)", "ratio", "ratio, random", "never heard", "waiting"):
        table.add_column(name, justify="right")
    for row in rows:
        case = row.case
        unit, scale, digits = ("%", 100.0, 2) if row.quantity == "loss" else ("ms", 1.0, 0)
        half = scale * (row.packets_high - row.packets_low) / 2.0
        table.add_row(
            case.variant,
            case.mode,
            str(case.rate),
            str(case.uavs),
            "" if case.side_m is None else f"{case.side_m:g} m",
            f"{scale * row.equations:.{digits}f} {unit}",
            f"{scale * row.equations_random:.{digits}f} {unit}",
            f"{scale * row.packets:.{digits}f} ± {half:.{digits}f} {unit}",
            _cell(row.ratio, ".3f"),
            _cell(row.ratio_random, ".3f"),
            _cell(100 * row.never_heard, ".1f", " %"),
            _cell(100 * row.waiting, ".2f", " %"),
        )
    return table


def _cell(value: float, form: str, unit: str = "") -> str:
    return "-" if math.isnan(value) else f"{value:{form}}{unit}"
