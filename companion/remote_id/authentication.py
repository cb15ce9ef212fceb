"""Authentication messages (ASTM F3411-22a section 5.4.5.8): split, assemble, sign and verify with Ed25519.

The standard defines the pages (17 bytes on page 0, 23 on each of up to 15 more) and the type numbers: 1 UAS
ID signature, 2 operator ID signature, 3 message set signature, 4 by network Remote ID, 5 specific method (RFC
9575, DRIP), 10-15 private. It leaves the signed content, algorithm and key to the signer. We therefore use a
convention of our own, and only a sender that follows it passes the check:

- Ed25519 (RFC 8032), 64 bytes of signature, four pages. The public key of an identity is configured, never
  received over the air.
- Type 1: the 20-byte UAS ID field as in the Basic ID, then the page-0 timestamp (u32, little-endian). It
  authenticates only the identity and the time. A receiver can replay it while it is fresh, and with another
  position.
- Type 3: the 25-byte messages of the same pack in their order, without authentication pages, then the
  timestamp. It authenticates the position too. For the check, messages are encoded again, in protocol version
  2 with reserved bits zero.

The other types are assembled and displayed but never verified. Verifying DRIP (type 5) would need its
registries to obtain a key.
"""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from companion.errors import ConfigError
from companion.remote_id.codec import encode
from companion.remote_id.messages import Authentication, Message
from companion.remote_id.wire_values import utc_from_wire, utc_to_wire

# Imported only where a key is used, which saves 8 MB on an aircraft without keys.
if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

UAS_ID_SIGNATURE: Final = 1
MESSAGE_SET_SIGNATURE: Final = 3

PAGE_0_DATA: Final = 17
PAGE_DATA: Final = 23
LAST_PAGE: Final = 15
LENGTH_MAX: Final = 255
"""Largest value of the length byte, although 16 pages could hold more."""

_ID_SIZE: Final = 20
_TIMESTAMP: Final = struct.Struct("<I")
_CHECKS_PER_S: Final = 20
"""Maximum number of signatures checked per second. A flood of false ones must not exhaust the processor."""


