"""`ground-tools inspect RUN --live`: follows the records of flying companions while they are written.

It is a separate process that only reads the files. The companions do not know of it, and no failure of it or
of the viewer can affect the flight. The data shown is as old as the companion's `record.sync_period_s`.
"""

from __future__ import annotations

import itertools
import stat
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TextIO

import numpy as np

from companion import event_record
from companion.arrays import Floats
from companion.errors import ConfigError, PeerDataError
from companion.event_record import Header, Step
from ground_tools.inspect.explain.manoeuvres import Starts
from ground_tools.inspect.read.facts import Facts, Gatherer, gather
from ground_tools.inspect.read.flown import MAX_GAP_S, from_frame, to_ned
from ground_tools.inspect.read.flown import Path as Flight
from ground_tools.inspect.read.read_run import NOT_REGULAR, is_regular
from ground_tools.inspect.viewer.blueprint import blueprint
from ground_tools.inspect.viewer.drawing import rerun
from ground_tools.inspect.viewer.palette import colour
from ground_tools.inspect.viewer.pieces import Note
from ground_tools.inspect.viewer.scene import Aircraft, Scene
from ground_tools.inspect.viewer.web import WebViewer
from ground_tools.inspect.viewer.writer import Writer
from sitl_mocks.signals import end_signals

PERIOD_S = 0.5
"""Period at which the files are read."""
WAIT_S = 60.0
"""How long to wait for the first record in a folder."""
PATIENCE_S = 5.0
"""How long to wait until every aircraft has reported its position and UTC. Then the view starts without the
missing data."""
_CLOSE_S = 2.0
_HEADER, _POSITION, _UTC = "its first record", "a position", "UTC"


