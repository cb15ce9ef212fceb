"""Live state of the flight on a local socket: each client that connects is sent one line of JSON.

The flight loop itself serves the socket and never waits for a client. It reads nothing from a client, data
that a client cannot accept at once is lost, and one tick answers only a few clients.
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
from companion.runtime import plain_json

SUFFIX = ".sock"
MOST_TRACKS = 50
"""Largest number of tracks in the state; the nearest ones are shown."""
_FOLDER = "dmuca"
_PER_TICK = 4
_WAITING = 16
_SEND_BUFFER = 256 * 1024
_MODE = 0o660


class TrackStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One aircraft that was received by Remote ID or ADS-B."""

    track_id: str
    transport: str
    """Transport of its latest message; "adsb" for crewed traffic."""
    distance_m: float
    """Current horizontal distance."""
    above_m: float | None
    """Its height above our aircraft; None while it reports no height."""
    speed_mps: float
    """Horizontal speed."""
    age_s: float
    """Age of its latest report."""
    alert: str
    """Alert level: none, advisory, caution or warning."""
    conflict: bool
    """Whether the law avoided this aircraft at its last decision."""
    doubts: tuple[str, ...] = ()
    """Names of the flags that make its messages doubtful."""
    bearing_deg: float | None = None
    """Direction from our aircraft to it, clockwise from true north."""
    track_deg: float | None = None
    """Direction in which it flies; None if it hovers."""


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that `companion status` shows. None means unknown; angles are in degrees, altitudes above
    mean sea level."""

    aircraft: str
    software: str
    dry_run: bool
    up_s: float
    utc_s: float | None
    """Unix time in seconds, from the vehicle's clock."""
    state: str
    waits_for: str | None
    """Why we do not take control of the vehicle, or command nothing although we have it; None if we control
    it or could."""
    unfit: str | None
    """Why our own state is not fit for flying; None if it is."""
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
    """Rates that were chosen: messages per second on each transport; empty in a dry run."""
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
    """Largest delay of a tick after its deadline."""
    folder: str | None
    recorder_error: str | None
    records_dropped: int
    sent_per_s: dict[str, float] = {}
    """Measured rates: messages per second on each transport that was chosen some seconds ago. The region may
    ask for more than was chosen."""
    troubles: tuple[str, ...] = ()
    """Current troubles that do not end the flight, mostly of the disk."""
    said: tuple[str, ...]
    """Latest console lines, the newest at the end."""
    wanted_ned_mps: tuple[float, float, float] | None = None
    """Velocity along the path at the law's latest decision; None while we do not fly the vehicle."""
    chosen_ned_mps: tuple[float, float, float] | None = None
    """Velocity that is commanded; None while we do not fly the vehicle."""
    limits: tuple[str, ...] = ()
    """Limits that bound it, other than other aircraft."""


def folders(environ: Mapping[str, str]) -> list[Path]:
    """Candidate folders of the sockets, each once, in order of preference: systemd's RuntimeDirectory=, the
    user's runtime folder, the system's. The first usable one is used."""
    found = [Path(name) for name in environ.get("RUNTIME_DIRECTORY", "").split(":") if name]
    if environ.get("XDG_RUNTIME_DIR"):
        found.append(Path(environ["XDG_RUNTIME_DIR"]) / _FOLDER)
    return list(dict.fromkeys([*found, Path("/run") / _FOLDER]))


class StatusServer:
    """The status socket of one flight.

    Raises:
        ConfigError: no folder accepts a socket of this name, or another process already serves it.
    """

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        self.path, self._socket = _listen(name + SUFFIX, folders(environ))

    def serve(self, state: Callable[[], Status]) -> None:
        """Answer the clients that wait; never blocks.

        Args:
            state: builds the state that is sent; it is called once for all clients of this call.
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
                answer = answer or plain_json.encode(state()) + b"\n"
                client.send(answer)

    def close(self) -> None:
        """Stop serving and remove the socket's file, if the folder is still writable."""
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
    raise ConfigError(
        f"{where[0]}: the status socket cannot be created: {error and (error.strerror or error)}"
    )


def _bind(path: Path) -> socket.socket:
    """Raises ConfigError if another process serves this path, OSError if the path cannot be served at all."""
    if is_served(path):
        raise ConfigError(f"{path}: another companion of this name already serves its status there")
    with contextlib.suppress(FileNotFoundError):
        # Remove a socket that a killed process left behind. Anything else is not ours to remove, and `bind`
        # then refuses.
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
    """Whether a process listens on this socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except BlockingIOError:
            return True  # its backlog is full: many clients are waiting
        except OSError:
            return False
    return True
