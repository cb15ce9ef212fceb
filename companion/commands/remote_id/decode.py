"""`companion remote-id decode`: hexadecimal text and captures to JSON."""

from __future__ import annotations

import argparse
import io
import string
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import BinaryIO, Final

from companion.commands.remote_id.lines import Printed, as_json, each_line, shown
from companion.errors import ConfigError, PeerDataError
from companion.remote_id import frames
from companion.remote_id.captures.capture_file import is_capture
from companion.remote_id.captures.remote_id_frames import CapturedFrame, Kind, read_capture
from companion.remote_id.codec import Payload, read_payload

_CAPTURES: Final = {".pcap", ".pcapng"}
_LINES_TO_TELL: Final = 3
"""After this many lines that are not hexadecimal, with none that is, the input is not hexadecimal text."""
_NEITHER: Final = "neither a capture (pcap, pcapng) nor hexadecimal text"


def run_decode(args: argparse.Namespace) -> int:
    """Decode the files, or stdin. Returns the exit status. Raises ConfigError for an unreadable file."""
    transport: str | None = args.frame
    if not args.files:
        stream = getattr(sys.stdin, "buffer", None)
        # A capture is never typed, and `peek` on a terminal would swallow the end of the input.
        if isinstance(stream, io.BufferedReader) and not stream.isatty() and is_capture(stream.peek(4)[:4]):
            return _decode_capture(stream, "stdin", transport)
        return _decode_text(sys.stdin, "", transport)
    status = 0
    for path in args.files:
        try:
            with path.open("rb") as stream:
                if path.suffix in _CAPTURES or is_capture(stream.peek(4)[:4]):
                    status |= _decode_capture(stream, str(path), transport)
                else:
                    text = io.TextIOWrapper(stream, encoding="utf-8-sig", errors="replace")
                    status |= _decode_text(text, f"{path}: ", transport)
        except BrokenPipeError:
            raise  # concerns our output, not the file
        except OSError as error:
            raise ConfigError(f"{path}: {error.strerror or error}") from error
    return status


def _decode_text(text: Iterable[str], name: str, transport: str | None) -> int:
    def decode_line(line: str) -> Printed:
        try:
            data = bytes.fromhex(line)
        except ValueError:
            if _is_hexadecimal(line):
                raise ValueError(f"its hexadecimal digits are not in pairs: {shown(line)}") from None
            raise ValueError(f"not hexadecimal: {shown(line)}") from None
        return _payload(data) if transport is None else _frame(transport, data)

    lines = _hexadecimal_text(iter(text), name or "stdin: ")
    return each_line(name, lines, decode_line)


def _hexadecimal_text(text: Iterator[str], name: str) -> Iterator[str]:
    """Yield the lines unchanged. Raises ConfigError if the first lines show that they are not hexadecimal."""
    first: list[str] = []
    wrong: list[str] = []
    for line in text:
        first.append(line)
        if _is_hexadecimal(line):
            if line.strip():
                break
        else:
            wrong.append(line)
            if len(wrong) == _LINES_TO_TELL:
                raise ConfigError(f"{name}{_NEITHER}")
    else:
        if any("\0" in line or "\ufffd" in line for line in wrong):
            raise ConfigError(f"{name}{_NEITHER}")
        text = iter(())  # reading a terminal again after its end would wait for a second end of input
    yield from first
    yield from text


def _is_hexadecimal(line: str) -> bool:
    """Whether the line holds only hexadecimal digits and white space."""
    return set("".join(line.split())) <= set(string.hexdigits)


def _payload(data: bytes) -> Printed:
    messages, faults = read_payload(data)
    if not messages and not faults:
        faults = ("pack without messages",)
    return Printed([as_json(message) for message in messages], faults)


def _frame(transport: str, data: bytes) -> Printed:
    lines: list[str] = []
    faults: list[str] = []
    for frame in frames.parse_frames(transport, data):
        try:
            payload = read_payload(frame.payload)
        except PeerDataError as error:
            payload = Payload((), (str(error),))
        head = {"transport": frame.transport, "address": frame.address, "counter": frame.counter}
        lines.append(as_json({**head, "messages": payload.messages, "faults": payload.faults}))
        faults += payload.faults
    return Printed(lines, faults)


def _decode_capture(stream: BinaryIO, name: str, transport: str | None) -> int:
    """Print each Remote ID frame of a capture. Counts of all kinds of frames go to stderr."""
    if transport is not None:
        raise ConfigError(f"{name}: --frame is for hexadecimal text; a capture names its transports itself")
    kinds: Counter[Kind] = Counter()
    numbers = set()
    status = 0
    try:
        for frame in read_capture(stream, name):
            numbers.add(frame.number)
            kinds[frame.kind] += 1
            if frame.kind is Kind.REMOTE_ID:
                print(as_json(_captured(frame, name)), flush=True)
                status |= bool(frame.faults)
    except PeerDataError as error:
        print(error, file=sys.stderr)
        status = 1
    counts = ", ".join(f"{kinds[kind]} {kind.value}" for kind in Kind)
    print(f"{name}: {len(numbers)} frames: {counts}", file=sys.stderr)
    return status


def _captured(frame: CapturedFrame, name: str) -> dict[str, object]:
    return {
        "file": name,
        "frame": frame.number,
        "time_utc_s": None if frame.time_ns is None else frame.time_ns / 1e9,
        "transport": frame.transport,
        "address": frame.address,
        "rssi_dbm": frame.rssi_dbm,
        "counter": frame.counter,
        "messages": frame.messages,
        "faults": frame.faults,
    }
