"""`companion remote-id listen`: a live table of the aircraft that any radio receives.

It only listens, and needs no position of its own.
"""

from __future__ import annotations

import argparse
import io
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, TextIO

import msgspec
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion import config as configuration
from companion.commands.heard_table import COLUMNS, HeardTable, cells, health_words, json_line
from companion.config import Config, IdentityConfig
from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.ether.section import EtherRadio
from companion.radio.hci.section import HciRadio
from companion.radio.radio import Health
from companion.radio.registry import RadioConfig
from companion.radio.wifi.section import WifiRadio
from companion.runtime import clock
from companion.runtime.radios import Radios

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

_POLL_S: Final = 0.05
_DRAW_S: Final = 0.25
_LINES_S: Final = 1.0
_TO_THE_RIGHT: Final = {"dBm", "age s", "alt m", "m/s", "track", "msg/s"}
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_EXAMPLES: Final = """examples:
  companion remote-id listen --config my.toml
  companion remote-id listen --radio wifi=mon0 --seconds 60
  companion remote-id listen --radio hci=tcp:127.0.0.1:6402 --radio ether=127.0.0.1:14640 --json
"""


def add_arguments(subparsers: Subparsers) -> None:
    """Add `listen` to the subparsers of `remote-id`; it calls `run`."""
    parser = subparsers.add_parser(
        "listen",
        help="Show the aircraft that are received.",
        description="Show a live table of received aircraft, or plain lines if the output is not a terminal.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--config", type=Path, help="configuration file (TOML) whose radios are used")
    source.add_argument(
        "--radio",
        action="append",
        metavar="KIND=WHERE",
        help="radio to use without a configuration: hci=CHANNEL, wifi=MONITOR_INTERFACE or ether=HOST:PORT; "
        "may be given several times",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object per received frame")
    parser.add_argument("--seconds", type=_seconds, help="stop after this time (default: until Ctrl-C)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Listen with the options of the command line. Returns the exit code: 1 if the output cannot be written.

    Raises:
        ConfigError: no configured radio can listen, or a radio cannot be opened.
    """
    if arguments.radio is not None:
        config = Config(identity=IdentityConfig(uas_id="LISTENER"), radio=_shortcuts(arguments.radio))
        name = "--radio"
    else:
        config, name = configuration.load(arguments.config), str(arguments.config)
    if not config.has_radio:
        raise ConfigError(f"{name}: radio: none configured, so nothing can be received; add a [[radio]]")
    listeners = tuple(part for radio in config.radio if (part := radio.listening()) is not None)
    if not listeners:
        raise ConfigError(f"{name}: radio: none of the configured radios can listen")
    radios = Radios(msgspec.structs.replace(config, radio=listeners), sending=False)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(
            errors="backslashreplace"
        )  # a character that the terminal cannot show must not end the command
    try:
        with _stop_signal() as stopped:
            listen(radios, _view(as_json=arguments.json), stopped, arguments.seconds)
    except _CannotWriteError as error:
        print(f"remote-id listen: the output cannot be written: {error}", file=sys.stderr)
        with suppress(OSError):
            sys.stdout.close()  # so that Python does not try to write the rest again at exit
        return 1
    finally:
        radios.close()
    return 0


def listen(radios: Radios, view: View, stopped: Callable[[], bool], seconds: float | None) -> None:
    """Receive and show frames until `stopped` returns True, or for `seconds`."""
    began_s = clock.now_s()
    heard = HeardTable()
    with view:
        while not stopped():
            now_s = clock.now_s()
            for event in radios.events(now_s):
                if isinstance(event, RemoteIdHeard):
                    heard.add(event, now_s)
                    view.frame(event, time.time())
            heard.forget(now_s)
            view.show(heard, radios.health(now_s), now_s)
            if seconds is not None and now_s - began_s >= seconds:
                break
            time.sleep(_POLL_S)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a number of seconds, 0 or more")
    return seconds


def _shortcuts(texts: Sequence[str]) -> tuple[RadioConfig, ...]:
    made: list[RadioConfig] = []
    for text in texts:
        kind, _, where = text.partition("=")
        if kind not in ("hci", "wifi", "ether") or not where:
            raise ConfigError(
                f"--radio: {text!r}: allowed: hci=CHANNEL, wifi=MONITOR_INTERFACE and ether=HOST:PORT"
            )
        match kind:
            case "hci":
                made.append(HciRadio(channel=where, send=False))
            case "wifi":
                made.append(WifiRadio(monitor=where))
            case _:
                made.append(EtherRadio(address=where))
    return tuple(made)


@contextmanager
def _stop_signal() -> Iterator[Callable[[], bool]]:
    """Catch SIGINT, SIGHUP and SIGTERM. Yields a function that returns whether one of them has arrived."""
    noted = False

    def note(_number: int, _frame: object) -> None:
        nonlocal noted
        noted = True

    taken = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]  # nohup
    before = {number: signal.signal(number, note) for number in taken}
    try:
        yield lambda: noted
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# ---------------------------------------------------------------- on the terminal


class View(Protocol):
    """Output of `listen`: a context manager that is entered before the first call and left at the end."""

    def __enter__(self) -> object: ...
    def __exit__(self, *error: object) -> None: ...

    def frame(self, event: RemoteIdHeard, utc_s: float) -> None:
        """Show a frame that was received."""

    def show(self, heard: HeardTable, health: Health, now_s: float) -> None:
        """Show the current state of the table and the radios."""


class _CannotWriteError(Exception):
    """The output cannot be written, for example because the disk is full."""


def _say(line: str, stream: TextIO | None = None) -> None:
    """Print a line at once, on stdout unless another stream is given."""
    try:
        print(line, file=stream, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise _CannotWriteError(error.strerror) from error


def _view(*, as_json: bool) -> View:
    if as_json:
        return JsonLines()
    console = Console()
    return LiveTable(console) if console.is_terminal else PlainLines()


class LiveTable:
    """A table that is redrawn in place, for a terminal."""

    def __init__(self, console: Console) -> None:
        self._live = Live(console=console, auto_refresh=False, vertical_overflow="ellipsis")
        self._drawn_s = -1e9

    def __enter__(self) -> LiveTable:
        self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.stop()

    def frame(self, event: RemoteIdHeard, utc_s: float) -> None:
        """Do nothing: the table shows the frame."""

    def show(self, heard: HeardTable, health: Health, now_s: float) -> None:
        """Redraw the table if `_DRAW_S` has passed."""
        if now_s - self._drawn_s < _DRAW_S:
            return
        self._drawn_s = now_s
        self._live.update(drawing(heard, health, now_s, self._live.console.height), refresh=True)


def drawing(heard: HeardTable, health: Health, now_s: float, rows: int) -> Group:
    """The line of the radios and the table, newest first, so that only the oldest rows do not fit the screen.

    Received text is never interpreted as markup of rich, even if it holds brackets.

    Args:
        rows: largest number of rows. Drawing takes time, during which nothing is received.
    """
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for name in COLUMNS:
        table.add_column(name, justify="right" if name in _TO_THE_RIGHT else "left", overflow="fold")
    for aircraft in heard.newest_first()[:rows]:
        table.add_row(*map(Text, cells(aircraft, now_s).values()))
    style = "" if health.ok else "bold red"
    return Group(Text(health_words(health, len(heard)), style=style), table)


class PlainLines:
    """Once a second, one line for each aircraft received since the last time, and one for the radios if they
    changed."""

    def __init__(self) -> None:
        self._shown_s: float | None = None
        self._radios = ""
        self._words = ""

    def __enter__(self) -> PlainLines:
        return self

    def __exit__(self, *error: object) -> None:
        _say(f"radio: {self._words}")

    def frame(self, event: RemoteIdHeard, utc_s: float) -> None:
        """Do nothing: the next line holds the frame."""

    def show(self, heard: HeardTable, health: Health, now_s: float) -> None:
        """Print the lines if `_LINES_S` has passed."""
        self._words = health_words(health, len(heard))
        if self._shown_s is not None and now_s - self._shown_s < _LINES_S:
            return
        since_s, self._shown_s = self._shown_s, now_s
        if health.text != self._radios:
            self._radios = health.text
            _say(f"radio: {self._words}")
        for aircraft in heard.newest_first():
            if since_s is not None and aircraft.last_s <= since_s:
                break
            shown = cells(aircraft, now_s)
            _say("; ".join(f"{name} {value}" for name, value in shown.items() if value))


class JsonLines:
    """One JSON object for each frame on stdout; the state of the radios, when it changes, on stderr."""

    def __init__(self) -> None:
        self._radios = ""
        self._words = ""

    def __enter__(self) -> JsonLines:
        return self

    def __exit__(self, *error: object) -> None:
        _say(f"radio: {self._words}", sys.stderr)

    def frame(self, event: RemoteIdHeard, utc_s: float) -> None:
        """Print the frame as JSON."""
        _say(json_line(event, utc_s))

    def show(self, heard: HeardTable, health: Health, now_s: float) -> None:
        """Print the state of the radios if it changed."""
        self._words = health_words(health, len(heard))
        if health.text != self._radios:
            self._radios = health.text
            _say(f"radio: {self._words}", sys.stderr)
