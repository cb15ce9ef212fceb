"""Results of a swarm run: positions from the vehicles' truth files, setpoints, frames and transports."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path, PurePath
from typing import Any

from rich.console import Console
from rich.table import Table

from companion import event_record
from companion.arrays import Floats
from companion.events import RemoteIdHeard
from companion.radio.frames_io import radio_address
from sitl_mocks.air.pair_statistics import PairStats, information_age
from sitl_mocks.encounters.choosing import choices_in_words, chosen_of
from sitl_mocks.encounters.lockstep import uas_id_of
from sitl_mocks.encounters.scenario_file import Scenario
from sitl_mocks.encounters.truth_files import run_of
from sitl_mocks.encounters.verdict import deviations_of, on_path_limit_m, pairs_of

_WORST_GAP_S = 0.5
_GOOD_SHARE = 0.999
_LEFT = 0.5
"""Share of its largest deviation that an aircraft off its path may still have to make up at the end. A flight
in real time is too short to wait for the whole return, whose last metres are slow.
"""
_UNHEARD = 3
"""Number of frames of a pair that may still lie in a socket when its companion ends."""


def limit_m(scenario: Scenario) -> float:
    """Separation that must hold: the sum of both conflict radii."""
    return 2.0 * scenario.avoidance.conflict_radius_m


def report_of(
    folder: Path,
    scenario: Scenario,
    vehicles: dict[str, dict[str, object]],
    air: dict[str, object],
    bad: list[str],
    paths: Mapping[str, Floats],
    times: tuple[float, float],
    *,
    interrupted: bool,
) -> dict[str, object]:
    """The verdict on a run, for JSON.

    Args:
        folder: run folder.
        vehicles: by aircraft, the final output of its vehicle process.
        air: the final output of the ether process.
        bad: processes that ended with an error.
        paths: by aircraft, its timed path as in `lockstep.paths_of`.
        times: UTC at which the paths began, and the time flown from then on (s).
        interrupted: whether Ctrl-C interrupted the run.
    """
    names, on_path = list(vehicles), on_path_limit_m(scenario)
    run, missing = run_of(folder, names, *times)
    pairs = pairs_of(run)
    deviations = deviations_of(run, [paths[one.name] for one in run.aircraft], on_path)
    gaps = {name: _gaps(left) for name, left in vehicles.items()}
    frames = _air(folder, {name: uas_id_of(scenario, name) for name in names}, air)
    torn: list[str] = []
    chosen = {name: chosen_of(_records(folder, name, torn)) for name in names}
    least = min((pair.min_separation_m for pair in pairs), default=None)
    reasons = [f"{name}: {why}" for name, why in missing.items()] + torn
    if interrupted:
        reasons.append("the run was interrupted")
    if least is None:
        reasons.append("there is no pair of aircraft")
    elif not least > limit_m(scenario):
        reasons.append(f"a pair came within {limit_m(scenario):g} m of each other")
    reasons += [
        f"{one.name}: it was {one.final_m:.1f} m from its path at the end and did not return; allowed: "
        f"{max(on_path, _LEFT * one.largest_m):.1f} m"
        for one in deviations
        if not one.final_m <= max(on_path, _LEFT * one.largest_m)
    ]
    reasons += [f"{name}: its setpoints were late or missing" for name, gap in gaps.items() if not _good(gap)]
    reasons += [
        f"{row['receiver']} heard {row['heard']} of {row['sent']} frames of {row['sender']}"
        for row in frames
        if not row["ok"]
    ]
    return {
        "ok": not bad and not reasons,
        "reasons": reasons,
        "interrupted": interrupted,
        "ended_badly": bad,
        "min_separation_m": None if least is None else round(least, 3),
        "separations": [
            {
                "pair": [pair.first, pair.second],
                "min_separation_m": round(pair.min_separation_m, 3),
                "at_s": round(pair.at_s, 2),
            }
            for pair in pairs
        ],
        "deviations": [asdict(one) for one in deviations],
        "setpoint_gaps": gaps,
        "air": frames,
        "policy": None if scenario.atmc.policy is None else PurePath(scenario.atmc.policy).name,
        "transports": {name: one.to_dict() for name, one in chosen.items()},
        "transports_in_words": choices_in_words(list(chosen.values())),
    }


def _good(gap: dict[str, float]) -> bool:
    return gap["share_under_100ms"] >= _GOOD_SHARE and gap["largest_s"] <= _WORST_GAP_S


def _gaps(left: dict[str, object]) -> dict[str, float]:
    received = int(str(left.get("setpoints_received", 0)))
    late = int(str(left.get("setpoint_gaps_over_100ms", 0)))
    largest = float(str(left.get("largest_setpoint_gap_s", "inf")))
    share = 0.0 if received < 2 else 1.0 - late / (received - 1)
    return {"setpoints": received, "share_under_100ms": round(share, 6), "largest_s": largest}


def _air(folder: Path, identities: dict[str, str], statistics: dict[str, object]) -> list[dict[str, object]]:
    """Frames per ordered pair: sent and lost (air's count), received (record of each companion).

    Every aircraft must have sent, and frames that were sent and not lost on the air must have been received.
    """
    addresses = {radio_address(identity): name for name, identity in identities.items()}
    pairs: dict[str, dict[str, Any]] = statistics.get("pairs", {})  # type: ignore[assignment]
    found: list[dict[str, object]] = []
    for receiver in identities:
        heard = _heard(folder, receiver, addresses)
        for sender in identities:
            if sender == receiver:
                continue
            row = pairs.get(f"{identities[sender]}>{identities[receiver]}", PairStats().to_dict())
            count = row["sent"]
            unheard = count - row["lost"] - heard.get(sender, 0)
            found.append(
                {
                    "sender": sender,
                    "receiver": receiver,
                    **row,
                    "heard": heard.get(sender, 0),
                    "lost_share": round(1.0 - heard.get(sender, 0) / count if count else 1.0, 4),
                    "ok": count > 0 and unheard <= _UNHEARD,
                }
            )
    return found


def _heard(folder: Path, receiver: str, addresses: dict[str, str]) -> dict[str, int]:
    counts: dict[str, int] = {}
    for item in _records(folder, receiver):
        if isinstance(item, event_record.Step):
            for event in item.events:
                if isinstance(event, RemoteIdHeard):
                    name = addresses.get(event.address, event.address)
                    counts[name] = counts.get(name, 0) + 1
    return counts


def _records(folder: Path, name: str, torn: list[str] | None = None) -> Iterator[event_record.Record]:
    """Event records of one aircraft.

    Args:
        torn: receives what is wrong with a file that is cut off, once it has been read.
    """
    for file in folder.glob(f"*-{name}/*.events"):
        with file.open("rb") as stream:
            reader = event_record.Reader(stream, str(file))
            yield from reader.records()
            left = stream.seek(0, os.SEEK_END) - reader.offset
            if left and torn is not None:
                torn.append(f"{name}: its record is cut off; its last {left} bytes are not a whole record")


def show(report: dict[str, Any], console: Console) -> None:
    """Print the verdict as tables and text."""
    pairs = Table(title="Least separation of each pair")
    pairs.add_column("pair")
    pairs.add_column("separation", justify="right")
    pairs.add_column("at", justify="right")
    for row in report["separations"]:
        pairs.add_row(" - ".join(row["pair"]), f"{row['min_separation_m']:.2f} m", f"{row['at_s']} s")
    console.print(pairs)
    gaps = Table(title="Setpoints at the vehicle")
    for name in ("aircraft", "received", "gaps under 100 ms", "largest gap"):
        gaps.add_column(name, justify="left" if name == "aircraft" else "right")
    for name, gap in report["setpoint_gaps"].items():
        gaps.add_row(
            name,
            f"{gap['setpoints']}",
            f"{100 * gap['share_under_100ms']:.2f} %",
            f"{gap['largest_s']:.3f} s",
        )
    console.print(gaps)
    lost = [row["lost_share"] for row in report["air"]]
    if lost:
        console.print(
            f"Remote ID: {len(lost)} pairs; largest share of lost messages {100 * max(lost):.1f} %; "
            f"{information_age(report['air'])}"
        )
    if report["policy"] is not None:
        console.print(report["transports_in_words"], highlight=False)
    for name in report["ended_badly"]:
        console.print(f"[red]ended with an error:[/] {name}")
    if "faults" in report:
        console.print(
            f"Least separation {report['min_separation_m']} m. It does not count, because a companion "
            "that is stopped or whose pilot has taken over does not avoid."
        )
        return
    word = "[bold green]OK[/]" if report["ok"] else "[bold red]FAILED[/]"
    console.print(
        f"{word}: least separation {report['min_separation_m']} m from the start of the timed paths"
    )
    for reason in report["reasons"]:
        console.print(f"  {reason}", soft_wrap=True, markup=False)
