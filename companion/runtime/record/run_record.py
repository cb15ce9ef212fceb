"""The record of one flight: its run folder, from the first step of the heart to the summary.

Steps and link bytes from before there is a folder are kept until then. A record folder that cannot be written
ends no flight and keeps none from beginning: after a restart in the air the aircraft must be heard and must
avoid others, with a record or without.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from companion import __version__
from companion import config as configuration
from companion.config import Config
from companion.event_record import Header, Step
from companion.runtime.policy import RUN_FILE
from companion.runtime.record.disk import RUN, DiskFloor, replace_file
from companion.runtime.record.recorder import (
    CLOSE_S,
    FlightRecorder,
    create_run_folder,
    write_json,
    write_manifest,
)


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

    def early(self) -> bytes:
        """What was kept; it is kept no longer."""
        data = b"".join(self._early)
        self._early.clear()
        return data

    def play(self, recorder: FlightRecorder) -> None:
        """Hand on all that comes."""
        self._recorder = recorder


class RunRecord:
    """Takes every step; writes none before `open`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.tape = _Tape()
        self._say = say
        self._recorder: FlightRecorder | None = None
        self._early: list[Step] = []
        self._made_room: list[str] = []
        self._announced = False

    @property
    def folder(self) -> Path | None:
        """Of the run; None before it is made."""
        return None if self._recorder is None else self._recorder.folder

    @property
    def error(self) -> str | None:
        """Why nothing is recorded, for the rest of this flight."""
        return None if self._recorder is None else self._recorder.error

    def slow(self, now_s: float) -> str | None:
        """What is wrong with a disk that takes the record all the same; None where nothing is."""
        return None if self._recorder is None else self._recorder.slow(now_s)

    @property
    def dropped(self) -> int:
        """Records that were lost."""
        return 0 if self._recorder is None else self._recorder.dropped

    @property
    def deleted(self) -> list[str]:
        """Older runs that had to make room in flight."""
        return [] if self._recorder is None else self._recorder.deleted

    def open(self, config: Config, policy: bytes | None, vehicle: str) -> None:
        """Make the run folder and record from now on, and all that was kept. Waits for no disk: whether there
        is a folder is said with a later step, and what is wrong with it is told by `error`."""
        utc_s = time.time()
        header = Header(
            aircraft=config.identity.file_name,
            software=__version__,
            config=configuration.public(config),
            policy=policy,
        )

        def make() -> Path:
            self._make_room(config)
            folder = create_run_folder(Path(config.record.folder), config.record.name, utc_s)
            _write_configuration(folder, config, policy)
            write_manifest(folder, RUN, aircraft=[header.aircraft], started_utc_s=utc_s, vehicle=vehicle)
            return folder

        # The record begins with the heart's first step, or a replay would not meet the same state.
        early, self._early = self._early, []
        self._recorder = FlightRecorder(make, header, config.record, early, self.tape.early())
        self.tape.play(self._recorder)

    def step(self, step: Step) -> None:
        """One step of the heart."""
        recorder = self._recorder
        if recorder is None:
            self._early.append(step)
            return
        recorder.step(step)
        # Here, as the recorder's thread must not say anything itself.
        if recorder.recording and not self._announced:
            self._announced = True
            if self._made_room:
                self._say(f"disk: deleted the oldest runs: {', '.join(self._made_room)}")
            self._say(f"recording to {recorder.folder}")

    def close(self, summary: Callable[[], dict[str, object]]) -> None:
        """Write what is left, then the summary.

        Args:
            summary: builds it, of the record as it is then.
        """
        recorder = self._recorder
        if recorder is None:
            return
        answered = recorder.close(CLOSE_S)
        if recorder.error is not None:
            which = "there is no record" if recorder.folder is None else "the record is not complete"
            self._say(f"{which}: {recorder.error}")
        if recorder.folder is None:
            return
        if answered:
            path = recorder.folder / "summary.json"
            # A thread: the disk may begin to hang now. What a summary is built of does not change any more.
            writer = threading.Thread(target=self._summarize, args=(path, summary), daemon=True)
            writer.start()
            writer.join(CLOSE_S)
        self._say(f"run folder {recorder.folder}")

    def _summarize(self, path: Path, summary: Callable[[], dict[str, object]]) -> None:
        try:
            write_json(path, summary())
        except OSError as error:
            self._say(f"{path}: cannot be written: {error.strerror}")

    def _make_room(self, config: Config) -> None:
        """On the ground, before the first file: a disk that is full to the last byte takes no folder."""
        floor = DiskFloor(config.record, Path(config.record.folder) / "to come")
        with contextlib.suppress(OSError):  # the recorder will say what is wrong
            floor.trouble()
        self._made_room = floor.deleted


def _write_configuration(folder: Path, config: Config, policy: bytes | None) -> None:
    """The configuration as it flies, with the policy beside it: it runs again as it stands.

    Raises:
        OSError: the folder cannot be written.
    """
    if policy is not None:
        replace_file(folder / RUN_FILE, policy)
        atmc = msgspec.structs.replace(config.atmc, policy=RUN_FILE)
        config = msgspec.structs.replace(config, atmc=atmc)
    replace_file(folder / "config.toml", configuration.dump(config))