class Followed:
    """One aircraft's record, read as it grows."""

    def __init__(self, path: Path) -> None:
        self.name = path.name.removesuffix(".events")
        self.header: Header | None = None
        self._file: BinaryIO = path.open("rb")
        self._reader = event_record.Reader(self._file, path.name)

    def steps(self) -> Iterator[Step]:
        """Yield the steps written since the last call.

        Raises:
            PeerDataError: The file is not an event record of this format version, or is damaged.
        """
        for entry in self._reader.records():
            if isinstance(entry, Header):
                self.header = entry
            else:
                yield entry

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Bridge:
    """Writes growing records into a stream, from their beginning.

    Args:
        files: Event records.
        stream: A rerun recording stream.

    Raises:
        ConfigError: None of the files can be opened.
    """

    def __init__(self, files: Iterable[Path], stream: Any) -> None:
        self._stream = stream
        self._followed: dict[str, Followed] = {}
        self.problems: list[str] = []
        """Why records are not followed, or are no longer followed, one line each."""
        self.outgrown = False
        """True if the bridge started without data that has arrived since. A new bridge would show more."""
        for file in files:
            try:
                one = Followed(file)
            except OSError as error:
                self.problems.append(f"{file.name}: cannot be read: {error.strerror}")
            else:
                self._followed[one.name] = one
        if not self._followed:
            raise ConfigError("; ".join(self.problems))
        self._early: dict[str, list[Step]] = {name: [] for name in self._followed}
        """Steps, by aircraft, that arrived before the scene could be made."""
        self._known = {name: Gatherer() for name in self._followed}
        """Facts, by aircraft, known before the scene is made."""
        self._lacking: dict[str, set[str]] = {}
        """Data, by aircraft, that was missing when the scene was made."""
        self._last: dict[str, Floats] = {}
        """Last position of each aircraft, at which the next part of its path begins."""
        self._begins: dict[str, Starts] = {}
        self._scene: Scene | None = None
        self._writer: Writer | None = None

    @property
    def waits_for(self) -> tuple[str, ...]:
        """Missing data that is waited for, a line for each aircraft; empty once the view has started."""
        return _in_words(self._lacks()) if self._writer is None else ()

    @property
    def without(self) -> tuple[str, ...]:
        """Data without which the view started, a line for each aircraft."""
        return () if self._writer is None else _in_words(self._lacking)

    def look(self, *, complete: bool = True) -> int:
        """Send new steps. Returns their number.

        Args:
            complete: Start only when every aircraft has reported its position and UTC.

        Raises:
            PeerDataError: No record is undamaged and of this format version.
        """
        if self._writer is None:
            for name in list(self._early):
                for step in self._new(name):
                    self._early[name].append(step)
                    self._known[name].step(step)
                if name not in self._followed and not self._early[name]:
                    del self._early[name], self._known[name]
            if not self._early:
                raise PeerDataError("; ".join(self.problems))
            self._lacking = self._lacks()
            if any(self._lacking.values()) and (complete or not any(self._early.values())):
                return 0
            self._scene = self._made()
            placed = any(len(one.fixes) for one in self._known.values())
            self._stream.send_blueprint(blueprint(self._scene, (), None, live=True, placed=placed))
            self._writer = Writer(self._stream, self._scene)
            if placed:
                for lacks in self._lacking.values():
                    lacks.discard(_POSITION)
            count = sum(self._send(name, steps) for name, steps in self._early.items())
            self._early.clear()
            return count
        return sum(self._send(name, self._new(name)) for name in list(self._followed))

    def _new(self, name: str) -> Iterator[Step]:
        """Yield the new steps of an aircraft. A damaged record is not followed any further."""
        one = self._followed.get(name)
        if one is None:
            return
        try:
            yield from one.steps()
        except PeerDataError as error:
            self.problems.append(
                str(error) if one.header is None else f"{error}; the run is shown up to there"
            )
            self._followed.pop(name).close()

    def _lacks(self) -> dict[str, set[str]]:
        """Return, by aircraft, the data that the scene needs and that is missing."""
        alone = len(self._known) == 1
        found = {}
        for name, one in self._known.items():
            lacks = {_POSITION: not one.fixes, _UTC: not alone and not one.utc}
            lacks[_HEADER] = name in self._followed and self._followed[name].header is None
            found[name] = {what for what, it_does in lacks.items() if it_does}
        return found

    def _made(self) -> Scene:
        """Make the scene from what is known.

        If UTC of any aircraft is unknown, all clocks are assumed to be the same. Without any position the
        frame has no meaning.
        """
        facts: dict[str, Facts] = {name: one.facts() for name, one in self._known.items()}
        granted = len(facts) == 1 or any(one.utc_offset_s is None for one in facts.values())
        to_utc = {name: 0.0 if granted else (one.utc_offset_s or 0.0) for name, one in facts.items()}
        zero = 0.0 if granted else min(one.start_s + to_utc[name] for name, one in facts.items())
        first = next((one.fixes[0, 1:4].tolist() for one in facts.values() if len(one.fixes)), (0.0,) * 3)
        headers = {name: one.header for name, one in self._followed.items()}
        aircraft = tuple(
            Aircraft(
                name,
                colour(index),
                to_utc[name] - zero,
                header.config if (header := headers.get(name)) else None,
                facts[name].undulation_m,
            )
            for index, name in enumerate(facts)
        )
        return Scene((first[0], first[1], first[2]), aircraft)

    def _send(self, name: str, steps: Iterable[Step]) -> int:
        assert self._scene is not None
        assert self._writer is not None
        scene, count = self._scene, 0
        offset = next(one.offset_s for one in scene.aircraft if one.name == name)

        def piece(step: Step) -> tuple[int, bool]:
            return scene.piece(step.now_s + offset)

        for _, part in itertools.groupby(steps, key=piece):
            found = list(part)
            count += len(found)
            self._writer.steps(name, found)
            self._starts(name, found, offset)
            self._writer.settle(found[-1].now_s + offset)
            facts = gather(found)
            self._path(name, facts.fixes, offset)
            told = {_HEADER} | ({_POSITION} if len(facts.fixes) else set())
            told |= set() if facts.utc_offset_s is None else {_UTC}
            self.outgrown |= not told.isdisjoint(self._lacking[name])
        return count

    def _starts(self, name: str, steps: Iterable[Step], offset_s: float) -> None:
        """Write a note and a marker where a manoeuvre begins."""
        assert self._scene is not None
        assert self._writer is not None
        config = next(one.config for one in self._scene.aircraft if one.name == name)
        if config is None:
            return
        starts = self._begins.setdefault(name, Starts(config))
        for step in steps:
            begun = starts.step(step)
            if begun is not None:
                words, decision = begun
                where = from_frame(np.array([decision.position_ned_m]), decision.origin, self._scene.origin)
                note = Note(step.now_s + offset_s, "WARN", f"manoeuvre begins: {words}", True)
                self._writer.tell(name, note, where[0])

    def _path(self, name: str, fixes: Floats, offset_s: float) -> None:
        assert self._scene is not None
        assert self._writer is not None
        if not len(fixes):
            return
        joined = np.vstack([self._last.get(name, fixes[:0]), fixes])
        self._last[name] = joined[-1:]
        ned = to_ned(joined[:, 1:4], self._scene.origin)
        self._writer.flown(Flight(name, joined[:, 0] + offset_s, ned, 0.0), joined[:, 1:3], MAX_GAP_S)

    def close(self) -> None:
        """Close the files and send the rest, without waiting for a viewer that hangs."""
        for one in self._followed.values():
            one.close()
        # Disconnect before the viewer ends, because Rerun complains if the viewer ends first. Use a thread,
        # because disconnecting would wait forever for a viewer that hangs.
        ending = threading.Thread(target=self._stream.disconnect, daemon=True)
        ending.start()
        ending.join(_CLOSE_S)


