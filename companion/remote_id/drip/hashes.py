"""cSHAKE128 (NIST SP 800-185) as DRIP uses it: 64 bits of output, an empty function name."""

from __future__ import annotations

from typing import Final

HASH_SIZE: Final = 8

_ORCHID_CONTEXT: Final = bytes.fromhex("00b5a69c795df5d5f0087f56843f2c40")
"""Context ID of RFC 9374 section 3."""
_MESSAGE_CONTEXT: Final = b"Remote ID Auth Hash"
"""Customization string of section 4.4.3."""


def orchid_hash(data: bytes) -> bytes:
    """Hash for a DRIP Entity Tag (RFC 9374 section 3.5.2)."""
    return _cshake128(data, _ORCHID_CONTEXT)


def message_hash(data: bytes) -> bytes:
    """Hash for a Manifest (section 4.4.3): of a message, a pack, a Manifest or a Broadcast Endorsement."""
    return _cshake128(data, _MESSAGE_CONTEXT)


def _cshake128(data: bytes, custom: bytes) -> bytes:
    # Imported only where it is used, which saves memory on an aircraft without signatures.
    from Crypto.Hash import cSHAKE128

    return cSHAKE128.new(data=data, custom=custom).read(HASH_SIZE)
