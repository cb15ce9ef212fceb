"""The record of one flight: its run folder, from the first step of the heart to the summary.

Steps and link bytes from before there is a folder are kept until then.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from companion import __version__
from companion import config as configuration
from companion.config import Config
from companion.errors import ConfigError
from companion.record import Header, Step
from companion.runtime.disk import RUN, DiskFloor
from companion.runtime.policy import RUN_FILE
from companion.runtime.recorder import FlightRecorder, create_run_folder, write_json, write_manifest


class _Tape:
    """What crosses the link, kept until there is a recorder: the first texts to the pilot are in the log."""

    def __init__(self) -> None:
        self._recorder: FlightRecorder | None = None
        self._early: list[bytes] = []

    def write(self, data: bytes) -> None:
        """Take bytes."""
        if self._recorder is None:
            self._early.append(data)
        else:
            self._recorder.write(data)

    def play(self, recorder: FlightRecorder) -> None:
        """Hand on what was kept, and all that comes."""
        self._recorder = recorder
        # In one piece: a long wait on a busy link leaves more frames than the recorder's queue takes.
        recorder.write(b"".join(self._early))
        self._early.clear()


class RunRecord:
    """Takes every step; writes none before `open`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.folder: Path | None = None
        self.tape = _Tape()
        self._say = say
        self._recorder: FlightRecorder | None = None
        self._early: list[Step] = []

    @property
    def error(self) -> str | None:
        """Why nothing is recorded any more."""
        return None if self._recorder is None else self._recorder.error

    @property
    def dropped(self) -> int:
        """Records that were lost."""
        return 0 if self._recorder is None else self._recorder.dropped

    @property
    def deleted(self) -> list[str]:
        """Older runs that had to make room in flight."""
        return [] if self._recorder is None else self._recorder.floor.deleted

    def open(self, config: Config, policy: bytes | None, vehicle: str) -> None:
        """Make the run folder and record from now on, and all that was kept.

        Raises:
            ConfigError: the folder cannot be written.
        """
        utc_s, aircraft = time.time(), config.identity.file_name
        self._make_room(config)
        folder = create_run_folder(Path(config.record.folder), config.record.name, utc_s)
        public = configuration.public(config)
        header = Header(aircraft=aircraft, software=__version__, config=public, policy=policy)
        try:
            if policy is not None:
                (folder / RUN_FILE).write_bytes(policy)
                config = msgspec.structs.replace(
                    config, atmc=msgspec.structs.replace(config.atmc, policy=RUN_FILE)
                )
            (folder / "config.toml").write_bytes(configuration.dump(config))
            write_manifest(folder, RUN, aircraft=[aircraft], started_utc_s=utc_s, vehicle=vehicle)
            self._recorder = FlightRecorder(folder, header, config.record)
        except OSError as error:
            raise ConfigError(f"record.folder: {folder}: cannot be written: {error.strerror}") from error
        self.folder = folder
        # The record begins with the heart's first step, or a replay would not meet the same state.
        for step in self._early:
            self._recorder.step(step)
        self._early.clear()
        self.tape.play(self._recorder)
        self._say(f"vehicle {vehicle}; recording to {folder}")

    def step(self, step: Step) -> None:
        """One step of the heart."""
        if self._recorder is not None:
            self._recorder.step(step)
        else:
            self._early.append(step)

    def close(self, summary: Callable[[], dict[str, object]]) -> None:
        """Write what is left, then the summary.

        Args:
            summary: builds it, of the record as it is then.
        """
        if self._recorder is None or self.folder is None:
            return
        answered = self._recorder.close()
        if self._recorder.error is not None:
            self._say(f"the record is not complete: {self._recorder.error}")
        if answered:
            path = self.folder / "summary.json"
            try:
                write_json(path, summary())
            except OSError as error:
                self._say(f"{path}: cannot be written: {error.strerror}")
        self._say(f"run folder {self.folder}")

    def _make_room(self, config: Config) -> None:
        """On the ground, before the first file: a disk that is full to the last byte takes no folder."""
        floor = DiskFloor(config.record, Path(config.record.folder) / "to come")
        with contextlib.suppress(OSError):  # the recorder will say what is wrong
            floor.trouble()
        if floor.deleted:
            self._say(f"disk: deleted the oldest runs: {', '.join(floor.deleted)}")
