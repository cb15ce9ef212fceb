"""Options and output of `ground-tools atmc evaluate`; the measurement is in `evaluate`."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table

from companion.atmc.plugin_policy import plugin_policy
from companion.errors import ConfigError
from companion.shipped import given
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.channel.options import check_seed

if TYPE_CHECKING:
    from ground_tools.atmc.commands.evaluate import Question

_MAX_UAVS = 1000
_WORSE, _IN_SQUARE = "worse_side_", "vs_side_"
_SHOWN = (
    ("policy", "high_ms", "low_ms", "dynamic_ms"),
    ("best fixed mode", None, None, "best_fixed_dynamic_ms"),
    ("best fixed mode of each square", None, None, "best_fixed_by_side_dynamic_ms"),
    ("one-line rule", None, None, "rule_dynamic_ms"),
    ("search", None, None, "search_dynamic_ms"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools atmc evaluate`."""
    parser.description = (
        "Compare a frozen policy with the best fixed mode, the one-line rule and a search with full\n"
        "knowledge, all at the same positions in squares with sides of 100 to 10,000 m.\n\n"
        "objectives:\n"
        "  paper      system delay: the sum over the aircraft of each one's mean delay (ms)\n"
        "  awareness  mean age of an aircraft's information about those that could soon be in conflict\n"
        "             with it (ms)\n\n"
        "The advantage over the best fixed mode has a 95 % interval (bootstrap over the places), and the\n"
        "places are counted in which the policy is more than 5 % worse. In wide squares few pairs of\n"
        "aircraft are near each other: with few samples, single pairs decide."
    )
    parser.epilog = (
        "examples:\n  ground-tools atmc evaluate --policy config/policies/atmc.safetensors --region eu\n"
        "  ground-tools atmc evaluate --policy FILE --uavs 50 --samples 100 --load 0.5 --json"
    )
    parser.add_argument(
        "--policy", required=True, metavar="FILE|plugin:NAME", help="the frozen policy, or that of a plug-in"
    )
    parser.add_argument(
        "--objective",
        choices=("paper", "awareness"),
        help="the measure (default: the one that the policy was trained for)",
    )
    parser.add_argument(
        "--region",
        choices=("none", "us", "eu"),
        default="none",
        help="choose only sets of transports and rates that are legal there (default: none, no limit)",
    )
    parser.add_argument("--uavs", type=int, default=10, metavar="N", help="number of aircraft (default: 10)")
    parser.add_argument(
        "--load",
        type=float,
        default=0.0,
        metavar="L",
        help="share of time that foreign transmissions occupy the Wi-Fi channel (default: 0)",
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=1000,
        metavar="K",
        help="sets of positions in each square (default: 1000)",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="seed of the positions (default: 1)")
    parser.add_argument(
        "--sigma",
        type=float,
        default=0.0,
        metavar="DB",
        help="standard deviation of the shadowing (default: 0)",
    )
    parser.add_argument(
        "--wifi-channels",
        choices=("shared", "random"),
        default="shared",
        help="all aircraft on one channel, or each on 1, 6 or 11 at random (default: shared)",
    )
    parser.add_argument(
        "--no-guard",
        action="store_true",
        help="measure the policy alone, without the guard that it has aboard",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")


def run(args: argparse.Namespace) -> int:
    """Run `ground-tools atmc evaluate`. Returns 0.

    Raises:
        ConfigError: An option is wrong, the policy cannot be used, or PyTorch is missing.
    """
    evaluate = evaluation()
    plugged = plugin_policy(args.policy)
    file = given(args.policy)
    objective = args.objective
    if plugged is not None:
        objective = objective or evaluate.objective_of_plugin(plugged)
    else:
        data = evaluate.read_policy(file)
        objective = objective or evaluate.Frozen(data, str(file)).metadata.objective
    question = evaluate.Question(
        objective=objective,
        region=args.region,
        uavs=args.uavs,
        load=args.load,
        samples=args.samples,
        seed=args.seed,
        sigma_db=args.sigma,
        wifi_channels=args.wifi_channels,
        guarded=not args.no_guard,
    )
    _check(question)
    if plugged is not None:
        found = evaluate.evaluate_plugin(plugged, question)
    else:
        found = evaluate.evaluate(data, str(file), question)
    if args.json:
        print(json.dumps(found))
    else:
        _show(found)
    return 0


def evaluation() -> Any:
    """Set up PyTorch and import the module `evaluate`, which needs it.

    Raises:
        ConfigError: PyTorch is not installed.
    """
    set_up_torch()
    from ground_tools.atmc.commands import evaluate

    return evaluate


def _check(question: Question) -> None:
    if not 2 <= question.uavs <= _MAX_UAVS:
        raise ConfigError(f"--uavs: {question.uavs} is out of range; allowed: 2 to {_MAX_UAVS}")
    if not 0.0 <= question.load <= 0.95:
        raise ConfigError(f"--load: {question.load:g} is out of range; allowed: 0 to 0.95")
    if question.load and question.objective == "paper":
        raise ConfigError("--load: the paper's objective has no foreign transmissions; allowed with it: 0")
    if question.samples < 1:
        raise ConfigError(f"--samples: {question.samples} is out of range; allowed: 1 or more")
    check_seed(question.seed)
    if not 0.0 <= question.sigma_db <= 30.0:
        raise ConfigError(f"--sigma: {question.sigma_db:g} is out of range; allowed: 0 to 30")


def _show(found: dict[str, Any]) -> None:
    title = (
        f"{found['policy']}: {found['objective']}, {found['uavs']} aircraft, region {found['region']}, "
        f"load {found['load']:g}, {found['samples']:,} sets of positions in each square; ms"
    )
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for head in ("", "high density", "low density", "dynamic", "relative to the search"):
        table.add_column(head, justify="left" if not head else "right")
    floor = found["search_dynamic_ms"]
    for words, *keys in _SHOWN:
        values = ["" if key is None else f"{found[key]:,.1f}" for key in keys]
        table.add_row(words, *values, f"{100.0 * (found[str(keys[-1])] / floor - 1.0):+.1f} %")
    console = Console()
    console.print(table)
    console.print(_tail(found), highlight=False, soft_wrap=True)
    console.print(
        f"Best fixed mode: BLE 4 + BLE 5 + Wi-Fi at {found['best_fixed']} messages per second. The policy "
        f"takes {found['decision_us_median']:g} us for a decision (median) and switches "
        f"{found['switches_per_min']:g} times per minute.",
        highlight=False,
        soft_wrap=True,
    )


def _tail(found: dict[str, Any]) -> str:
    """How the policy compares with the best fixed mode: on average, and where it is worse."""
    low, high = (found.get(f"vs_best_fixed_{end}_pct") for end in ("low", "high"))
    text = f"Against the best fixed mode: {found['vs_best_fixed_pct']:+.1f} % "
    text += "(too few places for an interval). " if low is None else f"({low:+.1f} to {high:+.1f} %, 95 %). "
    worst, side = max((pct, key.split("_")[2]) for key, pct in found.items() if key.startswith(_IN_SQUARE))
    text += f"In the square where it does worst ({int(side):,} m): {worst:+.1f} %. "
    if not found["places"]:
        return text + "In no place could anybody soon be in conflict, so none is compared by itself."
    text += (
        f"In {found['places_worse']:,} of {found['places']:,} places the policy is more than 5 % worse "
        f"({found['places_worse_pct']:.1f} %; {found['places_worse_low_pct']:.1f} to "
        f"{found['places_worse_high_pct']:.1f} %)"
    )
    if found["places_worse"]:
        sides = [key.rpartition("_")[2] for key, count in found.items() if key.startswith(_WORSE) and count]
        shares = (f"{found[_WORSE + s]:,} of {found['places_side_' + s]:,} at {int(s):,} m" for s in sides)
        text += f": {', '.join(shares)}"
    return text + (
        f". Its cost is {found['ratio_p95']:.2f} times that of the best fixed mode or less in 95 % of the "
        f"places, {found['ratio_p99']:.2f} in 99 %, and {found['ratio_max']:.2f} at most."
    )