@dataclass(frozen=True, slots=True)
class AuthenticationData:
    """One Authentication assembled from its pages."""

    auth_type: int
    timestamp_utc_s: float | None
    data: bytes

    @property
    def page_count(self) -> int:
        """Number of pages that the data takes."""
        return 1 + max(0, -(-(len(self.data) - PAGE_0_DATA) // PAGE_DATA))


def split(authentication: AuthenticationData) -> tuple[Authentication, ...]:
    """Split the data into the pages to send, page 0 first. Raises ValueError for more than 255 bytes."""
    data, count = authentication.data, authentication.page_count
    if len(data) > LENGTH_MAX:
        raise ValueError(f"authentication data of {len(data)} bytes; allowed: up to {LENGTH_MAX}")
    first = Authentication(
        auth_type=authentication.auth_type,
        page=0,
        data=data[:PAGE_0_DATA],
        last_page=count - 1,
        length=len(data),
        timestamp_utc_s=authentication.timestamp_utc_s,
    )
    rest = (data[PAGE_0_DATA + PAGE_DATA * k :][:PAGE_DATA] for k in range(count - 1))
    return first, *(
        Authentication(auth_type=authentication.auth_type, page=k, data=part)
        for k, part in enumerate(rest, start=1)
    )


# ---------------------------------------------------------------- pages to data


@dataclass(slots=True)
class _PageSet:
    """Pages of one type received so far from one source.

    A page does not state which page 0 it belongs to. Pages normally arrive in order, so those received after
    a page 0 belong to it. Pages received earlier may have overtaken page 0, so they fill gaps until the same
    page arrives after it.
    """

    touched_s: float
    head: Authentication | None = None
    pages: dict[int, bytes] = field(default_factory=dict)
    early: dict[int, bytes] = field(default_factory=dict)

    def add_page(self, page: Authentication) -> bool:
        """Take in one page. Return whether it adds anything new."""
        if page.page == 0:
            return self._take_head(page)
        number, data = page.page, page.data[:PAGE_DATA].ljust(PAGE_DATA, b"\0")
        if self.head is not None and self.pages.get(number, data) != data:
            # A page that we hold arrived with new content: the next set has begun, and its page 0 was missed.
            self.head, self.pages, self.early = None, {}, {}
        if self.head is None:
            self.early[number] = data
            return False
        if number > (self.head.last_page or 0) or number in self.pages:
            return False
        self.pages[number] = data
        return self.early.pop(number, None) != data

    def _take_head(self, head: Authentication) -> bool:
        if head.last_page is None or head.length is None or head == self.head:
            return False
        if head.last_page > LAST_PAGE or head.length > PAGE_0_DATA + PAGE_DATA * head.last_page:
            return False
        if self.head is not None:
            self.early = {}
        self.head, self.pages = head, {}
        return True

    def data(self) -> AuthenticationData | None:
        """Return the complete data; None while a page is missing."""
        head = self.head
        if head is None or head.last_page is None or head.length is None:
            return None
        parts = [head.data[:PAGE_0_DATA].ljust(PAGE_0_DATA, b"\0")]
        for number in range(1, head.last_page + 1):
            part = self.pages.get(number) or self.early.get(number)
            if part is None:
                return None
            parts.append(part)
        return AuthenticationData(head.auth_type, head.timestamp_utc_s, b"".join(parts)[: head.length])


class Assembler:
    """Assembles the pages of many sources, and drops sets that receive no more pages.

    Args:
        max_sets: Number of page sets held at once, one for each source and type. The one untouched for
            longest is dropped first. A set holds at most 2 x 15 pages.
        timeout_s: After this long without a page, the next page starts the set anew.
    """

    def __init__(self, max_sets: int = 256, timeout_s: float = 15.0) -> None:
        self.max_sets = max_sets
        self.timeout_s = timeout_s
        self._sets: OrderedDict[tuple[str, int], _PageSet] = OrderedDict()

    def __len__(self) -> int:
        """Number of page sets held."""
        return len(self._sets)

    def held_bytes(self) -> int:
        """Number of bytes of page data held."""
        return sum(
            len(part) for s in self._sets.values() for part in (*s.pages.values(), *s.early.values())
        ) + sum(len(s.head.data) for s in self._sets.values() if s.head is not None)

    def add_page(self, source: str, page: Authentication, now_s: float) -> AuthenticationData | None:
        """Take in one page. Return the complete data if this page completed or changed it, else None."""
        key = (source, page.auth_type)
        pages = self._sets.pop(key, None)
        if pages is None or now_s - pages.touched_s > self.timeout_s:
            pages = _PageSet(now_s)
        self._sets[key] = pages
        if len(self._sets) > self.max_sets:
            self._sets.popitem(last=False)
        pages.touched_s = now_s
        return pages.data() if pages.add_page(page) else None


# ---------------------------------------------------------------- signatures


def signed_bytes(
    auth_type: int, identity: str, messages: Sequence[Message], timestamp_utc_s: float | None
) -> bytes:
    """Return the bytes that a signature of type 1 or 3 covers (see the module docstring).

    Args:
        messages: Messages of the pack. Type 1 does not use them.

    Raises:
        ValueError: another type, a message that cannot be sent, or nothing to sign.
    """
    stamp = _TIMESTAMP.pack(utc_to_wire("Authentication.timestamp_utc_s", timestamp_utc_s))
    if auth_type == UAS_ID_SIGNATURE:
        return _id_field(identity) + stamp
    if auth_type != MESSAGE_SET_SIGNATURE:
        raise ValueError(f"auth_type is {auth_type!r}; allowed: 1 (UAS ID) and 3 (message set)")
    signed = [encode(message) for message in messages if not isinstance(message, Authentication)]
    if not signed:
        raise ValueError("a message set signature needs messages")
    return b"".join(signed) + stamp


def sign_pages(
    key: Ed25519PrivateKey,
    auth_type: int,
    identity: str,
    messages: Sequence[Message],
    timestamp_utc_s: float,
) -> tuple[Authentication, ...]:
    """Sign, and return the four pages. Type 3 pages go into one pack with the messages. Raises ValueError."""
    stamp = utc_from_wire(utc_to_wire("Authentication.timestamp_utc_s", timestamp_utc_s))
    signature = key.sign(signed_bytes(auth_type, identity, messages, stamp))
    return split(AuthenticationData(auth_type, stamp, signature))


class Verifier:
    """Verifies signatures of the identities whose keys are configured.

    Args:
        keys: Identity -> raw Ed25519 public key, 64 hex digits.
        fresh_s: Largest allowed difference between a signature's timestamp and our UTC.

    Raises:
        ConfigError: an identity or key is invalid. The text names the identity.
    """

    def __init__(self, keys: Mapping[str, str], fresh_s: float = 10.0) -> None:
        self.fresh_s = fresh_s
        self._keys = {identity: _key(identity, text) for identity, text in keys.items()}
        self._checks = float(_CHECKS_PER_S)
        self._checks_s = 0.0

    def knows(self, identity: str) -> bool:
        """Whether a key is configured for this identity."""
        return identity in self._keys

    def verify(self, identity: str, data: AuthenticationData, messages: Sequence[Message]) -> bool:
        """Whether the signature is valid for this identity and its signed bytes. False without a key."""
        key = self._keys.get(identity)
        if key is None:
            return False
        from cryptography.exceptions import InvalidSignature

        try:
            key.verify(data.data, signed_bytes(data.auth_type, identity, messages, data.timestamp_utc_s))
        except (InvalidSignature, ValueError):
            return False
        return True

    def judge(
        self,
        identity: str,
        data: AuthenticationData,
        messages: Sequence[Message],
        utc_s: float | None,
        not_before_utc_s: float,
        now_s: float,
    ) -> bool | None:
        """Whether the signature is genuine, fresh, and not older than the last one from this address.

        Args:
            messages: Messages of the frame that completed the data.
            utc_s: Our UTC; None while unknown.
            not_before_utc_s: Timestamp of the last valid signature from the same radio address. It is kept
                per address, because the transports may not be received in the order of sending.

        Returns:
            None if it cannot be judged: no key, a type that we do not verify, a message set that is not
                complete in this frame, unknown own time, or more signatures than are checked per second.
        """
        if not self.knows(identity) or utc_s is None:
            return None
        if data.auth_type == MESSAGE_SET_SIGNATURE:
            pages = sum(isinstance(message, Authentication) for message in messages)
            if pages < data.page_count or pages == len(messages):
                return None
        elif data.auth_type != UAS_ID_SIGNATURE:
            return None
        stamp = data.timestamp_utc_s
        if stamp is None or abs(utc_s - stamp) > self.fresh_s or stamp < not_before_utc_s:
            return False
        return self.verify(identity, data, messages) if self._may_check(now_s) else None

    def _may_check(self, now_s: float) -> bool:
        rise = max(0.0, now_s - self._checks_s) * _CHECKS_PER_S
        self._checks, self._checks_s = min(float(_CHECKS_PER_S), self._checks + rise), now_s
        if self._checks < 1.0:
            return False
        self._checks -= 1.0
        return True


def public_key_hex(text: str, folder: Path) -> str:
    """Return a configured key as 64 hex digits.

    It is given as hex digits, or as the path (relative to `folder`) of a PEM file.

    Raises:
        ConfigError: the text is neither. The error says what it is instead.
    """
    if _is_hex_key(text):
        return text.lower()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

    path = folder / text
    try:
        key = load_pem_public_key(path.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        raise ConfigError(
            f"{text!r}: neither 64 hex digits nor a PEM file of an Ed25519 public key: {error}"
        ) from error
    if not isinstance(key, Ed25519PublicKey):
        raise ConfigError(f"{text!r}: holds a {type(key).__name__}; an Ed25519 public key is needed")
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def _is_hex_key(text: str) -> bool:
    return len(text) == 64 and all(c in "0123456789abcdefABCDEF" for c in text)


def _key(identity: str, text: str) -> Ed25519PublicKey:
    try:
        _id_field(identity)
    except ValueError as error:
        raise ConfigError(f'traffic.keys."{identity}": {error}') from error
    if not _is_hex_key(text):
        raise ConfigError(f'traffic.keys."{identity}": {text!r}: an Ed25519 public key is 64 hex digits')
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    return Ed25519PublicKey.from_public_bytes(bytes.fromhex(text))


def _id_field(identity: str) -> bytes:
    """Return the identity as a Basic ID field. Raises ValueError."""
    data = identity.encode("latin-1", errors="replace")
    if not identity or len(data) > _ID_SIZE or data.decode("latin-1") != identity:
        raise ValueError(f"identity is {identity!r}; allowed: 1 to {_ID_SIZE} Latin-1 characters")
    return data.ljust(_ID_SIZE, b"\0")
