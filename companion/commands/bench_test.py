"""`companion bench-test`: the checklist from the bench to two aircraft in the air, with evidence in a file.

It flies nothing and commands nothing. The first stage runs what `companion check` runs; every stage judges
the record of an ordinary `companion run`. A stage is judged only after all stages before it have passed with
the same software and the same aircraft. The version alone does not name the software, because an installation
from a checkout changes without it, so the code is compared as well.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from pathlib import Path
from typing import Final, get_args

import msgspec

from companion import __version__
from companion import config as configuration
from companion.commands.preflight import Light, Preflight
from companion.commands.run_evidence import Check, Stage, checks_of, read_run, record_sha256
from companion.config import Config
from companion.errors import ConfigError
from companion.runtime.record.code import code_sha256
from companion.runtime.record.disk import replace_file

STAGES: Final[tuple[Stage, ...]] = get_args(Stage)
WHAT: Final[dict[Stage, str]] = {
    "bench": "on the bench, without propellers: companion check, and a run of a minute, disarmed",
    "watch": 'a flight of two minutes by hand or on a mission, with flight.use = "watch"',
    "guard": 'a guarded mission with nobody near, flight.use = "guard", the ceiling high above it',
    "pair": "two aircraft on guarded missions that pass each other with 50 m of offset",
}
STATEMENTS: Final[dict[Stage, tuple[str, ...]]] = {
    "bench": ("propellers-off",),
    "watch": ("area-clear", "pilot-ready"),
    "guard": ("area-clear", "pilot-ready", "takeover-tried"),
    "pair": ("area-clear", "pilot-ready", "offset-50m"),
}
MEANING: Final = {
    "propellers-off": "the propellers are off",
    "area-clear": "nobody is below or beside the flight path, and the flight is permitted there",
    "pilot-ready": "a pilot held a transmitter and could take over at any time",
    "takeover-tried": "the pilot took over from a mission before, by mode switch (PX4: also by stick)",
    "offset-50m": "both paths stay 50 m apart sideways, and both pilots knew the plan",
}
"""Meaning of each statement of the operator, by its name. None of them can be measured."""


class Attempt(msgspec.Struct, frozen=True, kw_only=True):
    """One attempt at a stage."""

    stage: Stage
    passed: bool
    utc: str
    software: str
    code_sha256: str = ""
    """SHA-256 of the software's code, as `code_sha256` returns it; empty in older evidence."""
    aircraft: str
    config: str
    """Path of the configuration."""
    config_sha256: str
    """SHA-256 of its bytes."""
    run: str | None
    """Run folder that was judged."""
    record_sha256: str = ""
    """SHA-256 of the event record in it; empty in older evidence, and if the stage was not judged."""
    stated: tuple[str, ...]
    """What the operator stated, in words."""
    checks: tuple[Check, ...]
    refused: str | None = None
    """Why the stage was not judged at all; None if it was."""


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """Content of the evidence file: all attempts in their order."""

    attempts: tuple[Attempt, ...] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `companion bench-test`."""
    parser.description = (
        "Walk through the first-flight checklist, one stage after the other, and write the evidence into\n"
        "a file. Nothing is flown by this command: fly each stage with `companion run`, land, then have\n"
        "its run folder judged. Without a stage, the state of the checklist is shown.\n"
        "docs/bench-to-field.md has the whole procedure.\n\nstages:\n"
        + "".join(f"  {name:6} {what}\n" for name, what in WHAT.items())
    )
    parser.epilog = (
        "statements of the operator (--confirm):\n"
        + "".join(f"  {name:15} {meaning}\n" for name, meaning in MEANING.items())
        + "\nexamples:\n"
        "  companion bench-test --evidence first-flights.json\n"
        "  companion bench-test bench --config my.toml --run runs/NAME --confirm propellers-off\n"
        "  companion bench-test pair --config my.toml --run runs/NAME --confirm area-clear \\\n"
        "      --confirm pilot-ready --confirm offset-50m\n\n"
        "Exit codes: 0 passed, 1 not passed or refused, 2 wrong input."
    )
    parser.add_argument("stage", nargs="?", choices=STAGES, help="stage to judge; none: show the checklist")
    parser.add_argument("--config", type=Path, help="configuration that was flown (TOML)")
    parser.add_argument("--run", dest="folder", type=Path, metavar="FOLDER", help="run folder of this stage")
    parser.add_argument(
        "--confirm", action="append", default=[], choices=MEANING, metavar="STATEMENT",
        help="a statement of the operator, named as below; may be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--evidence", type=Path, default=Path("bench-test.json"), metavar="FILE",
        help="evidence file; attempts are added to it (default: bench-test.json)",
    )  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run `companion bench-test`. Returns 0 if the stage passed, otherwise 1.

    Raises:
        ConfigError: an option, the configuration, the run or the evidence file is wrong.
        PeerDataError: the record of the run is damaged.
    """
    evidence = read_evidence(arguments.evidence)
    if arguments.stage is None:
        print(overview(evidence))
        return 0
    if arguments.config is None or arguments.folder is None:
        raise ConfigError(f"bench-test {arguments.stage}: --config and --run are required")
    attempt = attempt_of(
        arguments.stage, arguments.config, arguments.folder, tuple(arguments.confirm), evidence
    )
    write_evidence(arguments.evidence, Evidence(attempts=(*evidence.attempts, attempt)))
    for check in attempt.checks:
        word = "passed" if check.passed else "FAILED"
        print(f"{word}  {check.what}: {check.measured} (needed: {check.needed})")
    if attempt.refused is not None:
        print(f"refused: {attempt.refused}", file=sys.stderr)
    print(f"stage {attempt.stage}: {'passed' if attempt.passed else 'NOT passed'}; {arguments.evidence}")
    return 0 if attempt.passed else 1


