"""DRIP Entity Tags (DET): 16-byte identities that are bound to a public key (RFC 9374).

From the highest bit (section 3, figure 1): the prefix 2001:30::/28, 14 bits of Registered Assigning Authority
(RAA), 14 bits of HHIT Domain Authority (HDA), 8 bits of suite, and 64 bits of hash. The hash (section 3.5.2)
covers the first eight bytes and the public key. The text names the key's part of the input HOST_ID; the
examples of RFC 9886 appendix A and of RFC 9575 appendix B show that it is the 32 bytes of the Ed25519 key.

In a Basic ID a DET is a specific session ID of type 1 (section 4): that byte, then the DET.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError
from companion.remote_id.drip.hashes import HASH_SIZE, orchid_hash

DET_SIZE: Final = 16
KEY_SIZE: Final = 32
AUTHORITY_MAX: Final = 0x3FFF
"""Largest RAA and HDA, 14 bits each."""

_PREFIX: Final = 0x2001003
_SUITE: Final = 5
"""EdDSA with cSHAKE128 (section 3.2)."""
_SESSION_TYPE: Final = 1
_RAA_RESERVED: Final = frozenset((0, 4096, 8192, 12288))
"""HDA values that stand for the RAA itself (RFC 9886 section 3)."""


@dataclass(frozen=True, slots=True)
class Det:
    """One DRIP Entity Tag of the suite EdDSA/cSHAKE128.

    Raises:
        PeerDataError: not 16 bytes, another prefix, or another suite.
    """

    data: bytes

    def __post_init__(self) -> None:
        data = self.data
        if len(data) != DET_SIZE:
            raise PeerDataError(f"DRIP entity tag of {len(data)} bytes, expected {DET_SIZE}")
        if int.from_bytes(data[:4]) >> 4 != _PREFIX:
            raise PeerDataError(f"{data.hex()}: a DRIP entity tag is an address of 2001:30::/28")
        if data[7] != _SUITE:
            raise PeerDataError(f"{data.hex()}: suite {data[7]}; supported: {_SUITE} (EdDSA/cSHAKE128)")

    @property
    def raa(self) -> int:
        """Registered Assigning Authority."""
        return int.from_bytes(self.data[:8]) >> 22 & AUTHORITY_MAX

    @property
    def hda(self) -> int:
        """HHIT Domain Authority."""
        return int.from_bytes(self.data[:8]) >> 8 & AUTHORITY_MAX

    @property
    def identity(self) -> str:
        """The DET as `BasicId.uas_id` holds it: one character for each byte, first the session type."""
        return (bytes((_SESSION_TYPE,)) + self.data).decode("latin-1")

    def belongs_to(self, key: bytes) -> bool:
        """Whether the hash is that of this public key (32 bytes) under these authorities."""
        return len(key) == KEY_SIZE and orchid_hash(self.data[:HASH_SIZE] + key) == self.data[HASH_SIZE:]

    def may_endorse(self, child: Det) -> bool:
        """Whether the hierarchy allows this DET's owner to endorse another one.

        An HDA endorses within its RAA and HDA. An RAA, whose HDA value is reserved, endorses every HDA value
        of its own RAA (RFC 9886 section 3).
        """
        return self.raa == child.raa and (self.hda == child.hda or self.hda in _RAA_RESERVED)

    def __str__(self) -> str:
        """The DET as an IPv6 address."""
        return str(ipaddress.IPv6Address(self.data))


def make_det(key: bytes, raa: int, hda: int) -> Det:
    """Make the DET of a public key. Raises ValueError for a key or an authority out of range."""
    if len(key) != KEY_SIZE:
        raise ValueError(f"a public key has {KEY_SIZE} bytes, not {len(key)}")
    for name, number in (("raa", raa), ("hda", hda)):
        if not 0 <= number <= AUTHORITY_MAX:
            raise ValueError(f"{name} is {number}; allowed: 0 to {AUTHORITY_MAX}")
    head = (_PREFIX << 36 | raa << 22 | hda << 8 | _SUITE).to_bytes(HASH_SIZE)
    return Det(head + orchid_hash(head + key))


def parse_det(text: str) -> Det:
    """Read a DET written as an IPv6 address. Raises ValueError."""
    try:
        return Det(ipaddress.IPv6Address(text).packed)
    except (ipaddress.AddressValueError, PeerDataError) as error:
        raise ValueError(f"{text!r}: not a DRIP entity tag: {error}") from error


def det_of(identity: str) -> Det | None:
    """The DET that a Basic ID of a specific session holds; None if the identity is none."""
    if not identity.startswith(chr(_SESSION_TYPE)) or len(identity) > 1 + DET_SIZE:
        return None
    try:
        # A receiver cannot tell the zeros at the end of a DET from padding.
        return Det(identity[1:].encode("latin-1").ljust(DET_SIZE, b"\0"))
    except (UnicodeEncodeError, PeerDataError):
        return None
