"""`companion remote-id encode|decode|check`: Remote ID messages by hand, and conformance.

Exit status: 0 when everything held, 1 when a line or a vector did not, 2 when the vector file is not one.
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final, TextIO

import msgspec

from companion.errors import ConfigError, PeerDataError
from companion.remote_id.codec import PACK_TYPE, decode, decode_pack, encode, encode_pack
from companion.remote_id.conformance import Report, check_file
from companion.remote_id.messages import Message

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

_JSON: Final = msgspec.json.Decoder[Message](Message)

_ENCODE_EXAMPLE: Final = """example:
  echo '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}' \\
    | companion remote-id encode
"""
_DECODE_EXAMPLE: Final = """example:
  echo 520046494e38376173747264676531326b3800000000000000 | companion remote-id decode
"""
_CHECK_EXAMPLE: Final = """example:
  companion remote-id check vectors.json
"""


def add_arguments(subparsers: Subparsers) -> None:
    """Add `encode`, `decode` and `check` to the subparsers of `remote-id`; each sets `run`."""

    def action(name: str, text: str, example: str) -> argparse.ArgumentParser:
        parser = subparsers.add_parser(
            name,
            help=text,
            description=text,
            epilog=example,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        parser.set_defaults(run=run, action=name)
        return parser

    pack = action("encode", "JSON messages on stdin, one a line, to hexadecimal bytes.", _ENCODE_EXAMPLE)
    pack.add_argument("--pack", action="store_true", help="put all messages into one message pack")
    action("decode", "Hexadecimal messages or packs on stdin, one a line, to JSON messages.", _DECODE_EXAMPLE)
    check = action("check", "Compare the codec with a file of reference vectors.", _CHECK_EXAMPLE)
    check.add_argument(
        "vectors", type=Path, metavar="VECTORS.json", help="plain, or gzip with the suffix .gz"
    )


def run(args: argparse.Namespace) -> int:
    """Do what was parsed, on stdin and stdout; complaints go to stderr. Returns the exit status."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")  # so that a line of noise is that line's fault alone
    if args.action == "check":
        return _check(args.vectors)
    if args.action == "decode":
        return _each_line(sys.stdin, _decode_line)
    return _encode_pack(sys.stdin) if args.pack else _each_line(sys.stdin, _encode_line)


def _each_line(lines: TextIO, work: Callable[[str], Iterable[str]]) -> int:
    """Print what every line turns into; a bad one is named on stderr and the rest goes on."""
    status = 0
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            results = list(work(line.strip()))
        except (ValueError, PeerDataError) as error:
            print(f"line {number}: {error}", file=sys.stderr)
            status = 1
            continue
        for result in results:
            print(result, flush=True)
    return status


def _encode_line(line: str) -> Iterable[str]:
    return [encode(_JSON.decode(line)).hex()]


def _decode_line(line: str) -> Iterable[str]:
    data = bytes.fromhex(line)
    is_pack = bool(data) and data[0] >> 4 == PACK_TYPE
    messages = decode_pack(data) if is_pack else (decode(data),)
    return [msgspec.json.encode(message).decode() for message in messages]


def _encode_pack(lines: TextIO) -> int:
    messages: list[Message] = []

    def collect(line: str) -> Iterable[str]:
        messages.append(_JSON.decode(line))
        return ()

    if _each_line(lines, collect):
        return 1
    try:
        print(encode_pack(messages).hex())
    except ValueError as error:
        print(f"remote-id encode: {error}", file=sys.stderr)
        return 1
    return 0


def _check(path: Path) -> int:
    try:
        report = check_file(path)
    except ConfigError as error:
        print(f"remote-id check: {error}", file=sys.stderr)
        return 2
    for difference in report.differences:
        print(difference)
    print(_summary(report))
    return 1 if report.differences else 0


def _summary(report: Report) -> str:
    """Counts in one line."""
    checked = ", ".join(f"{kind} {count}" for kind, count in sorted(report.checked.items()))
    return f"{report.checked.total()} vectors checked ({checked}), {len(report.differences)} differences"
