"""`ground-tools inspect RUN --live`: the records of flying companions, followed while they are written.

A process of its own that only reads the files: a companion does not know of it, and nothing that happens to
it or to the viewer can reach the flight. What is seen is as old as the companion's `record.sync_period_s`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from companion import record
from companion.errors import ConfigError
from companion.record import Header, Step
from ground_tools.inspect.blueprint import blueprint
from ground_tools.inspect.facts import Array, gather
from ground_tools.inspect.flown import Path as Flight
from ground_tools.inspect.flown import to_ned
from ground_tools.inspect.palette import colour
from ground_tools.inspect.scene import Aircraft, Scene
from ground_tools.inspect.web import WebViewer
from ground_tools.inspect.writer import Writer, rerun
from sitl_mocks.signals import end_signals

PERIOD_S = 0.5
"""Between two looks at the files."""
WAIT_S = 60.0
"""For the first record of a folder."""


class Followed:
    """One aircraft's record, read as it grows."""

    def __init__(self, path: Path) -> None:
        self.name = path.name.removesuffix(".events")
        self.header: Header | None = None
        self._file: BinaryIO = path.open("rb")
        self._reader = record.Reader(self._file, path.name)

    def steps(self) -> Iterator[Step]:
        """What was written since the last call.

        Raises:
            PeerDataError: the file is no event record of this version, or is damaged.
        """
        for entry in self._reader.records():
            if isinstance(entry, Header):
                self.header = entry
            else:
                yield entry

    def close(self) -> None:
        """Read no more."""
        self._file.close()


class Bridge:
    """Puts records into a stream, from their beginning to wherever they have grown.

    Args:
        files: event records.
        stream: a rerun recording stream.
    """

    def __init__(self, files: Iterable[Path], stream: Any) -> None:
        self._stream = stream
        self._followed = {one.name: one for one in map(Followed, files)}
        self._early: dict[str, list[Step]] = {name: [] for name in self._followed}
        """What came before the scene could be made."""
        self._last: dict[str, Array] = {}
        """By aircraft: its last position, where the next part of its path begins."""
        self._scene: Scene | None = None
        self._writer: Writer | None = None

    def look(self) -> int:
        """Send what is new. Returns how many steps that were.

        Raises:
            PeerDataError: a record is damaged, or of another version.
        """
        if self._writer is None:
            for name, one in self._followed.items():
                self._early[name] += one.steps()
            self._scene = self._made()
            if self._scene is None:
                return 0
            self._stream.send_blueprint(blueprint(self._scene, (), None, live=True))
            self._writer = Writer(self._stream, self._scene)
            count = sum(self._send(name, steps) for name, steps in self._early.items())
            self._early.clear()
            return count
        return sum(self._send(name, one.steps()) for name, one in self._followed.items())

    def _made(self) -> Scene | None:
        """The scene, once every aircraft has told where it is and what time it has."""
        facts = {name: gather(steps) for name, steps in self._early.items()}
        alone = len(facts) == 1
        if not all(len(one.fixes) and (alone or one.utc_offset_s is not None) for one in facts.values()):
            return None
        to_utc = {name: 0.0 if alone else (one.utc_offset_s or 0.0) for name, one in facts.items()}
        zero = 0.0 if alone else min(one.start_s + to_utc[name] for name, one in facts.items())
        lat, lon, alt = next(iter(facts.values())).fixes[0, 1:4].tolist()
        aircraft = tuple(
            Aircraft(
                name,
                colour(index),
                to_utc[name] - zero,
                one.header.config if one.header else None,
                facts[name].undulation_m,
            )
            for index, (name, one) in enumerate(self._followed.items())
        )
        return Scene((lat, lon, alt), aircraft)

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
            self._writer.settle(found[-1].now_s + offset)
            self._path(name, found, offset)
        return count

    def _path(self, name: str, steps: list[Step], offset_s: float) -> None:
        assert self._scene is not None
        assert self._writer is not None
        fixes = gather(steps).fixes
        if not len(fixes):
            return
        joined = np.vstack([self._last.get(name, fixes[:0]), fixes])
        self._last[name] = joined[-1:]
        ned = to_ned(joined[:, 1:4], self._scene.origin)
        self._writer.flown(Flight(name, joined[:, 0] + offset_s, ned, 0.0), joined[:, 1:3])

    def close(self) -> None:
        """Read no more."""
        for one in self._followed.values():
            one.close()


def follow(folder: Path) -> None:
    """Show a run while it is flown, until Ctrl-C or SIGTERM.

    Raises:
        ConfigError: no record is written there, rerun is not installed, or its viewer ended by itself.
        PeerDataError: a record is damaged, or of another version.
    """
    rr = rerun()
    with end_signals() as ended:
        files = _records(folder, ended)
        if not files:
            return
        with WebViewer() as viewer:
            stream = rr.RecordingStream("dmuca", recording_id=f"live {folder.resolve().name}")
            stream.connect_grpc(viewer.data_url)
            bridge = Bridge(files, stream)
            names = ", ".join(file.name.removesuffix(".events") for file in files)
            print(f"{names} live at {viewer.url}; on this machine only, until Ctrl-C", flush=True)
            try:
                while not ended:
                    viewer.check()
                    bridge.look()
                    time.sleep(PERIOD_S)
            finally:
                bridge.close()


def _records(folder: Path, ended: list[int]) -> list[Path]:
    """The records of the folder, or of the folders in it (a swarm); empty when it ended first."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such run folder")
    give_up_s = time.monotonic() + WAIT_S
    while not ended:
        files = sorted(folder.glob("*.events")) or sorted(folder.glob("*/*.events"))
        if files and all(file.stat().st_size >= len(record.MAGIC) for file in files):
            return files
        if time.monotonic() > give_up_s:
            raise ConfigError(f"{folder}: no event record (*.events) is written there")
        time.sleep(PERIOD_S)
    return []
