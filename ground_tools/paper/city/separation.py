"""The command `ground-tools paper city-separation`: the room that each method needs for the same safety.

At one density, every method flies with laws that are asked to keep different separations. Losses are
counted below 10 m all the same. A larger separation costs distance from the timed point and saves losses.
So the methods can be
compared at equal safety: the better the information, the smaller the separation that is enough.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import msgspec

from companion.errors import ConfigError
from ground_tools.city import spread
from ground_tools.city.cells import City, Row
from ground_tools.paper.city import runs, study
from ground_tools.paper.city.grid import METHODS, NOBODY, Cell, Grid, words_of
from ground_tools.paper.city.numbers import LOSSES, MEASURES, estimate
from ground_tools.paper.city.picture import COLOURS, MARKS
from ground_tools.paper.city.table import text_of
from ground_tools.paper.city.verdict import Judged, judge

NAME: Final = "city-separation"
EXAMPLE: Final = "ground-tools paper city-separation --density 30 --methods policy perfect --seeds 1-2"
SEPARATIONS: Final = (4.0, 7.0, 10.0, 14.0, 20.0)
DENSITY: Final = 100.0
SHARE: Final = 0.01
"""Target: the method's losses per flight hour are at most this share of those of nobody avoiding."""
_METHODS: Final = tuple(method for method in METHODS if method != NOBODY)
_SHOWN: Final = tuple(m for m in MEASURES if m.key in ("losses_per_h", "deviation_m", "age_s", "unheard"))
_DEVIATION: Final = next(m for m in MEASURES if m.key == "deviation_m")
_PIPED_WIDTH: Final = 200


@dataclass(frozen=True, slots=True)
class Point:
    """Runs of one method whose law is asked to keep one separation."""

    method: str
    separation_m: float


Points = Mapping[Point, Sequence[Row]]
"""The runs of each point. Those of nobody avoiding are at separation 0."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is flown: one cell of `grid` for each method, with each separation."""

    grid: Grid
    separations: tuple[float, ...]

    @property
    def options(self) -> str:
        """The command-line options that give this plan, without those at their defaults."""
        (density,), (load,), usual = self.grid.densities, self.grid.loads, Grid()
        given = {
            "--separations": words_of(self.separations, SEPARATIONS),
            "--density": words_of((density,), (DENSITY,)),
            "--load": words_of((load,), (0.0,)),
            "--methods": words_of(self.grid.methods, _METHODS),
        }
        others = replace(self.grid, densities=usual.densities, loads=usual.loads, methods=usual.methods)
        return "".join(f" {option} {words}" for option, words in given.items() if words) + others.options

    def cities(self) -> dict[Point, City]:
        """The city of each point."""
        (density,), (load,) = self.grid.densities, self.grid.loads
        found = {}
        for method in self.grid.methods:
            city = self.grid.city(Cell(load, density, method))
            for separation_m in self.separations:
                point = Point(method, separation_m)
                found[point] = msgspec.structs.replace(city, separation_m=separation_m)
        found[Point(NOBODY, 0.0)] = self.grid.city(Cell(load, density, NOBODY))
        return found

    def missing(self, kept: Mapping[int, runs.Run]) -> list[runs.Work]:
        """The runs that have to be flown, the most costly ones first."""
        works = [
            runs.Work(point.method, city, seed)
            for point, city in self.cities().items()
            for seed in self.grid.seeds
            if runs.number_of(city, seed) not in kept
        ]
        return sorted(works, key=lambda work: -work.cost_s)

    def points(self, kept: Mapping[int, runs.Run]) -> dict[Point, list[Row]]:
        """The runs of each point. Points without any are left out."""
        found = {}
        for point, city in self.cities().items():
            numbers = [runs.number_of(city, seed) for seed in self.grid.seeds]
            rows = [kept[number].row for number in numbers if number in kept]
            if rows:
                found[point] = rows
        return found


