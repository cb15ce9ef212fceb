"""`companion remote-id encode|decode|check`: encode and decode messages, read captures, check conformance.

Exit status: 0 if everything was correct; 1 if a line, a frame or a vector was not, if a capture ends inside a
frame, or if there was nothing to do; 2 if the request or a file is wrong.
"""

from __future__ import annotations

import argparse
import enum
import io
import json
import string
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, get_args

import msgspec

from companion.errors import ConfigError, PeerDataError
from companion.remote_id import frames
from companion.remote_id.captures.capture_file import is_capture
from companion.remote_id.captures.remote_id_frames import CapturedFrame, Kind, read_capture
from companion.remote_id.codec import Payload, encode, encode_pack, read_payload
from companion.remote_id.conformance.vectors import Report, check_file
from companion.remote_id.messages import Location, Message, System
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from companion.remote_id.wire_values import position_to_wire

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

_JSON: Final = msgspec.json.Decoder[Message](Message)
_TYPES: Final = {kind.__name__: kind for kind in get_args(Message)}
_TRANSPORTS: Final = (BLE4, BLE5, WIFI_BEACON, WIFI_NAN)
_OWN_ADDRESS: Final = "02:00:00:00:00:01"
"""Default transmitter address: locally administered, so that it belongs to no manufacturer."""
_CAPTURES: Final = {".pcap", ".pcapng"}
_LINES_TO_TELL: Final = 3
"""After this many lines that are not hexadecimal, with none that is, the input is not hexadecimal text."""
_NEITHER: Final = "neither a capture (pcap, pcapng) nor hexadecimal text"
_SHOWN: Final = 40
"""Largest number of characters of a wrong line or value that an error text repeats."""

EXAMPLES: Final = (
    '{"type":"BasicId","id_type":1,"ua_type":2,"uas_id":"1581F6N8A23B2ML3Y3KR"}',
    '{"type":"Location","status":2,"lat_deg":47.1,"lon_deg":8.5,"alt_geodetic_m":500.0,"height_m":80.0,'
    '"direction_deg":90.0,"speed_mps":12.0,"vertical_speed_mps":0.5,"timestamp_s":1373.5}',
    '{"type":"Authentication","auth_type":1,"page":0,"data":"c2lnbmF0dXJl","last_page":0,"length":9}',
    '{"type":"SelfId","description_type":0,"text":"survey"}',
    '{"type":"System","operator_location_type":1,"operator_lat_deg":47.1,"operator_lon_deg":8.5,'
    '"operator_alt_geodetic_m":420.0,"timestamp_utc_s":1735689600.0}',
    '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}',
)
"""An example JSON message of each type."""

_ENCODE_HELP: Final = f"""the six types of messages, one line each:
{chr(10).join(f"  {line}" for line in EXAMPLES)}

A key that is left out means "unknown". The data of an Authentication message is base64. An ID that is not
text (UTM UUID, session ID) is written as one character per byte, "\\u0000" to "\\u00ff".

examples:
  echo '{EXAMPLES[5]}' \\
    | companion remote-id encode
  companion remote-id encode --frame wifi --counter 7 --address 02:00:5e:10:20:30 < messages.json
"""
_DECODE_HELP: Final = """\
FILE or stdin is a capture (pcap or pcapng of Bluetooth LE or Wi-Fi) or hexadecimal text. The readable
messages of a damaged pack are printed; its faults are reported on stderr, or under "faults" of a captured
frame.

examples:
  echo 520046494e38376173747264676531326b3800000000000000 | companion remote-id decode
  companion remote-id decode capture.pcapng
"""
_CHECK_HELP: Final = """example:
  companion remote-id check vectors.json
"""


