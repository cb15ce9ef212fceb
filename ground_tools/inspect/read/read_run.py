"""Reads what was recorded: a run folder, one event record, or the log (.tlog, .bin, .ulg) of any vehicle.

A run folder contains `manifest.json`, an optional `summary.json`, and the event record of every aircraft. A
run that was killed is read as far as it was written. If an aircraft's event record is missing or unreadable,
its .tlog is read instead. `Run.problems` lists what could not be read; everything else is still returned.

A subfolder `unavoided` holds the same encounter flown without avoidance. In the run folder of a swarm, each
companion has a run folder of its own; these are read as one run.
"""

from __future__ import annotations

import functools
import glob
import json
import os
import re
import stat
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from companion import event_record
from companion.arrays import Floats
from companion.errors import ConfigError, PeerDataError
from companion.event_record import Header, Step
from ground_tools.inspect.read import read_onboard, read_tlog
from ground_tools.inspect.read.facts import Facts, gather
from ground_tools.inspect.read.link_health import LinkHealth
from ground_tools.inspect.read.truth import read_truth

_OTHER_KINDS = {
    b"FMT,": "an ArduPilot dataflash log that was converted to text (use the .bin itself)",
    b"\x89PNG": "a picture",
    b"\x1f\x8b": "a compressed file (unpack it first)",
    b"RRF2": "a Rerun recording (open it with rerun)",
    b"PK": "an archive (unpack it first)",
}
"""First bytes of other file types that users often keep next to their logs, with the text for the error."""
_ALLOWED = "a run folder, an event record (.events), a log (.tlog, ArduPilot's .bin, PX4's .ulg)"
_OTHER_KIND = re.compile("not a telemetry log|no DataFlash log|no ULog file")
_RECORDS = (".events", ".tlog", *read_onboard.SUFFIXES)
_MOST_NAMED = 5
"""Most runs that an error message lists for a folder that contains runs."""
TELLING_S = 0.05
"""If the log's clock differs from the vehicle's UTC by more than this, a note reports it."""
STAMPED = "no vehicle sent UTC (SYSTEM_TIME); times are the log's own time stamps, by the clock of its writer"
NOT_REGULAR = "this is not a regular file but a folder, a FIFO or a device"


@dataclass(frozen=True, slots=True)
class AircraftRecord:
    """What one aircraft recorded: the inputs and outputs of its companion's core, or its telemetry."""

    name: str
    header: Header | None
    """None for a telemetry log, and for an event record that was cut off before its header."""
    facts: Facts
    steps: Callable[[], Iterator[Step]]
    """Yields every step in order. Each call reads the file again, because a long record does not fit into
    memory. The iteration ends at damage, as it did when `facts` were gathered."""
    truth: Floats | None = None
    """True positions, (n, 4) of utc_s, north_m, east_m, down_m; None if they are not known."""
    log: Literal["", "telemetry", "onboard"] = ""
    """The kind of log that it was read from; empty for an event record. `now_s` of a telemetry log is its
    UTC, that of an onboard log the vehicle's time since it started."""
    stamped: bool = False
    """True for a telemetry log in which no vehicle sent UTC. Then the UTC of its timestamps is unverified."""
    wind: Floats | None = None
    """(n, 3) time, and the wind towards north and east (m/s), by the autopilot; None if it is not known."""
    link_of: Callable[[], LinkHealth | None] = lambda: None

    @property
    def link(self) -> LinkHealth | None:
        """Quality of the autopilot's telemetry link.

        It is read on first access from the .tlog next to the event record. None if there is no .tlog, or if
        its times cannot be converted to this record's time.
        """
        return self.link_of()


@dataclass(frozen=True, slots=True)
class Run:
    """One run, read from a folder or a log, or several runs merged."""

    folder: Path
    """The folder or file that was read."""
    manifest: dict[str, Any] | None
    """Content of manifest.json; None if it is missing or unreadable."""
    summary: dict[str, Any] | None
    """Content of summary.json; None if it is missing or unreadable."""
    aircraft: tuple[AircraftRecord, ...]
    problems: tuple[str, ...]
    """What is damaged or missing, one line each."""
    notes: tuple[str, ...] = ()
    """What the input is and what it does not contain, one line each. None of these is an error."""
    others: int = 0
    """Number of further runs merged with the one in `folder`."""

    @property
    def name(self) -> str:
        """Name of the folder or file; merged runs add the number of the others."""
        path = self.folder.resolve()
        name = path.name if path.is_dir() else path.stem
        return f"{name} and {self.others} more" if self.others else name

    @property
    def recording(self) -> Path:
        """Default path of the run's Rerun recording."""
        if self.others:
            return (self.folder if self.folder.is_dir() else self.folder.parent) / "together.rrd"
        return self.folder / "inspect.rrd" if self.folder.is_dir() else self.folder.with_suffix(".rrd")