def judged(points: Points, share: float) -> dict[Point, Judged]:
    """Comparison of each point with nobody avoiding.

    Args:
        share: as `SHARE`.
    """
    reference = estimate(points.get(Point(NOBODY, 0.0), ()), LOSSES)
    found = {}
    for point, rows in points.items():
        first = estimate(rows, LOSSES)
        if point.method != NOBODY and first is not None and reference is not None:
            found[point] = judge(first, reference, share)
    return found


def needed(points: Points, found: Mapping[Point, Judged], method: str) -> Point | None:
    """The least separation with which a method keeps the target, if it keeps it with all larger ones, too;
    None: with the largest one it does not."""
    best = None
    for point in sorted((p for p in points if p.method == method), key=lambda p: -p.separation_m):
        if point not in found or found[point].standing != "kept":
            break
        best = point
    return best


def sentences(points: Points, found: Mapping[Point, Judged], share: float) -> list[str]:
    """The result as text: for each method the room that the target costs."""
    lines = [f"Target: at most {share:.2g} of the losses per flight hour of: {METHODS[NOBODY].words}."]
    for method in dict.fromkeys(point.method for point in points if point.method != NOBODY):
        point = needed(points, found, method)
        words = METHODS[method].words
        if point is None:
            lines.append(f"  {words}: none of the separations flown is shown to keep it.")
            continue
        room = text_of(estimate(points[point], _DEVIATION), _DEVIATION)
        lines.append(
            f"  {words}: {point.separation_m:g} m keeps it ({found[point].words}), "
            f"at a mean distance from the timed point of {room} m."
        )
    return lines


def markdown(points: Points, found: Mapping[Point, Judged]) -> str:
    """The numbers of all points as a Markdown table."""
    heads = ["method", "separation (m)", "runs", "hours", "losses", *(m.title for m in _SHOWN)]
    lines = ["| " + " | ".join([*heads, "target"]) + " |", "|" + "---|" * (len(heads) + 1)]
    for point, rows in points.items():
        hours, losses = sum(row.flight_h for row in rows), sum(row.losses for row in rows)
        separation = f"{point.separation_m:g}" if point.separation_m else "-"
        head = [METHODS[point.method].words, separation, str(len(rows)), f"{hours:.1f}", str(losses)]
        words = [text_of(estimate(rows, m), m) for m in _SHOWN]
        standing = found[point].standing if point in found else "-"
        lines.append("| " + " | ".join([*head, *words, standing]) + " |")
    return "\n".join([*lines, ""])


def json_rows(points: Points, found: Mapping[Point, Judged]) -> list[dict[str, Any]]:
    """An object for each point."""
    lines = []
    for point, rows in points.items():
        line: dict[str, Any] = {
            "figure": NAME, "method": point.method, "separation_m": point.separation_m or None,
            "runs": len(rows), "flight_h": round(sum(row.flight_h for row in rows), 4),
            "losses": sum(row.losses for row in rows),
            "standing": found[point].standing if point in found else None,
        }  # fmt: skip
        for one in _SHOWN:
            value = estimate(rows, one)
            ends = () if value is None else (value.value, value.low, value.high)
            line[one.key] = [round(x, 6) if math.isfinite(x) else None for x in ends] or None
        lines.append(line)
    return lines


