"""The flight's live state on a local socket: whoever connects is written one line of JSON, and that was it.

Served by the loop itself, which never waits for anybody: what a client sends is not read, what it does not
take at once is lost to it, and a tick answers a few at most.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
from collections.abc import Callable, Mapping
from pathlib import Path

import msgspec

from companion.errors import ConfigError

SUFFIX = ".sock"
MOST_TRACKS = 50
"""Shown of all tracks, the nearest ones."""
_FOLDER = "dmuca"
_PER_TICK = 4
_WAITING = 16
_SEND_BUFFER = 256 * 1024
_MODE = 0o660


class TrackStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One heard aircraft."""

    track_id: str
    transport: str
    """How it was heard last; "adsb" for crewed traffic."""
    distance_m: float
    """Horizontal, now."""
    above_m: float | None
    """Its height over ours; None while it does not tell one."""
    speed_mps: float
    """Horizontal."""
    age_s: float
    """Of what it told last."""
    alert: str
    """none, advisory, caution or warning."""
    conflict: bool
    """The law kept clear of it at its last decision."""
    doubts: tuple[str, ...] = ()
    """What speaks against its messages."""


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that `companion status` shows. Unknown is None; angles in degrees, altitudes above mean sea
    level."""

    aircraft: str
    software: str
    dry_run: bool
    up_s: float
    utc_s: float | None
    """As the vehicle tells it."""
    state: str
    waits_for: str | None
    """Why the vehicle is not taken; None when it flies by us or could."""
    unfit: str | None
    """Why the own state cannot be flown on."""
    vehicle: str | None
    mode: str | None
    armed: bool
    landed: str
    heartbeat_age_s: float | None
    position_age_s: float | None
    lat_deg: float | None
    lon_deg: float | None
    alt_msl_m: float | None
    velocity_ned_mps: tuple[float, float, float]
    gnss_fix_type: int | None
    sigma_m: float
    link: str
    link_up: bool
    link_losses: int
    link_dropped: int
    link_errors: int
    radio: str
    radio_ok: bool
    rates: dict[str, int]
    """What goes on the air: messages a second on each transport; empty in a dry run."""
    remote_id_trouble: str | None
    frames_sent: int
    frames_heard: int
    bad_frames: int
    broadcasts_refused: int
    path_late_s: float
    track_count: int
    tracks: tuple[TrackStatus, ...]
    ticks: int
    late_ticks: int
    worst_tick_ms: float
    """The latest that a tick began after its time."""
    folder: str | None
    recorder_error: str | None
    records_dropped: int
    troubles: tuple[str, ...] = ()
    """What goes wrong beside the flight now: the disk, above all."""
    said: tuple[str, ...]
    """Last lines, the newest at the end."""


def folders(environ: Mapping[str, str]) -> list[Path]:
    """Where the sockets are, the first that can be used: systemd's RuntimeDirectory=, the user's, the
    system's."""
    found = [Path(name) for name in environ.get("RUNTIME_DIRECTORY", "").split(":") if name]
    if environ.get("XDG_RUNTIME_DIR"):
        found.append(Path(environ["XDG_RUNTIME_DIR"]) / _FOLDER)
    return [*found, Path("/run") / _FOLDER]


class StatusServer:
    """The socket of one flight.

    Raises:
        ConfigError: no folder takes a socket of this name, or another process serves it.
    """

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        self.path, self._socket = _listen(name + SUFFIX, folders(environ))

    def serve(self, state: Callable[[], Status]) -> None:
        """Answer those who wait; never blocks.

        Args:
            state: builds what is sent, once for all of them.
        """
        answer = b""
        for _ in range(_PER_TICK):
            try:
                client, _address = self._socket.accept()
            except OSError:
                return
            with client, contextlib.suppress(OSError):
                client.setblocking(False)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
                answer = answer or msgspec.json.encode(state()) + b"\n"
                client.send(answer)

    def close(self) -> None:
        """Stop serving and leave no file behind, where the folder is still ours to write."""
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)


def _listen(name: str, where: list[Path]) -> tuple[Path, socket.socket]:
    error: OSError | None = None
    for folder in where:
        try:
            folder.mkdir(mode=0o750, exist_ok=True)
            return folder / name, _bind(folder / name)
        except OSError as failed:
            error = error or failed
    raise ConfigError(f"{where[0]}: no status socket there: {error and (error.strerror or error)}")


def _bind(path: Path) -> socket.socket:
    """Raises ConfigError where another process serves, OSError where nobody could."""
    if is_served(path):
        raise ConfigError(f"{path}: another companion of this name serves its status there")
    with contextlib.suppress(FileNotFoundError):
        # Left by a process that was killed. What is no socket is not ours to remove: bind refuses then.
        if stat.S_ISSOCK(os.lstat(path).st_mode):
            path.unlink()
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        server.bind(str(path))
        path.chmod(_MODE)
        server.listen(_WAITING)
        server.setblocking(False)
    except OSError:
        server.close()
        raise
    return server


def is_served(path: Path) -> bool:
    """Whether a process listens there."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except BlockingIOError:
            return True  # so many wait that it takes no more now
        except OSError:
            return False
    return True