def is_regular(path: Path) -> bool:
    """Return whether a path is a regular file, which can be read more than once.

    Opening a FIFO would block until a writer comes. Also true if the path cannot be examined; opening it then
    raises an error that gives the reason.
    """
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except OSError:
        return True


def read_unavoided(folder: Path) -> Run | None:
    """Read the run without avoidance inside a run folder; None if there is none."""
    inner = folder / "unavoided"
    return read_run(inner) if inner.is_dir() else None


def read_run(path: Path) -> Run:
    """Read a run folder, an event record or a vehicle's log.

    Raises:
        ConfigError: The file or folder does not exist, or no flight data could be read from it.
    """
    try:
        if not stat.S_ISDIR(path.stat().st_mode):
            return _file(path)
        # glob() would silently skip a folder without read permission.
        os.scandir(path).close()
    except FileNotFoundError:
        raise ConfigError(f"{path}: this run folder or file does not exist") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    problems: list[str] = []
    notes: list[str] = []
    manifest, manifest_problem = read_json(path / "manifest.json")
    summary, summary_problem = read_json(path / "summary.json")
    problems += [problem for problem in (manifest_problem, summary_problem) if problem is not None]
    aircraft: list[AircraftRecord] = []
    for events, tlog in _flights(path, manifest, problems):
        aircraft += _flight(events, tlog, path, problems, notes)
    if not aircraft:
        aircraft = _onboard_logs(path, problems, notes)
    if not aircraft:
        found = "; ".join(problems) or _other_runs(path)
        raise ConfigError(f"{path}: {found}")
    return Run(path, manifest, summary, tuple(aircraft), tuple(problems), tuple(notes))


def _other_runs(folder: Path) -> str:
    """Error text for a folder without a record. If it contains runs, the text lists the newest."""
    nothing = "the folder has no event record (*.events) and no log (*.tlog, *.bin, *.ulg)"
    inside = {path.parent for path in folder.glob("*/*") if path.suffix.lower() in _RECORDS}
    if not inside:
        return nothing
    newest = sorted(inside, key=lambda path: path.name, reverse=True)
    named = ", ".join(str(path) for path in newest[:_MOST_NAMED])
    if len(inside) == 1:
        return f"{nothing}, but it contains a run; give its path: {named}"
    return f"{nothing}, but it contains {len(inside)} runs; give the path of one; the newest: {named}"


def _file(path: Path) -> Run:
    """Read a run that consists of one file."""
    problems: list[str] = []
    notes: list[str] = []
    if not is_regular(path):
        raise ConfigError(f"{path}: {NOT_REGULAR}")
    with path.open("rb") as stream:
        head = stream.read(8)
    for magic, kind in _OTHER_KINDS.items():
        if head.startswith(magic):
            raise ConfigError(f"{path}: this is {kind}; allowed: {_ALLOWED}")
    reader = read_onboard.reader_of(head)
    if reader is not None:
        aircraft = _onboard(path, reader, problems, notes)
    elif head.startswith(event_record.MAGIC[:-1]):
        aircraft = _flight(path, _beside(path), path.parent, problems, notes)
    else:
        aircraft = _flight(None, path, path.parent, problems, notes)
    if not aircraft:
        words = problems[0] if problems else f"{path.name}: the file has no content"
        allowed = f"; allowed: {_ALLOWED}" if _OTHER_KIND.search(words) else ""
        raise ConfigError(f"{path.parent / words}{allowed}")
    return Run(path, None, None, tuple(aircraft), tuple(problems), tuple(notes))


def _beside(events: Path) -> Path | None:
    tlog = events.with_suffix(".tlog")
    return tlog if tlog.is_file() else None


def _flights(
    folder: Path, manifest: dict[str, Any] | None, problems: list[str]
) -> list[tuple[Path | None, Path | None]]:
    """Return the event record and the telemetry log of every aircraft; at least one of the two exists."""
    events = {path.stem: path for path in _regular(folder.glob("*.events"), problems)}
    tlogs = {path.stem: path for path in _regular(folder.glob("*.tlog"), problems)}
    if manifest is not None:
        problems += [
            f"{name}: the event record is missing; the telemetry log is shown instead"
            for name in sorted({*tlogs} - {*events})
        ]
    if events or tlogs:
        return [(events.get(name), tlogs.get(name)) for name in sorted({*events, *tlogs})]
    return _nested(folder, manifest, problems)


