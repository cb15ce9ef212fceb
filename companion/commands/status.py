"""`companion status`: reads the live state of a running flight and shows it in a terminal."""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path

import msgspec
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.errors import ConfigError
from companion.runtime.status.sent_rates import in_words
from companion.runtime.status.status_socket import SUFFIX, Status, folders, is_served

PERIOD_S = 0.5
_PATIENCE_S = 2.0
_CHUNK = 65536
_MOST = 4_000_000
_NOBODY = "no companion answers there; leave out --socket to ask the one on this computer"
_NOT_ASKED = {
    errno.ENOENT: _NOBODY,
    errno.ECONNREFUSED: _NOBODY,
    errno.EAGAIN: "no answer, and its queue is full of clients that wait: the companion hangs",
    errno.EACCES: "permission denied; only root and the group of its folder may ask it",
}
_STYLES = {"advisory": "cyan", "caution": "yellow", "warning": "bold red"}


def find_socket(given: Path | None, environ: Mapping[str, str]) -> Path:
    """Path of the status socket: the given one, or that of the only companion that runs on this computer.

    Raises:
        ConfigError: no companion runs here, or several do. The text names the folders or sockets.
    """
    if given is not None:
        return given
    where = folders(environ)
    found = [path for folder in where for path in sorted(folder.glob(f"*{SUFFIX}")) if is_served(path)]
    if not found:
        raise ConfigError(
            "no companion runs on this computer, or you may not ask it; "
            f"searched: {', '.join(map(str, where))}; name another socket with --socket PATH"
        )
    if len(found) > 1:
        raise ConfigError(
            f"several companions run here; choose one with --socket {' or '.join(map(str, found))}"
        )
    return found[0]


def ask(path: Path) -> Status:
    """Read the current state from a status socket.

    Raises:
        ConfigError: no companion answers there, or the answer is not a state.
    """
    data = b""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.settimeout(_PATIENCE_S)
        try:
            client.connect(str(path))
            while (chunk := client.recv(_CHUNK)) and len(data) < _MOST:
                data += chunk
        except TimeoutError as error:
            raise ConfigError(f"{path}: no answer within {_PATIENCE_S:g} s: the companion hangs") from error
        except OSError as error:
            words = _NOT_ASKED.get(error.errno or 0, error.strerror or error)
            raise ConfigError(f"{path}: {words}") from error
    try:
        return msgspec.json.decode(data, type=Status)
    except msgspec.DecodeError as error:
        raise ConfigError(f"{path}: the answer is not the status of this version: {error}") from error


def show_state(given: Path | None, *, once: bool, as_json: bool) -> int:
    """Show the state: once, or once as one line of JSON, or repeatedly until interrupted.

    Returns:
        The exit code: 0.

    Raises:
        ConfigError: `find_socket` or `ask` failed.
    """
    path = find_socket(given, os.environ)
    if as_json:
        print(msgspec.json.encode(ask(path)).decode(), flush=True)
        return 0
    console = Console(highlight=False, markup=False)
    if once or not console.is_terminal:
        console.print(render(ask(path)))
        return 0
    with Live(console=console, auto_refresh=False, screen=True) as screen:
        while True:
            screen.update(render(ask(path)), refresh=True)
            time.sleep(PERIOD_S)


