"""Broadcast Endorsements (section 4.2): a registry signs that a DET and its key are registered with it.

The DRIP Link that carries one is the SAM type 1, then VNB and VNA (four bytes each), the DET and the key of
the child (16 and 32 bytes), the DET of the parent (16), and the parent's signature (64) over all of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from companion.errors import PeerDataError
from companion.remote_id.drip.det import DET_SIZE, KEY_SIZE, Det
from companion.remote_id.drip.evidence import LINK
from companion.remote_id.drip.hashes import message_hash
from companion.remote_id.drip.keys import SIGNATURE_SIZE, verify
from companion.remote_id.drip.times import WINDOW, pack_window, unpack_window

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

ENDORSEMENT_SIZE: Final = WINDOW.size + DET_SIZE + KEY_SIZE + DET_SIZE + SIGNATURE_SIZE
"""136 bytes, without the SAM type."""
_CHILD_AT: Final = WINDOW.size
_KEY_AT: Final = _CHILD_AT + DET_SIZE
_PARENT_AT: Final = _KEY_AT + KEY_SIZE
_SIGNATURE_AT: Final = _PARENT_AT + DET_SIZE


@dataclass(frozen=True, slots=True)
class Endorsement:
    """One Broadcast Endorsement. Times are Unix times in whole seconds."""

    not_before_utc_s: int
    not_after_utc_s: int
    child: Det
    child_key: bytes
    parent: Det
    signature: bytes

    def _signed(self) -> bytes:
        window = pack_window(self.not_before_utc_s, self.not_after_utc_s)
        return window + self.child.data + self.child_key + self.parent.data

    def is_signed_by(self, key: bytes) -> bool:
        """Whether the signature is valid for this public key of the parent."""
        return verify(key, self.signature, self._signed())

    def encode(self) -> bytes:
        """The 136 bytes of the endorsement."""
        return self._signed() + self.signature

    def link(self) -> bytes:
        """The data for an Authentication message of type 5: a DRIP Link."""
        return bytes((LINK,)) + self.encode()

    def hash(self) -> bytes:
        """Hash by which a Manifest names this endorsement."""
        return message_hash(self.encode())


def endorse(
    parent_key: Ed25519PrivateKey,
    parent: Det,
    child: Det,
    child_key: bytes,
    not_before_utc_s: int,
    not_after_utc_s: int,
) -> Endorsement:
    """Endorse a child with the parent's private key.

    Raises:
        ValueError: the child's DET is not that of its key, or the hierarchy or the times do not allow it.
    """
    if not child.belongs_to(child_key):
        raise ValueError(f"{child} is not the DRIP entity tag of the key {child_key.hex()}")
    if not parent.may_endorse(child):
        raise ValueError(f"{parent} may not endorse {child}: another RAA or HDA")
    blank = Endorsement(not_before_utc_s, not_after_utc_s, child, child_key, parent, b"")
    return Endorsement(
        not_before_utc_s, not_after_utc_s, child, child_key, parent, parent_key.sign(blank._signed())
    )


def decode_endorsement(data: bytes) -> Endorsement:
    """Read the 136 bytes of an endorsement. Raises PeerDataError."""
    if len(data) != ENDORSEMENT_SIZE:
        raise PeerDataError(f"Broadcast Endorsement of {len(data)} bytes, expected {ENDORSEMENT_SIZE}")
    return Endorsement(
        *unpack_window(data[:_CHILD_AT]),
        Det(data[_CHILD_AT:_KEY_AT]),
        data[_KEY_AT:_PARENT_AT],
        Det(data[_PARENT_AT:_SIGNATURE_AT]),
        data[_SIGNATURE_AT:],
    )


def decode_link(data: bytes) -> Endorsement:
    """Read a DRIP Link. Raises PeerDataError."""
    if data[:1] != bytes((LINK,)):
        raise PeerDataError(f"SAM type {data[:1].hex() or 'missing'} at offset 0, expected 01")
    return decode_endorsement(data[1:])
