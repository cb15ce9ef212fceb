"""`companion remote-id key|endorse`: make keys for DRIP, and let a registry's key endorse others."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from companion.errors import ConfigError
from companion.remote_id.drip.det import Det, make_det, parse_det
from companion.remote_id.drip.keys import public_bytes, public_key_hex
from companion.remote_id.drip.link import endorse
from companion.runtime.drip_key import make_key, read_private_key

_DAY_S = 86_400


def run_key(args: argparse.Namespace) -> int:
    """Make a key, or show that of a file with `--show`. Returns the exit status. Raises ConfigError."""
    path: Path = args.file
    try:
        key = read_private_key(path, "FILE") if args.show else make_key(path, args.raa, args.hda)
        det = make_det(public_bytes(key), args.raa, args.hda)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    print(f"DRIP entity tag  {det}")
    print(f"public key       {public_bytes(key).hex()}")
    print(f'as identity      id_type = 4, uas_id = "{det.identity.encode("latin-1").hex()}"')
    return 0


def run_endorse(args: argparse.Namespace) -> int:
    """Print an endorsement of a child by the key of a registry. Returns the exit status. Raises
    ConfigError."""
    parent_key = read_private_key(args.file, "FILE")
    try:
        parent = make_det(public_bytes(parent_key), args.raa, args.hda)
        child: Det = parse_det(args.child)
        child_key = bytes.fromhex(public_key_hex(args.child_key, Path()))
        now_s = int(time.time())
        made = endorse(parent_key, parent, child, child_key, now_s, now_s + args.days * _DAY_S)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    print(made.encode().hex())
    return 0
