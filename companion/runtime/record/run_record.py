"""The record of one flight: its run folder, from the core's (`companion.core`) first step to the summary.

Steps and link bytes that arrive before the folder exists are kept in memory. A record folder that cannot be
written neither ends a flight nor prevents one: after a restart in the air the aircraft must broadcast and
avoid others, with or without a record.
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
from companion.errors import ConfigError
from companion.event_record import Header, Step
from companion.runtime.policy import RUN_FILE
from companion.runtime.record.code import code_sha256
from companion.runtime.record.disk import RUN, DiskFloor, not_mounted, replace_file
from companion.runtime.record.recorder import (
    CLOSE_S,
    FlightRecorder,
    create_run_folder,
    write_json,
    write_manifest,
)


class _Tape:
    """Bytes that cross the link, kept until there is a recorder, so that the tlog holds the first texts to
    the pilot, too."""

    def __init__(self) -> None:
        self._recorder: FlightRecorder | None = None
        self._early: list[bytes] = []

    def write(self, data: bytes) -> None:
        """Pass bytes to the recorder, or keep them until there is one."""
        if self._recorder is None:
            self._early.append(data)
        else:
            self._recorder.write(data)

    def early(self) -> bytes:
        """Return the bytes that were kept, and drop them here."""
        data = b"".join(self._early)
        self._early.clear()
        return data

    def play(self, recorder: FlightRecorder) -> None:
        """Pass all further bytes to `recorder`."""
        self._recorder = recorder


class RunRecord:
    """Takes every step of the core. Steps from before `open` are kept and written then."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.tape = _Tape()
        self._say = say
        self._recorder: FlightRecorder | None = None
        self._early: list[Step] = []
        self._made_room: list[str] = []
        self._announced = False

    @property
    def folder(self) -> Path | None:
        """Run folder; None before it is made."""
        return None if self._recorder is None else self._recorder.folder

    @property
    def error(self) -> str | None:
        """Why nothing more is recorded in this flight; None while recording works."""
        return None if self._recorder is None else self._recorder.error

    def slow(self, now_s: float) -> str | None:
        """What is wrong with a disk that is slow but has not failed; None if nothing is."""
        return None if self._recorder is None else self._recorder.slow(now_s)

    @property
    def dropped(self) -> int:
        """Number of records that were lost."""
        return 0 if self._recorder is None else self._recorder.dropped

    @property
    def deleted(self) -> list[str]:
        """Names of older runs that were deleted in flight to make room."""
        return [] if self._recorder is None else self._recorder.deleted

    def open(self, config: Config, policy: bytes | None, vehicle: str, *, dry_run: bool = False) -> None:
        """Make the run folder and record everything, including what was kept until now.

        Does not wait for the disk: a later `step` reports the folder to the user, and `error` holds a
        failure.
        """
        utc_s = time.time()
        header = Header(
            aircraft=config.identity.file_name,
            software=__version__,
            config=configuration.public(config),
            policy=policy,
        )

        def make() -> Path:
            root = Path(config.record.folder)
            # A folder made in the place of a disk would be taken for that disk at the next start.
            absent = not_mounted(root)
            if absent is not None:
                raise ConfigError(f"record.folder: {root}: {absent}")
            self._make_room(config)
            folder = create_run_folder(root, config.record.name, utc_s)
            _write_configuration(folder, config, policy)
            write_manifest(
                folder,
                RUN,
                aircraft=[header.aircraft],
                started_utc_s=utc_s,
                vehicle=vehicle,
                dry_run=dry_run,
                code_sha256=code_sha256(),
            )
            return folder

        # The record must begin with the core's first step; otherwise a replay would not reach the same
        # state.
        early, self._early = self._early, []
        self._recorder = FlightRecorder(make, header, config.record, early, self.tape.early())
        self.tape.play(self._recorder)

    def step(self, step: Step) -> None:
        """One step of the core."""
        recorder = self._recorder
        if recorder is None:
            self._early.append(step)
            return
        recorder.step(step)
        # Reported here, because the recorder's thread must not print anything itself.
        if recorder.recording and not self._announced:
            self._announced = True
            if self._made_room:
                self._say(f"disk: deleted the oldest runs: {', '.join(self._made_room)}")
            self._say(f"recording to {recorder.folder}")

    def close(self, summary: Callable[[], dict[str, object]]) -> None:
        """Write what is left, then the summary.

        Args:
            summary: builds the summary; it is called after the record is closed.
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
            # In a thread, because the disk may hang now. The data of the summary does not change any more.
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
        """Delete old runs before the first file is written: a completely full disk takes no new folder."""
        floor = DiskFloor(config.record, Path(config.record.folder) / "to come")
        with contextlib.suppress(OSError):  # the recorder will report the trouble
            floor.trouble()
        self._made_room = floor.deleted


def _write_configuration(folder: Path, config: Config, policy: bytes | None) -> None:
    """Write the configuration as flown, with the policy file next to it, so that it can be run again
    unchanged.

    Raises:
        OSError: the folder cannot be written.
    """
    if policy is not None:
        replace_file(folder / RUN_FILE, policy)
        atmc = msgspec.structs.replace(config.atmc, policy=RUN_FILE)
        config = msgspec.structs.replace(config, atmc=atmc)
    replace_file(folder / "config.toml", configuration.dump(config))
