"""Results of `sitl-mocks demo`, as data and as text."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass, field
from pathlib import Path, PurePath

from rich.console import Console
from rich.table import Table

from sitl_mocks.air.pair_statistics import information_age
from sitl_mocks.encounters.choosing import Chosen, choices_in_words, mean_switches, shares_of
from sitl_mocks.encounters.scenario_file import Scenario
from sitl_mocks.encounters.verdict import Deviation, Pair, on_path_limit_m


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight of one seed, reduced to the data that the verdict needs."""

    seed: int
    avoided: bool
    pairs: list[Pair]
    deviations: list[Deviation]
    wall_s: float
    simulated_s: float
    air: list[dict[str, object]]
    """Frame statistics by ordered pair: sender, receiver and the fields of `PairStats.to_dict`."""
    messages: dict[str, int]
    chosen: dict[str, Chosen]
    """Transports that each aircraft used, by name."""
    faults: dict[str, str] = field(default_factory=dict)
    """Aircraft -> why its law failed."""

    @property
    def min_separation_m(self) -> float:
        """Least separation of all pairs."""
        return min(p.min_separation_m for p in self.pairs)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on one seed, from both flights."""

    seed: int
    scenario: Scenario
    avoided: Outcome
    unavoided: Outcome

    @property
    def limit_m(self) -> float:
        """Separation that must hold: the sum of both conflict radii."""
        return 2.0 * self.scenario.avoidance.conflict_radius_m

    @property
    def met(self) -> bool:
        """Whether a pair came within the limit without avoidance, so that the flight shows what it does."""
        return self.unavoided.min_separation_m <= self.limit_m

    @property
    def ok(self) -> bool:
        """Whether every pair kept apart and every aircraft was back on its path at the end."""
        return not self.reasons()

    def reasons(self) -> list[str]:
        """Requirements that did not hold, as text."""
        found = []
        # A number that is not one fails every comparison, so what must hold is compared, not what must not.
        near = [p for p in self.avoided.pairs if not p.min_separation_m > self.limit_m]
        if not self.avoided.pairs or not self.avoided.deviations:
            found.append("nothing was flown")
        if near:
            found.append(
                f"{len(near)} of {len(self.avoided.pairs)} pairs came within {self.limit_m:g} m of each other"
            )
        found += [f"{name}: {fault}" for name, fault in self.avoided.faults.items()]
        deviations, on_path = self.avoided.deviations, on_path_limit_m(self.scenario)
        away = [d.final_m for d in deviations if not d.final_m <= on_path]
        if away:
            found.append(
                f"{len(away)} of {len(deviations)} aircraft were not back on their paths at the end "
                f"(worst {max(away):.1f} m, limit {on_path:g} m)"
            )
        return found

    def as_dict(self) -> dict[str, object]:
        """The verdict as one JSON object."""
        deviations = self.avoided.deviations
        air = self.scenario.air
        radio = {"delay_s": list(air.interval_s)} if air.model == "interval" else {"channel": air.model}
        policy = self.scenario.atmc.policy
        chooser = {} if policy is None else {"policy": PurePath(policy).name, **self._choices()}
        return {
            "seed": self.seed,
            **radio,
            **chooser,
            "aircraft": len(deviations),
            "min_separation_m": round(self.avoided.min_separation_m, 3),
            "unavoided_min_separation_m": round(self.unavoided.min_separation_m, 3),
            "max_deviation_m": round(max(d.largest_m for d in deviations), 3),
            "final_deviation_m": round(max(d.final_m for d in deviations), 3),
            "ok": self.ok,
        }

    def _choices(self) -> dict[str, object]:
        chosen = list(self.avoided.chosen.values())
        return {
            "shares": {name: round(share, 4) for name, share in shares_of(chosen).items()},
            "switches_per_minute": round(mean_switches(chosen), 3),
        }


def pair_rows(verdict: Verdict) -> list[dict[str, object]]:
    """Least separation of each pair in both flights, for JSON."""
    before = {(p.first, p.second): p for p in verdict.unavoided.pairs}
    return [
        {
            "pair": [p.first, p.second],
            "min_separation_m": round(p.min_separation_m, 3),
            "at_s": round(p.at_s, 2),
            "unavoided_min_separation_m": round(before[p.first, p.second].min_separation_m, 3),
        }
        for p in verdict.avoided.pairs
    ]


def _pairs_table(verdict: Verdict, *, avoids: bool) -> Table:
    """Least separation of each pair."""
    limit = verdict.limit_m
    table = Table(title=f"Least separation of each pair (must stay above {limit:g} m)")
    table.add_column("pair")
    for name in ("without avoidance", *(["with avoidance"] if avoids else []), "at"):
        table.add_column(name, justify="right")
    for row in pair_rows(verdict):
        before, after = float(str(row["unavoided_min_separation_m"])), float(str(row["min_separation_m"]))
        mark = "green" if after > limit else "red"
        table.add_row(
            " - ".join(verdict_name for verdict_name in row["pair"]),  # type: ignore[attr-defined]
            f"[{'red' if before <= limit else 'default'}]{before:.2f} m[/]",
            *([f"[{mark}]{after:.2f} m[/]"] if avoids else []),
            f"{row['at_s']} s",
        )
    return table


def _paths_table(verdict: Verdict) -> Table:
    """Deviations from the timed paths."""
    paths = Table(
        title=f"Return to the timed path (on the path means within {on_path_limit_m(verdict.scenario):g} m)"
    )
    paths.add_column("aircraft")
    for name in ("largest deviation", "returned after", "at the end"):
        paths.add_column(name, justify="right")
    for d in verdict.avoided.deviations:
        back = "-" if d.back_s is None else f"{d.back_s:.1f} s"
        paths.add_row(d.name, f"{d.largest_m:.1f} m", back, f"{d.final_m:.1f} m")
    return paths


def show(verdict: Verdict, folder: Path, console: Console) -> None:
    """Print the verdict on one seed as tables and text."""
    avoids = verdict.scenario.avoidance.law != "none"
    console.print(_pairs_table(verdict, avoids=avoids))
    console.print(_paths_table(verdict))
    a = verdict.avoided
    console.print(
        f"{a.simulated_s:.0f} simulated seconds in {a.wall_s:.1f} s ({a.simulated_s / a.wall_s:.0f} times "
        f"real time on one core); Remote ID: {a.messages['sent']} sent, {a.messages['delivered']} delivered, "
        f"{information_age(a.air)}"
    )
    if verdict.scenario.atmc.policy is not None:
        console.print(choices_in_words(list(a.chosen.values())), highlight=False)
    word = "[bold green]OK[/]" if verdict.ok else "[bold red]FAILED[/]"
    least = f"least separation {a.min_separation_m:.2f} m with avoidance, "
    least += f"{verdict.unavoided.min_separation_m:.2f} m without"
    if not avoids:
        least = f'least separation {a.min_separation_m:.2f} m without avoidance (law "none")'
    console.print(f"{word}: {least}; limit {verdict.limit_m:g} m", soft_wrap=True)
    if not verdict.met:
        console.print("  No pair came that near without avoidance, so this flight shows nothing about it.")
    for reason in verdict.reasons():
        console.print(f"  {reason}", soft_wrap=True)
    console.print(f"run folder: {folder}", soft_wrap=True)
    console.print(f"to inspect it: {command('ground-tools')} inspect {folder} --summary", soft_wrap=True)


def command(name: str) -> str:
    """How to call another of our commands: by its name if it is on PATH, else by its path beside this one."""
    beside = Path(sys.argv[0]).with_name(name)
    return name if shutil.which(name) or not beside.exists() else str(beside)


def seed_table(verdicts: list[Verdict]) -> Table:
    """Table with a line for each seed."""
    table = Table()
    for name in ("seed", "without avoidance", "with avoidance", "largest deviation", "at the end", "ok"):
        table.add_column(name, justify="right")
    for v in verdicts:
        row = v.as_dict()
        table.add_row(
            str(v.seed),
            f"{row['unavoided_min_separation_m']:.2f} m",
            f"{row['min_separation_m']:.2f} m",
            f"{row['max_deviation_m']:.1f} m",
            f"{row['final_deviation_m']:.1f} m",
            "yes" if v.ok else "NO",
        )
    return table