def add_arguments(subparsers: Subparsers) -> None:
    """Add `encode`, `decode` and `check` to the subparsers of `remote-id`; each calls `run`."""

    def action(name: str, text: str, more: str) -> argparse.ArgumentParser:
        parser = subparsers.add_parser(
            name,
            help=text,
            description=text,
            epilog=more,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        parser.set_defaults(run=run, action=name)
        return parser

    into = action(
        "encode", "Convert JSON messages on stdin, one per line, to hexadecimal bytes.", _ENCODE_HELP
    )
    form = into.add_mutually_exclusive_group()
    form.add_argument("--pack", action="store_true", help="put all messages into one message pack")
    form.add_argument(
        "--frame",
        choices=_TRANSPORTS,
        help="build frames: advertising data (ble4: one per message; ble5: a pack) or 802.11 (a pack)",
    )
    into.add_argument(
        "--counter", type=_counter, metavar="N", help="message counter of the frame (default: 0)"
    )
    into.add_argument(
        "--address",
        type=_address,
        metavar="MAC",
        help=f"transmitter of a Wi-Fi frame (default: {_OWN_ADDRESS})",
    )

    back = action(
        "decode", "Convert hexadecimal messages or packs, one per line, or captures to JSON.", _DECODE_HELP
    )
    back.add_argument("files", nargs="*", type=Path, metavar="FILE", help="files to read instead of stdin")
    back.add_argument(
        "--frame",
        choices=_TRANSPORTS,
        help="each line is advertising data or an 802.11 frame of this transport",
    )

    check = action("check", "Compare the codec and the frames with a file of reference vectors.", _CHECK_HELP)
    check.add_argument(
        "vectors", type=Path, metavar="VECTORS.json", help="JSON file, or gzip with the suffix .gz"
    )


def run(args: argparse.Namespace) -> int:
    """Run the parsed action on stdin and stdout; errors go to stderr. Returns the exit status."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        # JSON is UTF-8 in every locale. Undecodable bytes must be an error of their own line only.
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    actions = {"encode": _encode, "decode": _decode, "check": _check}
    try:
        return actions[args.action](args)
    except ConfigError as error:
        print(f"remote-id {args.action}: {error}", file=sys.stderr)
        return 2


def _counter(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or int(text) > 0xFF:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: 0 to 255")
    return int(text)


def _address(text: str) -> str:
    try:
        return frames.address_bytes(text).hex(":")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class _Printed(NamedTuple):
    """Result of one input line: the lines to print, and what is wrong with it."""

    lines: Sequence[str]
    faults: Sequence[str] = ()


def _each_line(name: str, lines: Iterable[str], work: Callable[[str], _Printed]) -> int:
    """Print the result of `work` for every line. Returns the exit status.

    Faults of a line, including a ValueError or PeerDataError of `work`, are printed on stderr with `name`
    before the line's number; the remaining lines are still processed.
    """
    status = 0
    number = 0
    worked = False
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        worked = True
        try:
            printed = work(line.strip())
        except (ValueError, PeerDataError) as error:
            printed = _Printed((), (str(error),))
        except RecursionError:
            printed = _Printed((), ("nested too deeply",))
        for text in printed.lines:
            print(text, flush=True)
        for fault in printed.faults:
            print(f"{name}line {number}: {fault}", file=sys.stderr)
            status = 1
    if not worked:
        how_much = f"nothing to read in {number} lines" if number else "nothing to read: the input is empty"
        print(f"{name}{how_much}", file=sys.stderr)
        return 1
    return status


def _as_json(content: object) -> str:
    """JSON as one line of ASCII, which every terminal and locale can show."""
    return json.dumps(msgspec.to_builtins(content), separators=(",", ":"))


def _shown(content: object) -> str:
    """A wrong value for an error text, as JSON shortened to `_SHOWN` characters."""
    text = _as_json(content)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


# ---------------------------------------------------------------- encode


def _encode(args: argparse.Namespace) -> int:
    transport: str | None = args.frame
    if transport is None and (args.counter is not None or args.address is not None):
        raise ConfigError("--counter and --address need --frame")
    if args.address is not None and transport in (BLE4, BLE5):
        raise ConfigError(f"--address: advertising data ({transport}) holds no address")
    counter, address = args.counter or 0, args.address or _OWN_ADDRESS

    if transport == BLE4:

        def frame(line: str) -> _Printed:
            return _Printed([frames.build_ble4(encode(_message(line)), counter).hex()])

        return _each_line("", sys.stdin, frame)
    if transport is None and not args.pack:
        return _each_line("", sys.stdin, lambda line: _Printed([encode(_message(line)).hex()]))
    messages: list[Message] = []

    def collect(line: str) -> _Printed:
        messages.append(_message(line))
        return _Printed(())

    if _each_line("", sys.stdin, collect):
        return 1
    try:
        print(_pack_in(transport, encode_pack(messages), counter, address).hex())
    except ValueError as error:
        print(f"remote-id encode: {error}", file=sys.stderr)
        return 1
    return 0


def _pack_in(transport: str | None, pack: bytes, counter: int, address: str) -> bytes:
    if transport == BLE5:
        return frames.build_ble5(pack, counter)
    if transport == WIFI_BEACON:
        return frames.build_beacon(pack, counter, address)
    if transport == WIFI_NAN:
        return frames.build_nan_action(pack, counter, address)
    return pack


def _message(line: str) -> Message:
    """The message in a line of JSON. Raises ValueError that names the key, its value and what is allowed."""
    try:
        message: Message = _JSON.decode(line)
    except msgspec.DecodeError as error:
        raise ValueError(_explain(line, str(error))) from error
    match message:
        case Location():
            _check_position("Location.", message.lat_deg, message.lon_deg)
        case System():
            _check_position("System.operator_", message.operator_lat_deg, message.operator_lon_deg)
    return message


def _check_position(prefix: str, lat_deg: float | None, lon_deg: float | None) -> None:
    """Raises ValueError for a coordinate out of range; only if there is none, for a missing coordinate."""
    position_to_wire(prefix, lat_deg or 0.0, lon_deg or 0.0)
    if (lat_deg is None) != (lon_deg is None):
        missing, given = ("lat_deg", "lon_deg") if lat_deg is None else ("lon_deg", "lat_deg")
        raise ValueError(f"{prefix}{missing}: missing; give it together with {prefix}{given}, or neither")


def _explain(line: str, words: str) -> str:
    """What is wrong with a line that is not a message; `words`, the decoder's text, if nothing else fits."""
    try:
        held = msgspec.json.decode(line)
    except msgspec.ValidationError:
        return "a number is too large"
    except msgspec.DecodeError as error:
        _, _, what = str(error).partition("JSON is malformed: ")
        return f"not JSON: {what or 'incomplete'}"
    if not isinstance(held, dict):
        return f"{_shown(held)} is not a message; allowed: an object such as {EXAMPLES[3]}"
    name = held.get("type")
    kind = _TYPES.get(name) if isinstance(name, str) else None
    if kind is None:
        return f"type: {_shown(name) if 'type' in held else 'missing'}; allowed: {', '.join(_TYPES)}"
    fields = {field.name: field for field in msgspec.structs.fields(kind)}
    for key in held:
        if key not in fields and key != "type":
            return f"{name}: unknown key {_shown(key)}; allowed: {', '.join(fields)}"
    for key, field in fields.items():
        if key not in held:
            if field.required:
                return f"{name}.{key}: missing; allowed: {_allowed(field.type)}"
            continue
        try:
            msgspec.convert(held[key], field.type)
        except msgspec.ValidationError:
            return f"{name}.{key}: {_shown(held[key])}; allowed: {_allowed(field.type)}"
    return words


def _allowed(kind: object) -> str:
    """What JSON may hold for a field of this type."""
    if alternatives := get_args(kind):
        return " or ".join(map(_allowed, alternatives))
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return ", ".join(f"{member.value} {member.name.lower().replace('_', ' ')}" for member in kind)
    words: dict[object, str] = {float: "a number", int: "a whole number", str: "text", bytes: "base64 text"}
    return words.get(kind, "null")


# ---------------------------------------------------------------- decode


def _decode(args: argparse.Namespace) -> int:
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
    def decode_line(line: str) -> _Printed:
        try:
            data = bytes.fromhex(line)
        except ValueError:
            if _is_hexadecimal(line):
                raise ValueError(f"its hexadecimal digits are not in pairs: {_shown(line)}") from None
            raise ValueError(f"not hexadecimal: {_shown(line)}") from None
        return _payload(data) if transport is None else _frame(transport, data)

    lines = _hexadecimal_text(iter(text), name or "stdin: ")
    return _each_line(name, lines, decode_line)


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


def _payload(data: bytes) -> _Printed:
    messages, faults = read_payload(data)
    if not messages and not faults:
        faults = ("pack without messages",)
    return _Printed([_as_json(message) for message in messages], faults)


def _frame(transport: str, data: bytes) -> _Printed:
    lines: list[str] = []
    faults: list[str] = []
    for frame in frames.parse_frames(transport, data):
        try:
            payload = read_payload(frame.payload)
        except PeerDataError as error:
            payload = Payload((), (str(error),))
        head = {"transport": frame.transport, "address": frame.address, "counter": frame.counter}
        lines.append(_as_json({**head, "messages": payload.messages, "faults": payload.faults}))
        faults += payload.faults
    return _Printed(lines, faults)


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
                print(_as_json(_captured(frame, name)), flush=True)
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


# ---------------------------------------------------------------- check


def _check(args: argparse.Namespace) -> int:
    report = check_file(args.vectors)
    for difference in report.differences:
        print(difference)
    print(_summary(report))
    return 1 if report.differences else 0


def _summary(report: Report) -> str:
    """Counts of the report in one line."""
    checked = ", ".join(f"{kind} {count}" for kind, count in sorted(report.checked.items()))
    return f"{report.checked.total()} vectors checked ({checked}), {len(report.differences)} differences"