def _in_words(lacking: dict[str, set[str]]) -> tuple[str, ...]:
    return tuple(f"{name}: {' and '.join(sorted(lacks))}" for name, lacks in lacking.items() if lacks)


def follow(path: Path) -> int:
    """Show a run while it is flown, until Ctrl-C or SIGTERM.

    Args:
        path: A run folder, a folder of run folders (a swarm), or one event record.

    Returns:
        0, or 2 if a record could not be read, or not to its end.

    Raises:
        ConfigError: No record is written there, rerun is not installed, or its viewer ended by itself.
        PeerDataError: No record is undamaged and of this format version.
    """
    rr = rerun()
    with end_signals() as ended:
        files, odd = _records(path, ended)
        if not files:
            return 0
        told: set[str] = set()
        _tell(odd, told, sys.stderr)
        with WebViewer() as viewer:
            bridge = _begun(rr, viewer, path, files)
            give_up_s = time.monotonic() + PATIENCE_S
            try:
                bridge.look()
                names = ", ".join(file.name.removesuffix(".events") for file in files)
                print(f"showing {names} live at {viewer.url}, on this machine only, until Ctrl-C", flush=True)
                while not ended:
                    viewer.check()
                    waits = bridge.waits_for
                    bridge.look(complete=time.monotonic() < give_up_s)
                    _tell(_waiting(waits, bridge), told, sys.stdout)
                    _tell(bridge.problems, told, sys.stderr)
                    if bridge.outgrown:
                        bridge.close()
                        bridge = _begun(rr, viewer, path, files)
                    time.sleep(PERIOD_S)
            finally:
                bridge.close()
        return 2 if odd or bridge.problems else 0


def _begun(rr: Any, viewer: WebViewer, path: Path, files: Iterable[Path]) -> Bridge:
    """Return a bridge to a new recording. The viewer switches to the newest recording."""
    stream = rr.RecordingStream("dmuca", recording_id=f"live {path.resolve().name} {time.monotonic_ns()}")
    stream.connect_grpc(viewer.data_url)
    return Bridge(files, stream)


def _waiting(waits: tuple[str, ...], bridge: Bridge) -> list[str]:
    """Return messages on what is waited for or, once the view has started, on what it started without.

    Args:
        waits: What the bridge was waiting for before its last look.
        bridge: The bridge.
    """
    if bridge.waits_for:
        return [f"waiting for {words}" for words in bridge.waits_for]
    return [f"shown without {words} until it arrives" for words in bridge.without] if waits else []


def _tell(lines: Iterable[str], told: set[str], stream: TextIO) -> None:
    """Print the lines that were not printed before."""
    for words in lines:
        if words not in told:
            told.add(words)
            print(words, file=stream, flush=True)


def _records(path: Path, ended: list[int]) -> tuple[list[Path], list[str]]:
    """Wait for the event records of a folder, or of the folders in it (a swarm).

    Returns:
        The records, and the reasons why other files named *.events cannot be read. Both are empty if the
        program is asked to end first.
    """
    try:
        if not stat.S_ISDIR(path.stat().st_mode):
            if not is_regular(path):
                raise ConfigError(f"{path}: {NOT_REGULAR}")
            return [path], []
        next(path.iterdir(), None)
    except FileNotFoundError:
        raise ConfigError(f"{path}: this run folder does not exist") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    give_up_s, told = time.monotonic() + WAIT_S, set[str]()
    while not ended:
        odd = []
        files = []
        for file in sorted(path.glob("*.events")) or sorted(path.glob("*/*.events")):
            try:
                size = file.stat().st_size
            except OSError as error:
                odd.append(f"{file.name}: cannot be read: {error.strerror}")
                continue
            if not is_regular(file):
                odd.append(f"{file.name}: {NOT_REGULAR}")
            elif size >= len(event_record.MAGIC):
                files.append(file)
            else:
                break
        else:
            if files:
                return files, odd
        if time.monotonic() > give_up_s:
            raise ConfigError(f"{path}: {'; '.join(odd) or 'the folder has no event record (*.events)'}")
        _tell([f"waiting up to {WAIT_S:g} s for an event record (*.events) in {path}"], told, sys.stdout)
        time.sleep(PERIOD_S)
    return [], []