def _regular(paths: Iterable[Path], problems: list[str]) -> list[Path]:
    found = sorted(paths)
    problems += [f"{path.name}: {NOT_REGULAR}" for path in found if not is_regular(path)]
    return [path for path in found if is_regular(path)]


def _nested(
    folder: Path, manifest: dict[str, Any] | None, problems: list[str]
) -> list[tuple[Path | None, Path | None]]:
    """As `_flights`, for a swarm: search `<utc>-<name>/` for every aircraft in the manifest."""
    names = (manifest or {}).get("aircraft")
    found: list[tuple[Path | None, Path | None]] = []
    for name in names if isinstance(names, list) else []:
        # The names of run folders begin with the time, so the last one is the latest.
        inside = f"*-{glob.escape(str(name))}/{glob.escape(str(name))}"
        events = _regular(folder.glob(f"{inside}.events"), problems)
        tlogs = _regular(folder.glob(f"{inside}.tlog"), problems)
        if not events:
            problems.append(f"{name}: the event record is missing")
        elif len(events) > 1:
            problems.append(f"{name}: there are {len(events)} event records; the last one is shown")
        if events or tlogs:
            found.append((events[-1], _beside(events[-1])) if events else (None, tlogs[-1]))
    return found


def read_json(path: Path) -> tuple[dict[str, Any] | None, str | None]:
    """Return the JSON object in a file and None, or None and the error; None twice if there is no file."""
    if not is_regular(path):
        return None, f"{path.name}: {NOT_REGULAR}"
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None, None
    except OSError as error:
        return None, f"{path.name}: cannot be read: {error.strerror}"
    except (ValueError, RecursionError) as error:
        return None, f"{path.name}: {error}"
    if not isinstance(value, dict):
        return None, f"{path.name}: this is not a JSON object"
    return value, None


def _flight(
    events: Path | None, tlog: Path | None, folder: Path, problems: list[str], notes: list[str]
) -> list[AircraftRecord]:
    """Read aircraft from the event record or, if that has no steps, from the telemetry log.

    True positions are read from `folder`.
    """
    if events is not None:
        one = _aircraft(events, tlog, folder, problems)
        if one.facts.steps or (tlog is None and one.header is not None):
            return [one]
    if tlog is None:
        return []
    try:
        log = read_tlog.read(tlog)
    except PeerDataError as error:
        problems.append(str(error))
        return []
    except OSError as error:
        problems.append(f"{tlog.name}: cannot be read: {error.strerror}")
        return []
    problems += log.problems
    if events is not None:
        problems.append(f"{events.name}: no step can be read; the telemetry log is shown instead")
    if not log.vehicles:
        problems.append(
            f"{tlog.name}: there is no vehicle; {log.counts.records} records have no autopilot's HEARTBEAT"
        )
    return _logged(log, tlog, folder, problems, notes)


def _logged(
    log: read_tlog.Tlog, tlog: Path, folder: Path, problems: list[str], notes: list[str]
) -> list[AircraftRecord]:
    """The vehicles of a telemetry log."""
    found = []
    for vehicle in log.vehicles:
        name = tlog.stem if len(log.vehicles) == 1 else f"{tlog.stem} {vehicle.system_id}"
        notes.append(f"{name}: system {vehicle.system_id}: {vehicle.about}")
        notes.append(f"{name}: the log does not contain {', '.join(vehicle.missing)}")
        if abs(vehicle.facts.utc_offset_s or 0.0) > TELLING_S:
            notes.append(
                f"{name}: the log's clock was {_off(vehicle.facts)} the vehicle's UTC; the latter is used"
            )
        found.append(
            AircraftRecord(
                name,
                None,
                vehicle.facts,
                vehicle.steps,
                truth=_truth(folder, name, problems),
                log="telemetry",
                stamped=not log.tells_utc,
                link_of=functools.partial(_given, vehicle.link),
            )
        )
    if found and not log.tells_utc:
        notes.append(f"{tlog.name}: {STAMPED}")
    return found


