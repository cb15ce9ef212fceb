"""The verdict on a swarm under faults: injected faults, broken rules, and aircraft without a result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from rich.console import Console

from sitl_mocks.examinations.faults import Fault, to_json
from sitl_mocks.examinations.swarm.schedule import GIVEN_BACK

_NUMBERS: Final = {
    "traffic": "({:.0f} other frames per second)",
    "burst": "({:.0f} other frames at once)",
    "late": "by {:.2f} s",
    "duplicate": "({:.2f} of the datagrams)",
    "reorder": "({:.2f} of the datagrams)",
    "slow": "(at {:.0f} bit/s)",
}
"""Kind of fault -> text for its first number."""


@dataclass(slots=True)
class Done:
    """A fault that was injected, its time (s of the timed paths), and the answers to the pilot."""

    at_s: float
    fault: Fault
    held: bool = False
    """Whether the companion controlled the vehicle."""
    answers: tuple[str, ...] = ()
    """Answers of the vehicle to the pilot: the time until acceptance, or another result."""

    def to_json(self) -> dict[str, Any]:
        """Plain values for JSON."""
        row = to_json(self.fault) | {"at_s": round(self.at_s, 3), "held": self.held}
        return row | ({"answers": list(self.answers)} if self.answers else {})

    def words(self) -> str:
        """Text for people."""
        fault = self.fault
        number = _NUMBERS.get(fault.kind, "").format(*fault.numbers)
        words = " ".join(word for word in (fault.kind, ", ".join(fault.modes), number) if word)
        lasts = f" for {fault.lasts_s:.2f} s" if fault.lasts_s else ""
        held = "" if self.held or fault.kind in ("traffic", GIVEN_BACK) else " (companion not in control)"
        return f"{words}{lasts}{held}"


def broken(reports: dict[str, Any]) -> bool:
    """Whether a rule was broken, or an aircraft has no result."""
    return any(report["breaches"] or report["unknown"] for report in reports.values())


def judged(report: dict[str, object], reports: dict[str, Any]) -> dict[str, object]:
    """The swarm's report with the results of the faults.

    The criteria of a run without faults are reported but do not count, because a stopped companion neither
    avoids nor sends nor receives.
    """
    ok = not report["ended_badly"] and not report["interrupted"] and not broken(reports)
    return report | {"ok": ok, "faults": reports}


def show(reports: dict[str, Any], console: Console) -> None:
    """Print, for each aircraft, the injected faults and the broken rules."""
    for name, report in reports.items():
        console.print(f"[bold]{name}[/], link {report['link']}: injected faults", highlight=False)
        for row in report["done"]:
            given = {key: row[key] for key in ("kind", "lasts_s", "numbers", "modes") if key in row}
            fault = Fault(at_s=row["at_s"], **given)
            words = Done(row["at_s"], fault, row["held"]).words()
            answers = "; answers: " + ", ".join(row["answers"]) if "answers" in row else ""
            console.print(f"  {row['at_s']:7.2f} s  {words}{answers}", highlight=False, markup=False)
        _show_result(report, console)
    failed = [name for name, report in reports.items() if report["breaches"]]
    unknown = [name for name, report in reports.items() if report["unknown"]]
    console.print(
        f"{len(reports)} aircraft: rules broken by {', '.join(failed) or 'none'}; "
        f"no result for {', '.join(unknown) or 'none'}",
        highlight=False,
    )


def _show_result(report: dict[str, Any], console: Console) -> None:
    console.print(
        f"  {report['setpoints']} setpoints; {report['choices']} mode selections, "
        f"{report['choices_while_held']} of them with the companion in control; {report['crossed']} crossed "
        f"a request on the link, {report['alike']} not judged; "
        f"{len(report['not_done'])} scheduled faults not reached; "
        f"{report['dropped']} frames lost to the companion's full buffer; the router was up to "
        f"{report['router_late_s']:.2f} s late",
        highlight=False,
    )
    for breach in report["breaches"]:
        words = f"at {breach['at_s']:.3f} s: {breach['rule']}: {breach['words']}"
        waited = f"its threads waited {breach['waited_for_cpu_s']:.2f} s for the CPU around that time"
        console.print(f"  rule broken: {words} ({waited})", style="red", highlight=False, markup=False)
    if report["unknown"]:
        console.print(f"  no result: {report['unknown']}", style="red", highlight=False, markup=False)
    elif not report["breaches"]:
        console.print("  no rule was broken", highlight=False)