def attempt_of(
    stage: Stage, path: Path, folder: Path, stated: tuple[str, ...], evidence: Evidence
) -> Attempt:
    """Judge a stage, unless an earlier one has not passed or a statement is missing.

    Raises:
        ConfigError: the configuration or the run cannot be used.
        PeerDataError: the record of the run is damaged.
    """
    config = configuration.load(path)
    refused = _refusal(stage, stated, config, evidence)
    checks: list[Check] = []
    record = ""
    if refused is None:
        record = record_sha256(folder)
        refused = _judged_before(stage, record, evidence)
    if refused is None:
        checks = [
            *(_preflight(config) if stage == "bench" else ()),
            *checks_of(stage, read_run(folder), config),
        ]
    return Attempt(
        stage=stage,
        passed=refused is None and all(check.passed for check in checks),
        utc=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        software=__version__,
        code_sha256=code_sha256(),
        aircraft=config.identity.uas_id,
        config=str(path),
        config_sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
        run=str(folder),
        record_sha256=record,
        stated=tuple(MEANING[name] for name in stated),
        checks=tuple(checks),
        refused=refused,
    )


def _refusal(stage: Stage, stated: tuple[str, ...], config: Config, evidence: Evidence) -> str | None:
    for earlier in STAGES[: STAGES.index(stage)]:
        last = next((a for a in reversed(evidence.attempts) if a.stage == earlier), None)
        if last is None or not last.passed:
            state = "has not been tried" if last is None else "did not pass at its last attempt"
            return f'stage "{stage}" comes after "{earlier}", which {state}'
        if last.software != __version__:
            return f'stage "{earlier}" passed with software {last.software}; this is {__version__}: repeat it'
        if last.code_sha256 != code_sha256():
            return f'stage "{earlier}" passed with other code of version {__version__}: repeat it'
        if last.aircraft != config.identity.uas_id:
            return (
                f'stage "{earlier}" was passed by {last.aircraft}, not by {config.identity.uas_id}: repeat it'
            )
    missing = [name for name in STATEMENTS[stage] if name not in stated]
    if missing:
        words = "; ".join(f"--confirm {name}: {MEANING[name]}" for name in missing)
        return f'stage "{stage}" needs the operator\'s word ({words})'
    return None


def _judged_before(stage: Stage, record: str, evidence: Evidence) -> str | None:
    """Why one flight cannot be the evidence of two stages; None if it is that of one."""
    for attempt in evidence.attempts:
        if attempt.stage != stage and attempt.passed and attempt.record_sha256 == record:
            return f'this run passed the stage "{attempt.stage}" already; fly the stage "{stage}"'
    return None


def _preflight(config: Config) -> list[Check]:
    """The findings of `companion check`; a red one has not passed."""
    from companion.commands.check import findings

    found: Preflight = findings(config)
    return [
        Check(
            what=f"check, {finding.what}",
            measured=finding.text,
            needed="green or yellow",
            passed=finding.light is not Light.RED,
        )
        for finding in found.findings
    ]


def read_evidence(path: Path) -> Evidence:
    """Content of the evidence file; empty if there is no such file.

    Raises:
        ConfigError: it cannot be read, or is no evidence.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Evidence()
    except OSError as error:
        raise ConfigError(f"--evidence: {path}: {error.strerror}") from error
    try:
        return msgspec.json.decode(data, type=Evidence)
    except msgspec.DecodeError as error:
        raise ConfigError(
            f"--evidence: {path}: not written by bench-test of this version: {error}"
        ) from error


def write_evidence(path: Path, evidence: Evidence) -> None:
    """Write the evidence file.

    Raises:
        ConfigError: it cannot be written.
    """
    try:
        replace_file(path, msgspec.json.format(msgspec.json.encode(evidence), indent=2) + b"\n")
    except OSError as error:
        raise ConfigError(f"--evidence: {path}: {error.strerror}") from error


def overview(evidence: Evidence) -> str:
    """The checklist: each stage with its last attempt."""
    lines = []
    for stage in STAGES:
        last = next((a for a in reversed(evidence.attempts) if a.stage == stage), None)
        state = "not tried" if last is None else f"{'passed' if last.passed else 'NOT passed'} {last.utc}"
        lines.append(f"{stage:6} {state:28} {WHAT[stage]}")
        lines.append(f"{'':6} {'':28} --confirm {' --confirm '.join(STATEMENTS[stage])}")
    return "\n".join(lines)