def _onboard_logs(folder: Path, problems: list[str], notes: list[str]) -> list[AircraftRecord]:
    """The aircraft of the onboard logs in a folder. Of several logs, those without UTC are left out, because
    they cannot be aligned."""
    found: list[AircraftRecord] = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in read_onboard.SUFFIXES or not path.is_file():
            continue
        try:
            with path.open("rb") as stream:
                head = stream.read(8)
        except OSError as error:
            problems.append(f"{path.name}: cannot be read: {error.strerror}")
            continue
        reader = read_onboard.reader_of(head)
        if reader is not None:
            found += _onboard(path, reader, problems, notes)
        elif path.suffix.lower() != ".bin":  # names of other files may also end in .bin
            begins = f"begins with {head.hex(' ')}" if head else "is empty"
            problems.append(f"{path.name}: no ULog file: it {begins}")
    if len(found) > 1:
        problems += [
            f"{one.name}: the log is left out, because it has no UTC and so cannot be aligned with the others"
            for one in found
            if one.facts.utc_offset_s is None
        ]
        found = [one for one in found if one.facts.utc_offset_s is not None]
    return found


def _onboard(
    path: Path, reader: read_onboard.ReadSteps, problems: list[str], notes: list[str]
) -> list[AircraftRecord]:
    """The aircraft of an onboard log, in a list; an empty list if the log cannot be read."""
    try:
        log = read_onboard.read(path, reader)
    except PeerDataError as error:
        problems.append(str(error))
        return []
    except OSError as error:
        problems.append(f"{path.name}: cannot be read: {error.strerror}")
        return []
    if not log.facts.steps:
        problems.append(f"{path.name}: the log has no message that can be shown")
    problems += log.about.damage(path.name)
    if not log.facts.steps:
        return []
    # Autopilots name their logs by number or time. The system id is a better name for the aircraft.
    name = path.stem if re.search("[A-Za-z]", path.stem) else f"system {log.about.system_id}"
    notes.append(f"{name}: {path.name}: {log.words}")
    notes.append(f"{name}: the log does not contain {', '.join(log.about.missing())}")
    if log.facts.utc_offset_s is None:
        notes.append(f"{name}: the log has no UTC; times count from the vehicle's start")
    truth = _truth(path.parent, path.stem, problems)
    return [AircraftRecord(name, None, log.facts, log.steps, truth, "onboard", wind=log.wind)]


def _off(facts: Facts) -> str:
    offset = facts.utc_offset_s or 0.0
    return f"{abs(offset):.2f} s {'behind' if offset > 0.0 else 'ahead of'}"


def _given(link: LinkHealth) -> LinkHealth:
    return link


def _aircraft(path: Path, tlog: Path | None, folder: Path, problems: list[str]) -> AircraftRecord:
    name = path.name.removesuffix(".events")
    headers: list[Header] = []
    before = len(problems)
    facts = gather(_steps(path, headers, problems))
    if not headers and len(problems) == before:
        problems.append(f"{path.name}: the header is missing")

    def steps() -> Iterator[Step]:
        return _steps(path, [], [])

    @functools.cache
    def link() -> LinkHealth | None:
        if tlog is None or facts.utc_offset_s is None:
            return None
        # A companion stamps its telemetry log with the vehicle's UTC.
        return read_tlog.read_health(tlog).moved(-facts.utc_offset_s)

    header = headers[0] if headers else None
    return AircraftRecord(name, header, facts, steps, _truth(folder, name, problems), link_of=link)


def _truth(folder: Path, name: str, problems: list[str]) -> Floats | None:
    path = folder / f"{name}.truth.csv"
    if not is_regular(path):
        problems.append(f"{path.name}: {NOT_REGULAR}")
        return None
    try:
        return read_truth(path)
    except PeerDataError as error:
        problems.append(str(error))
        return None


def _steps(path: Path, headers: list[Header], problems: list[str]) -> Iterator[Step]:
    """Yield the steps of a file; append its headers to `headers` and any damage to `problems`."""
    try:
        with path.open("rb") as stream:
            reader = event_record.Reader(stream, path.name)
            for entry in reader.records():
                if isinstance(entry, Header):
                    headers.append(entry)
                else:
                    yield entry
            if headers and (torn := stream.seek(0, os.SEEK_END) - reader.offset):
                problems.append(
                    f"{path.name}: the file is cut off; its last {torn} bytes are not a whole record"
                )
    except PeerDataError as error:
        problems.append(f"{error}; the file was read up to there" if headers else str(error))
    except OSError as error:
        problems.append(f"{path.name}: cannot be read: {error.strerror}")
