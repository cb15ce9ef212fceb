"""Which key an identity has: configured keys, and keys that a configured registry endorses over the air.

Only endorsements by configured anchors count. A key that was learned from an endorsement proves messages of
its owner, but cannot endorse others: a DET does not show whether it is a registry's or an aircraft's, so
otherwise every registered aircraft could register others.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Final

from companion.errors import ConfigError
from companion.remote_id.drip.det import Det, det_of, parse_det
from companion.remote_id.drip.keys import is_hex_key
from companion.remote_id.drip.link import Endorsement

_ID_SIZE: Final = 20
_LEARNED_MAX: Final = 512
"""Number of endorsed keys held. Only anchors can add one; the one unused for longest is dropped first."""


class Trust:
    """The keys of identities.

    Args:
        keys: Identity -> raw Ed25519 public key, 64 hex digits. A DET is written as an IPv6 address.
        anchors: DET of a registry -> its public key, in the same form.

    Raises:
        ConfigError: an entry is invalid. The text names it.
    """

    def __init__(self, keys: Mapping[str, str], anchors: Mapping[str, str]) -> None:
        self._keys: dict[str, bytes] = {}
        for name, text in keys.items():
            where = f'traffic.keys."{name}"'
            det = _det(where, name) if ":" in name else None
            key = _key(where, text, det)
            self._keys[_checked(where, name) if det is None else det.identity] = key
        self._owners: dict[str, Det] = {}
        """The last DET that signed for an identity in `_keys`."""
        self._anchors: dict[Det, bytes] = {}
        for name, text in anchors.items():
            where = f'traffic.anchors."{name}"'
            anchor = _det(where, name)
            self._anchors[anchor] = _key(where, text, anchor)
        self._learned: OrderedDict[Det, Endorsement] = OrderedDict()

    def __bool__(self) -> bool:
        """Whether anything is configured, so that signatures can be verified at all."""
        return bool(self._keys or self._anchors)

    def __len__(self) -> int:
        """Number of keys learned from endorsements."""
        return len(self._learned)

    def knows(self, identity: str) -> bool:
        """Whether the key of an identity is known."""
        return identity in self._keys or det_of(identity) in self._learned

    def judges(self, identity: str) -> bool:
        """Whether signatures of an identity are judged: its key is configured, or it is a DET and an anchor
        may endorse it."""
        if identity in self._keys:
            return True
        det = det_of(identity)
        return det is not None and any(anchor.may_endorse(det) for anchor in self._anchors)

    def owner(self, identity: str) -> Det | None:
        """The DET that signs for an identity, as far as it is known without a computation."""
        return self._owners.get(identity) if identity in self._keys else det_of(identity)

    def may_own(self, identity: str, det: Det) -> bool:
        """Whether a DET is one of the configured key of an identity. This computes a hash."""
        key = self._keys.get(identity)
        return key is not None and det.belongs_to(key)

    def note_owner(self, identity: str, det: Det) -> None:
        """Remember the DET that signed for an identity."""
        if identity in self._keys:
            self._owners[identity] = det

    def key_of(self, identity: str, utc_s: float) -> bytes | None:
        """The key of an identity; None if it is not known, or no longer endorsed."""
        key = self._keys.get(identity)
        if key is not None:
            return key
        det = det_of(identity)
        endorsement = None if det is None else self._learned.get(det)
        if det is None or endorsement is None or endorsement.not_after_utc_s < utc_s:
            return None
        self._learned.move_to_end(det)
        return endorsement.child_key

    def wants(self, endorsement: Endorsement) -> bool:
        """Whether an endorsement is news that an anchor may have signed."""
        return (
            endorsement.parent in self._anchors
            and self._learned.get(endorsement.child) != endorsement
            and endorsement.parent.may_endorse(endorsement.child)
        )

    def learn(self, endorsement: Endorsement) -> bool:
        """Learn the child's key if the endorsement is genuine. It must be wanted, and in its window."""
        key = self._anchors[endorsement.parent]
        if not endorsement.child.belongs_to(endorsement.child_key) or not endorsement.is_signed_by(key):
            return False
        held = self._learned.pop(endorsement.child, None)
        # A replay of an older endorsement must not shorten what a newer one granted.
        newer = held is None or held.not_after_utc_s <= endorsement.not_after_utc_s
        self._learned[endorsement.child] = endorsement if newer or held is None else held
        if len(self._learned) > _LEARNED_MAX:
            self._learned.popitem(last=False)
        return True


def _det(where: str, name: str) -> Det:
    try:
        return parse_det(name)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from error


def _key(where: str, text: str, det: Det | None) -> bytes:
    if not is_hex_key(text):
        raise ConfigError(f"{where}: {text!r}: an Ed25519 public key is 64 hex digits")
    key = bytes.fromhex(text)
    if det is not None and not det.belongs_to(key):
        raise ConfigError(f"{where}: {text}: this is not the key of {det}")
    return key


def _checked(where: str, name: str) -> str:
    """The name of an identity, if a Basic ID can hold it."""
    data = name.encode("latin-1", errors="replace")
    if not name or len(data) > _ID_SIZE or data.decode("latin-1") != name:
        raise ConfigError(f"{where}: identity is {name!r}; allowed: 1 to {_ID_SIZE} Latin-1 characters")
    return name
