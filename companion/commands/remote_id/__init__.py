"""`companion remote-id encode|decode|check|key|endorse`: encode and decode messages, read captures, check
conformance, make keys.

Exit status: 0 if everything was correct; 1 if a line, a frame or a vector was not, if a capture ends inside a
frame, or if there was nothing to do; 2 if the request or a file is wrong.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from companion.commands.drip_keys import run_endorse, run_key
from companion.commands.remote_id.decode import run_decode
from companion.commands.remote_id.encode import OWN_ADDRESS, run_encode
from companion.commands.remote_id.message_json import EXAMPLES
from companion.errors import ConfigError
from companion.remote_id import frames
from companion.remote_id.conformance.vectors import Report, check_file
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

if TYPE_CHECKING:
    Subparsers = argparse._SubParsersAction[argparse.ArgumentParser]

_TRANSPORTS: Final = (BLE4, BLE5, WIFI_BEACON, WIFI_NAN)

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
_KEY_HELP: Final = """\
A new key is written to a file that only you can read; a file that exists is never overwritten. RAA and HDA
name the registry. Numbers of RAA from 15360 on are for private use.

examples:
  companion remote-id key drip.pem --raa 16376 --hda 10
  companion remote-id key drip.pem --raa 16376 --hda 10 --show
"""
_ENDORSE_HELP: Final = """\
FILE holds the private key of the registry, whose RAA and HDA are given. The endorsement is printed as
hexadecimal digits, for a file that remote_id.signing.links names.

example:
  companion remote-id endorse hda.pem --raa 16376 --hda 10 --days 30 \\
    --child 2001:3f:fe00:a05:1308:2469:9a4b:c6b2 \\
    --child-key c92e2f9d97e8960f9b5f1654f8b09039f9dadc5bcf061eac4f0cea79e8e877fa > own.link
"""


def add_arguments(subparsers: Subparsers) -> None:
    """Add the actions of this package to the subparsers of `remote-id`; each calls `run`."""

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
        help=f"transmitter of a Wi-Fi frame (default: {OWN_ADDRESS})",
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

    make = action(
        "key", "Make a key for signatures, and print its DRIP entity tag and public key.", _KEY_HELP
    )
    _add_key(make)
    make.add_argument("--show", action="store_true", help="make nothing; show the key that the file holds")
    sign = action("endorse", "Endorse the key of an aircraft with that of its registry.", _ENDORSE_HELP)
    _add_key(sign)
    sign.add_argument("--child", required=True, metavar="DET", help="its DRIP entity tag, an IPv6 address")
    sign.add_argument(
        "--child-key", required=True, metavar="KEY", help="its public key: 64 hex digits, or a PEM file"
    )
    sign.add_argument("--days", type=int, default=30, help="how long it is valid from now (default: 30)")


def _add_key(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="PEM file of the private key")
    parser.add_argument("--raa", type=int, required=True, help="Registered Assigning Authority, 0 to 16383")
    parser.add_argument("--hda", type=int, required=True, help="HHIT Domain Authority, 0 to 16383")


def run(args: argparse.Namespace) -> int:
    """Run the parsed action on stdin and stdout; errors go to stderr. Returns the exit status."""
    if isinstance(sys.stdin, io.TextIOWrapper):
        # JSON is UTF-8 in every locale. Undecodable bytes must be an error of their own line only.
        sys.stdin.reconfigure(encoding="utf-8", errors="replace")
    actions = {
        "encode": run_encode,
        "decode": run_decode,
        "check": _check,
        "key": run_key,
        "endorse": run_endorse,
    }
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
