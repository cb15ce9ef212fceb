"""What an aircraft signs in flight (section 4.1): Wrapper, Manifest and Frame.

After one byte of SAM type, all three have one structure: VNB and VNA (four bytes each), the evidence (up to
112 bytes), the DET (16) and the signature (64) over all of that. They differ in the evidence:

- Wrapper (section 4.3): up to four messages of 25 bytes, in the order of their types. In a pack it is left
  empty after signing, and stands for the other messages of that pack (section 4.3.2).
- Manifest (section 4.4): hashes of eight bytes. First that of the previous Manifest, that of this one and
  that of the Broadcast Endorsement by which the registry endorsed the aircraft; then up to 11 of messages
  already sent. A message is hashed with its 25 bytes, or its whole pack where it was sent in one (section
  4.4.3).
- Frame (section 4.5): contents that other specifications define. Nothing here uses them.

Two things were read off the example of appendix B.2. The hash of this Manifest covers the previous hash,
eight zeros, the hash of the endorsement (which the text leaves out) and those of the messages. An endorsement
is hashed without its SAM type.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from companion.errors import PeerDataError
from companion.remote_id.codec import MESSAGE_SIZE
from companion.remote_id.drip.det import DET_SIZE, Det
from companion.remote_id.drip.hashes import HASH_SIZE, message_hash
from companion.remote_id.drip.keys import SIGNATURE_SIZE, verify
from companion.remote_id.drip.times import WINDOW, pack_window, unpack_window

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

LINK: Final = 1
WRAPPER: Final = 2
MANIFEST: Final = 3
FRAME: Final = 4

DATA_MAX: Final = 201
"""Greatest length of DRIP data with its SAM type: nine pages (section 3.2.4.2)."""
EVIDENCE_MAX: Final = 112
WRAPPED_MAX: Final = 4
HASHES_MAX: Final = 11
HASHES_ADVISED: Final = 10
"""With 11 hashes the parity page would need one more page (section 4.4)."""
NO_HASH: Final = bytes(HASH_SIZE)

_LEDGER: Final = 3
"""Number of hashes before those of messages."""
_WRAPPABLE: Final = frozenset((0, 1, 3, 4, 5))
_FIXED: Final = 1 + WINDOW.size + DET_SIZE + SIGNATURE_SIZE


@dataclass(frozen=True, slots=True)
class Evidence:
    """One signed structure. Times are Unix times in whole seconds."""

    sam_type: int
    not_before_utc_s: int
    not_after_utc_s: int
    content: bytes
    """The evidence as sent: empty in a Wrapper that stands for its pack."""
    det: Det
    signature: bytes

    def is_signed_by(self, key: bytes, content: bytes | None = None) -> bool:
        """Whether the signature is valid for this public key.

        Args:
            content: the evidence that was signed, where it is not the one that was sent.
        """
        window = pack_window(self.not_before_utc_s, self.not_after_utc_s)
        return verify(key, self.signature, window + (content or self.content) + self.det.data)

    def encode(self) -> bytes:
        """The data for an Authentication message of type 5."""
        window = pack_window(self.not_before_utc_s, self.not_after_utc_s)
        return bytes((self.sam_type,)) + window + self.content + self.det.data + self.signature


class Hashes(NamedTuple):
    """The evidence of a Manifest."""

    previous: bytes
    current: bytes
    link: bytes
    messages: tuple[bytes, ...]


def sign(
    key: Ed25519PrivateKey,
    det: Det,
    sam_type: int,
    content: bytes,
    not_before_utc_s: int,
    not_after_utc_s: int,
    *,
    in_pack: bool = False,
) -> Evidence:
    """Sign evidence with the private key of a DET.

    Args:
        in_pack: leave the evidence of a Wrapper out after signing, because it stands in the same pack.

    Raises:
        ValueError: evidence or times that do not fit.
    """
    if len(content) > EVIDENCE_MAX:
        raise ValueError(f"evidence of {len(content)} bytes; allowed: up to {EVIDENCE_MAX}")
    signature = key.sign(pack_window(not_before_utc_s, not_after_utc_s) + content + det.data)
    kept = b"" if in_pack else content
    return Evidence(sam_type, not_before_utc_s, not_after_utc_s, kept, det, signature)


def decode_evidence(data: bytes) -> Evidence:
    """Read a Wrapper, Manifest or Frame. Raises PeerDataError."""
    size = len(data)
    if not _FIXED <= size <= DATA_MAX:
        raise PeerDataError(f"DRIP evidence of {size} bytes; allowed: {_FIXED} to {DATA_MAX}")
    if data[0] not in (WRAPPER, MANIFEST, FRAME):
        raise PeerDataError(f"SAM type {data[0]} at offset 0; allowed: {WRAPPER} to {FRAME}")
    at = size - DET_SIZE - SIGNATURE_SIZE
    not_before, not_after = unpack_window(data[1 : 1 + WINDOW.size])
    return Evidence(
        data[0],
        not_before,
        not_after,
        data[1 + WINDOW.size : at],
        Det(data[at : at + DET_SIZE]),
        data[at + DET_SIZE :],
    )


def manifest_content(previous: bytes, link: bytes, messages: Sequence[bytes]) -> bytes:
    """Build the evidence of a Manifest.

    Args:
        previous: hash of the previous Manifest; eight random bytes in the first one.
        link: hash of the Broadcast Endorsement of the aircraft.
        messages: hashes of messages or packs already sent.

    Raises:
        ValueError: more hashes than a Manifest holds.
    """
    if len(messages) > HASHES_MAX:
        raise ValueError(f"{len(messages)} hashes; allowed: up to {HASHES_MAX}")
    rest = b"".join((link, *messages))
    return previous + message_hash(previous + NO_HASH + rest) + rest


def read_manifest(content: bytes) -> Hashes:
    """Read the evidence of a Manifest, and check its own hash. Raises PeerDataError."""
    if len(content) % HASH_SIZE or len(content) < _LEDGER * HASH_SIZE:
        raise PeerDataError(
            f"Manifest with {len(content)} bytes of hashes, expected {_LEDGER} or more times 8"
        )
    parts = tuple(content[at : at + HASH_SIZE] for at in range(0, len(content), HASH_SIZE))
    hashes = Hashes(parts[0], parts[1], parts[2], parts[_LEDGER:])
    if message_hash(hashes.previous + NO_HASH + content[2 * HASH_SIZE :]) != hashes.current:
        raise PeerDataError("Manifest whose hash of itself is wrong")
    return hashes


def wrapper_content(messages: Sequence[bytes]) -> bytes:
    """Build the evidence of a Wrapper from encoded messages, in the order of their types. Raises
    ValueError."""
    if not 1 <= len(messages) <= WRAPPED_MAX:
        raise ValueError(f"{len(messages)} messages in a Wrapper; allowed: 1 to {WRAPPED_MAX}")
    for message in messages:
        if len(message) != MESSAGE_SIZE or message[0] >> 4 not in _WRAPPABLE:
            raise ValueError(f"message {message.hex()} cannot be wrapped; allowed: types 0, 1, 3, 4, 5")
    ordered: list[bytes] = sorted(messages, key=lambda message: message[0] >> 4)
    return b"".join(ordered)


def read_wrapper(content: bytes) -> tuple[bytes, ...]:
    """Read the messages in a Wrapper; none if it stands for its pack. Raises PeerDataError."""
    if len(content) % MESSAGE_SIZE or len(content) > WRAPPED_MAX * MESSAGE_SIZE:
        raise PeerDataError(f"Wrapper with {len(content)} bytes of messages, expected 0 to 4 times 25")
    messages = tuple(content[at : at + MESSAGE_SIZE] for at in range(0, len(content), MESSAGE_SIZE))
    kinds = [message[0] >> 4 for message in messages]
    if kinds != sorted(kinds) or not _WRAPPABLE.issuperset(kinds):
        raise PeerDataError(f"Wrapper with messages of the types {kinds}")
    return messages
