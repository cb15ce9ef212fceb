"""`companion remote-id key|endorse`: make keys for DRIP, and let a registry's key endorse others.

This module also checks the configured key before a flight.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from companion.commands.preflight import Preflight
from companion.config import Config
from companion.errors import ConfigError
from companion.remote_id.drip.det import Det, make_det, parse_det
from companion.remote_id.drip.keys import public_bytes, public_key_hex
from companion.remote_id.drip.link import decode_endorsement, endorse
from companion.runtime.drip_key import make_key, open_signer, read_private_key

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


def find_signing(config: Config, found: Preflight) -> None:
    """Check that the key of `remote_id.signing` can be used, and that no endorsement has ended."""
    signing = config.remote_id.signing
    try:
        signer = open_signer(config)
    except ConfigError as error:
        found.red("signatures", str(error), "correct the key file or remote_id.signing")
        return
    if signing is None or signer is None:
        return
    found.green("signatures", f"Remote ID is signed as {signer.det}")
    if not signing.links:
        found.yellow(
            "signatures",
            "no registry endorses the key: only receivers that have it can verify it",
            "set remote_id.signing.links",
        )
    for link in map(decode_endorsement, map(bytes.fromhex, signing.links)):
        if not link.not_before_utc_s <= time.time() <= link.not_after_utc_s:
            found.yellow(
                "signatures",
                f"the endorsement of {link.child} by {link.parent} is not valid now",
                "let the registry endorse it again, or set this computer's clock",
            )
