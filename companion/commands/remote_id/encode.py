"""`companion remote-id encode`: JSON messages to hexadecimal bytes, packs or frames."""

from __future__ import annotations

import argparse
import sys
from typing import Final

from companion.commands.remote_id.lines import Printed, each_line
from companion.commands.remote_id.message_json import message_from_json
from companion.errors import ConfigError
from companion.remote_id import frames
from companion.remote_id.codec import encode, encode_pack
from companion.remote_id.messages import Message
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

OWN_ADDRESS: Final = "02:00:00:00:00:01"
"""Default transmitter address: locally administered, so that it belongs to no manufacturer."""


def run_encode(args: argparse.Namespace) -> int:
    """Encode the messages on stdin. Returns the exit status. Raises ConfigError for options that conflict."""
    transport: str | None = args.frame
    if transport is None and (args.counter is not None or args.address is not None):
        raise ConfigError("--counter and --address need --frame")
    if args.address is not None and transport in (BLE4, BLE5):
        raise ConfigError(f"--address: advertising data ({transport}) holds no address")
    counter, address = args.counter or 0, args.address or OWN_ADDRESS

    if transport == BLE4:

        def frame(line: str) -> Printed:
            return Printed([frames.build_ble4(encode(message_from_json(line)), counter).hex()])

        return each_line("", sys.stdin, frame)
    if transport is None and not args.pack:
        return each_line("", sys.stdin, lambda line: Printed([encode(message_from_json(line)).hex()]))
    messages: list[Message] = []

    def collect(line: str) -> Printed:
        messages.append(message_from_json(line))
        return Printed(())

    if each_line("", sys.stdin, collect):
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