def render(status: Status) -> Group:
    """Format the state for a terminal."""
    facts = Table.grid(padding=(0, 2))
    for name, text, style in _facts(status):
        facts.add_row(Text(name, "dim"), Text(_shown(text), style))
    # No text is cut: text that does not fit into the terminal's width continues on the next line.
    tracks = Table(box=None, padding=(0, 1))
    for name in ("track", "by", "distance", "above", "speed", "age", "alert", "doubts"):
        figure = name in ("distance", "above", "speed", "age")
        tracks.add_column(name, justify="right" if figure else "left", no_wrap=figure, overflow="fold")
    for t in status.tracks:
        alert = f"{t.alert}{', conflict' if t.conflict else ''}"
        cells = (
            t.track_id,
            t.transport,
            f"{t.distance_m:.0f} m",
            "?" if t.above_m is None else f"{t.above_m:+.0f} m",
            f"{t.speed_mps:.1f} m/s",
            f"{t.age_s:.1f} s",
            "" if alert == "none" else alert,
            ", ".join(t.doubts),
        )
        tracks.add_row(*(Text(_shown(cell), _STYLES.get(t.alert, "")) for cell in cells))
    more = status.track_count - len(status.tracks)
    heading = f"tracks: {status.track_count}{f', {more} more distant ones not shown' if more else ''}"
    said = [Text(_shown(line), "dim") for line in status.said]
    return Group(facts, Text(heading, "bold"), *([tracks] if status.tracks else []), *said)


def _facts(s: Status) -> list[tuple[str, str, str]]:
    """Name, text and style of each line of facts."""
    utc = "unknown" if s.utc_s is None else time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(s.utc_s))
    rates = in_words(s.rates, s.sent_per_s) or "nothing"
    place = "unknown"
    if s.lat_deg is not None and s.lon_deg is not None and s.alt_msl_m is not None:
        place = f"{s.lat_deg:.7f} {s.lon_deg:.7f}, {s.alt_msl_m:.1f} m above mean sea level"
    north, east, down = s.velocity_ned_mps
    record = s.folder or "not yet"
    if s.recorder_error is not None:
        record = f"NONE until the companion is restarted: {s.recorder_error}; "
        record += f"{s.records_dropped} records are missing"
    link = f"{s.link}: {'up' if s.link_up else 'DOWN'}"
    link += f"; lost {s.link_losses} times, {s.link_dropped} sends dropped, {s.link_errors} errors"
    on_air = f"{s.radio}; on the air: {rates}; frames sent {s.frames_sent}, heard {s.frames_heard}, "
    on_air += f"bad {s.bad_frames}, refused {s.broadcasts_refused}"
    trouble = s.remote_id_trouble
    return [
        ("aircraft", f"{s.aircraft}{' (DRY RUN)' if s.dry_run else ''}, up {s.up_s:.0f} s", "bold"),
        ("authority", s.state + (f": {s.waits_for}" if s.waits_for else ""), "bold"),
        ("path", f"{s.path_late_s:.0f} s late" if s.path_late_s >= 1.0 else "on time", ""),
        ("vehicle", s.vehicle or "none yet", "" if s.vehicle else "red"),
        ("mode", f"{s.mode or 'unknown'}, {'armed' if s.armed else 'disarmed'}, {s.landed}", ""),
        ("own state", s.unfit or "valid", "red" if s.unfit else "green"),
        ("ages", f"heartbeat {_age(s.heartbeat_age_s)}, position {_age(s.position_age_s)}", ""),
        ("GNSS", f"fix type {s.gnss_fix_type or 'unknown'}, accuracy {s.sigma_m:.1f} m; {utc}", ""),
        ("position", f"{place}; velocity {north:.1f} {east:.1f} {down:.1f} m/s NED", ""),
        ("link", link, "" if s.link_up else "red"),
        ("radio", on_air, "" if s.radio_ok else "red"),
        (
            "Remote ID",
            trouble or "as the region and the configuration require",
            "red" if trouble else "green",
        ),
        ("loop", f"{s.ticks} ticks, {s.late_ticks} missed, worst {s.worst_tick_ms:.1f} ms late", ""),
        ("record", record, "red" if s.recorder_error else ""),
        *(("trouble", t, "red") for t in s.troubles if s.recorder_error is None or s.recorder_error not in t),
    ]


def _age(age_s: float | None) -> str:
    return "never received" if age_s is None else f"{age_s:.2f} s"


def _shown(text: str) -> str:
    """Replace unprintable characters by "?": names come from other aircraft and could control a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