def draw(figure: Any, points: Points) -> None:
    """Draw the losses against the distance from the timed point: one line for each method."""
    axes = figure.add_subplot()
    for number, method in enumerate(dict.fromkeys(point.method for point in points)):
        above = number % 2 == 0  # so that the texts of two methods at one place do not cover each other
        places, values, names = [], [], []
        for point, rows in points.items():
            loss, room = estimate(rows, LOSSES), estimate(rows, _DEVIATION)
            if point.method != method or loss is None or room is None:
                continue
            colour = COLOURS[method]
            axes.plot([room.value] * 2, [max(loss.low, 1e-4), loss.high], color=colour, lw=1.0, alpha=0.6)
            places.append(room.value)
            values.append(loss.value if loss.value > 0.0 else loss.high)
            names.append((point.separation_m, loss.value > 0.0))
        axes.plot(places, values, color=COLOURS[method], marker=MARKS[method], label=METHODS[method].words)
        for x, y, (separation_m, any_loss) in zip(places, values, names, strict=True):
            text = f"{separation_m:g} m" if separation_m else ""
            axes.annotate(text if any_loss else f"{text}, none", (x, y), fontsize=8,
                          xytext=(4, 5 if above else -11), color=COLOURS[method],
                          textcoords="offset points")  # fmt: skip
    axes.set_yscale("log")
    axes.set_xlabel("mean distance from the timed point (m)")
    axes.set_ylabel("losses of separation (1/h)")
    axes.set_title(
        "Numbers: the separation that the law is asked to keep. Bars: 95 % intervals.\n"
        "none: no loss at all, drawn at the upper end of the interval",
        fontsize=10,
    )
    axes.legend(frameon=False)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `ground-tools paper city-separation`."""
    add = parser.add_argument
    parser.description = (
        "Fly one density with laws that are asked to keep different separations, and show for every way to "
        "learn of other aircraft what they cost and save: losses below 10 m against distance from the timed "
        "point. Then state the least separation with which each method keeps the target. Finished runs are "
        "kept in --out, so that the same command continues."
    )
    parser.epilog = f"example: {EXAMPLE}"
    add("--separations", type=float, nargs="+", default=list(SEPARATIONS), metavar="M",
        help=f"separations (default: {' '.join(f'{s:g}' for s in SEPARATIONS)})")  # fmt: skip
    add("--density", type=float, default=DENSITY, metavar="N",
        help=f"aircraft per km² (default: {DENSITY:g})")  # fmt: skip
    add("--load", type=float, default=0.0, metavar="SHARE",
        help="share of time for which foreign transmissions fill the Wi-Fi channel (default: 0)")  # fmt: skip
    add("--methods", nargs="+", choices=_METHODS, default=list(_METHODS), metavar="M",
        help=f"methods out of {', '.join(_METHODS)} (default: all)")  # fmt: skip
    add("--share", type=float, default=SHARE, metavar="SHARE",
        help="target: at most this share of the losses of nobody avoiding "
        f"(default: {SHARE:g})")  # fmt: skip
    study.add_options(parser, NAME, f"table.md and {NAME}.png")
    parser.set_defaults(run=run)


def plan_of(args: argparse.Namespace) -> Plan:
    """What the options describe.

    Raises:
        ConfigError: an option is out of range.
    """
    for separation_m in args.separations:
        if not 0.0 < separation_m <= 100.0:
            raise ConfigError(f"--separations: {separation_m:g} is out of range; allowed: above 0, up to 100")
    if not 0.0 < args.share < 1.0:
        raise ConfigError(f"--share: {args.share:g} is out of range; allowed: between 0 and 1")
    grid = study.grid_of(
        args,
        "--density",
        "--load",
        densities=(args.density,),
        methods=tuple(method for method in _METHODS if method in args.methods),
        loads=(args.load,),
    )
    return Plan(grid, tuple(sorted(set(args.separations))))


def run(args: argparse.Namespace) -> int:
    """Fly the missing runs and show all results; no picture without matplotlib. Returns 0.

    Raises:
        ConfigError: an option is wrong, or a file cannot be read or written.
    """
    plan, words, out = plan_of(args), study.console_of(args), args.out
    spread.jobs_of(args)  # reports wrong options before a folder is made
    file = study.opened(out)
    path = out / f"{NAME}.png"
    with study.figure(path, (9.0, 6.5)) as figure:
        study.fly(file, plan.missing(file.rows), args, words, f"ground-tools paper {NAME}{plan.options}")
        points = plan.points(file.rows)
        if figure is not None:
            draw(figure, points)
    found = judged(points, args.share)
    if args.json:
        for line in json_rows(points, found):
            print(json.dumps(line, allow_nan=False))
    else:
        for text in (*markdown(points, found).splitlines(), *sentences(points, found, args.share)):
            words.print(text, highlight=False, soft_wrap=True, markup=False)
    study.tell_files(words, [study.write(out / "table.md", markdown(points, found))], path)
    return 0
