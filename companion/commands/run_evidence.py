"""Checks of a run's record for a stage of `companion bench-test`, with measured values."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec

from companion import __version__, event_record
from companion.authority.table import State
from companion.config import Config
from companion.errors import ConfigError
from companion.event_record import Header, Step
from companion.events import (
    AuthorityChanged,
    Broadcast,
    Decision,
    GateRefused,
    GlobalPosition,
    Heartbeat,
    InputBehind,
    Landed,
    LandedState,
    SetMode,
    SetSpeed,
    VehicleText,
    VelocitySetpoint,
)
from companion.runtime.record.code import code_sha256
from companion.runtime.record.disk import MANIFEST, RUN

Stage = Literal["bench", "watch", "guard", "pair"]
BENCH_S, IN_AIR_S, WATCHED_S, TOGETHER_S = 60.0, 120.0, 60.0, 60.0
CEILING_ROOM_M = 30.0
"""Least room between the greatest height that was flown and the configured ceiling, in the stage "guard"."""
LEAST_APART_M, MET_WITHIN_M = 25.0, 100.0
"""Stage "pair", with 50 m of offset: two aircraft must keep the first distance, and come within the
second."""
_STALL_S = 0.25
_SETTLED_S = 10.0
_BEHIND_SHARE = 0.01
_LOGGED_S = 1.5
"""Decisions are logged once a second while nothing is avoided, and more often otherwise."""
_SIMULATED = "SIM "
"""Beginning of the texts of ArduPilot's simulation, such as "SIM Hit ground at 0.5 m/s" at each landing."""
_COMMANDS = (VelocitySetpoint, SetMode, SetSpeed)


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that was checked."""

    what: str
    measured: str
    needed: str
    passed: bool


@dataclass
class Seen:
    """Facts of one run."""

    header: Header
    summary: dict[str, Any]
    manifest: dict[str, Any]
    steps: int = 0
    duration_s: float = 0.0
    in_air_s: float = 0.0
    worst_gap_s: float = 0.0
    behind: int = 0
    """Steps with late input, after the first seconds."""
    simulated: str | None = None
    """A text of the vehicle that only a simulated one sends; None if there was none."""
    armed: bool = False
    down_last: bool = True
    """The vehicle was on the ground at the end, as far as it reported that."""
    commands: int = 0
    broadcasts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    state_s: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    """Time in each state of authority (s)."""
    highest_m: float = -math.inf
    together_s: float = 0.0
    """Time in the air with at least one other aircraft heard."""
    nearest_m: float = math.inf
    """Least horizontal distance to another aircraft in the air, as heard."""


def read_run(folder: Path) -> Seen:
    """Read a run folder of `companion run`.

    Raises:
        ConfigError: it is no run folder, or the run was not recorded to its end.
        PeerDataError: its record is damaged.
    """
    path = _record_of(folder)
    summary = _facts(folder / "summary.json", "the run must have ended")
    manifest = _facts(folder / MANIFEST, "every run has one")
    with path.open("rb") as stream:
        reader = event_record.Reader(stream, str(path))
        records = reader.records()
        header = next(records, None)
        if not isinstance(header, Header):
            raise ConfigError(f"--run: {path}: holds no record")
        seen = Seen(header, summary, manifest)
        _read_steps(seen, (record for record in records if isinstance(record, Step)))
        if torn := stream.seek(0, os.SEEK_END) - reader.offset:
            words = f"the file is cut off; its last {torn} bytes are not a whole record"
            raise ConfigError(f"--run: {path}: {words}")
    return seen


def record_sha256(folder: Path) -> str:
    """SHA-256 of the event record in a run folder.

    Raises:
        ConfigError: it is no run folder, or the record cannot be read.
    """
    path = _record_of(folder)
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(f"--run: {path}: cannot be read: {error.strerror}") from error


def _record_of(folder: Path) -> Path:
    files = sorted(folder.glob("*.events"))
    if len(files) != 1:
        raise ConfigError(
            f"--run: {folder}: holds {len(files)} event records; allowed: a run of one companion"
        )
    return files[0]


def _facts(path: Path, words: str) -> dict[str, Any]:
    """Content of a JSON file of a run folder; empty if it is no object."""
    try:
        facts = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"--run: {path}: cannot be read; {words}") from error
    return facts if isinstance(facts, dict) else {}


def _read_steps(seen: Seen, steps: Iterator[Step]) -> None:
    landed, state = Landed.UNDEFINED, State.STANDBY.value
    last_s: float | None = None
    tracked_s = -math.inf
    for step in steps:
        gap_s = 0.0 if last_s is None else step.now_s - last_s
        last_s = step.now_s
        seen.steps += 1
        seen.duration_s += gap_s
        seen.worst_gap_s = max(seen.worst_gap_s, gap_s)
        seen.state_s[state] += gap_s
        in_air = landed is Landed.IN_AIR
        seen.in_air_s += gap_s if in_air else 0.0
        seen.together_s += gap_s if in_air and step.now_s - tracked_s <= _LOGGED_S else 0.0
        for event in step.events:
            match event:
                case LandedState():
                    landed = event.landed
                case Heartbeat():
                    seen.armed = seen.armed or event.armed
                case GlobalPosition() if in_air:
                    seen.highest_m = max(seen.highest_m, event.height_above_home_m)
                case VehicleText() if event.text.startswith(_SIMULATED):
                    seen.simulated = event.text
                case InputBehind() if seen.duration_s > _SETTLED_S:
                    seen.behind += 1
                case GateRefused() if event.ends != "nothing":
                    seen.refused.append(event.text)
        for command in step.commands:
            seen.commands += isinstance(command, _COMMANDS)
            match command:
                case Broadcast():
                    seen.broadcasts[command.transport] += 1
                case AuthorityChanged():
                    state = command.state
                    if command.state == State.FAULT.value:
                        seen.faults.append(command.reason)
                case Decision() if in_air and command.tracks:
                    tracked_s = step.now_s
                    _note_tracks(seen, command)
    seen.down_last = landed is not Landed.IN_AIR


def _note_tracks(seen: Seen, decision: Decision) -> None:
    own = decision.position_ned_m
    away = [math.hypot(t.position_ned_m[0] - own[0], t.position_ned_m[1] - own[1]) for t in decision.tracks]
    seen.nearest_m = min(seen.nearest_m, *away)


def checks_of(stage: Stage, seen: Seen, config: Config) -> list[Check]:
    """All checks of a stage on one run."""
    checks = [*_of_any_run(seen, config), *_of_authority(stage, seen)]
    if stage == "bench":
        lasted, armed = seen.duration_s, "armed" if seen.armed else "never armed"
        return [
            *checks,
            _check("duration", f"{lasted:.0f} s", f"{BENCH_S:g} s", lasted >= BENCH_S),
            _check("arming", armed, "never armed", not seen.armed),
        ]
    flown, down = seen.in_air_s, "on the ground" if seen.down_last else "in the air"
    checks += [
        _check("time in the air", f"{flown:.0f} s", f"{IN_AIR_S:g} s", flown >= IN_AIR_S),
        _check("end of the record", down, "on the ground", seen.down_last),
    ]
    if stage == "guard":
        ceiling = config.limits.ceiling_height_m
        needed = f"{CEILING_ROOM_M:g} m above the greatest height ({seen.highest_m:.0f} m)"
        # Without a height in the air, -inf would pass below every ceiling.
        high = (
            ceiling is not None
            and math.isfinite(seen.highest_m)
            and ceiling >= seen.highest_m + CEILING_ROOM_M
        )
        measured = "none" if ceiling is None else f"{ceiling:g} m"
        checks.append(_check("limits.ceiling_height_m", measured, needed, high))
    return checks + (_of_the_pair(seen) if stage == "pair" else [])


def _of_the_pair(seen: Seen) -> list[Check]:
    together, nearest = seen.together_s, seen.nearest_m
    measured = f"{nearest:.1f} m" if nearest < math.inf else "nobody heard in the air"
    needed = f"{LEAST_APART_M:g} to {MET_WITHIN_M:g} m"
    met = LEAST_APART_M <= nearest <= MET_WITHIN_M
    enough = together >= TOGETHER_S
    return [
        _check("another aircraft heard in the air", f"{together:.0f} s", f"{TOGETHER_S:g} s", enough),
        _check("least distance to another aircraft", measured, needed, met),
    ]


def _of_any_run(seen: Seen, config: Config) -> list[Check]:
    s = seen.summary
    same = _without_folder(seen.header.config) == _without_folder(config)
    dropped = s.get("records_dropped"), s.get("recorder_error")
    behind = seen.behind / max(1, seen.steps)
    losses = s.get("link_losses")
    sent = ", ".join(f"{name} {count}" for name, count in sorted(seen.broadcasts.items())) or "nothing"
    law = bool(config.region.transport_sets)
    what, dry = seen.manifest.get("what"), seen.manifest.get("dry_run")
    flown = "a dry run" if dry is True else f"{what!r}" if dry is False else f"{what!r}, perhaps a dry run"
    code = seen.manifest.get("code_sha256")
    return [
        _check("kind of run", flown, "'companion run', no dry run", what == RUN and dry is False),
        _check("vehicle", "not known whether it is simulated" if seen.simulated is None
               else f'simulated: it said "{seen.simulated}"', "anything", True),
        _check("software of the run", seen.header.software, __version__, seen.header.software == __version__),
        _check("code of the run", "the same" if code == code_sha256() else "other code", "the same",
               code == code_sha256()),
        _check("configuration of the run", "the same" if same else "another one", "the same", same),
        _check("record", f"{dropped[0]} dropped, {dropped[1] or 'no error'}", "whole", dropped == (0, None)),
        _check("longest pause of the loop", f"{seen.worst_gap_s:.2f} s", f"up to {_STALL_S:g} s",
               seen.worst_gap_s <= _STALL_S),
        _check("steps with late messages of the vehicle", f"{behind:.1%}", f"up to {_BEHIND_SHARE:.0%}",
               behind <= _BEHIND_SHARE),
        _check("link losses", str(losses), "0", losses == 0),
        _check("commands refused by the gate", "; ".join(seen.refused) or "none", "none", not seen.refused),
        _check("Remote ID asked of the radios", sent, "something" if law else "anything (no region)",
               bool(seen.broadcasts) or not law),
    ]  # fmt: skip


def _without_folder(config: Config) -> Any:
    """A configuration without record.folder, which is another path in the service than for a user who judges
    its runs."""
    record = msgspec.structs.replace(config.record, folder="")
    return msgspec.to_builtins(msgspec.structs.replace(config, record=record))


def _of_authority(stage: Stage, seen: Seen) -> list[Check]:
    use = seen.header.config.flight.use
    wanted = {"bench": ("watch", "guard", "fly"), "watch": ("watch",)}.get(stage, ("guard",))
    checks = [
        _check("flight.use", use, " or ".join(wanted), use in wanted),
        _check("faults", "; ".join(seen.faults) or "none", "none", not seen.faults),
    ]
    if stage in ("bench", "watch"):
        checks.append(_check("commands to the vehicle", str(seen.commands), "0", seen.commands == 0))
    else:
        watched = seen.state_s[State.WATCHING.value]
        checks.append(_check("time guarding the mission", f"{watched:.0f} s", f"{WATCHED_S:g} s",
                             watched >= WATCHED_S))  # fmt: skip
        taken = seen.state_s[State.YIELDED.value]
        checks.append(_check("time after a take-over by the pilot", f"{taken:.0f} s", "0 s", taken == 0.0))
    return checks


def _check(what: str, measured: str, needed: str, passed: bool) -> Check:
    return Check(what=what, measured=measured, needed=needed, passed=passed)
