"""Signs our own broadcasts by DRIP (RFC 9575): Manifests over what was sent, and Links of our registry.

The signer adds broadcasts and changes none, so the region's legal minimum is kept as without it. It runs
after the core, so that the record of a flight holds no signatures and a replay needs no key.

- BLE 4: every page is a frame of its own, one every `PAGE_GAP_S` at most, with a parity page (section 6.1).
- BLE 5 and Wi-Fi: an additional pack with the Basic ID and Location last sent and the pages, without parity
  (section 6.2). It holds the Location because a beacon stays on the air until the next one replaces it.

A Manifest is sent every `period_s` (section 6.3: at least every 5 s), a Link every `LINK_PERIOD_S`. Every
second Link is that of our own DET (required: at least once a minute). The Links of its parents take turns in
between (required: at least every 5 minutes).
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from companion.events import Broadcast
from companion.remote_id.authentication import SPECIFIC_METHOD, AuthenticationData, split
from companion.remote_id.codec import PACK_MAX_MESSAGES, encode, encode_pack
from companion.remote_id.drip.det import Det
from companion.remote_id.drip.evidence import HASHES_ADVISED, MANIFEST, NO_HASH, manifest_content, sign
from companion.remote_id.drip.hashes import HASH_SIZE, message_hash
from companion.remote_id.drip.link import Endorsement
from companion.remote_id.drip.times import EPOCH_S
from companion.remote_id.messages import Authentication, BasicId, Location, Message
from companion.remote_id.transports import BLE4

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

LINK_PERIOD_S: Final = 10.0
PAGE_GAP_S: Final = 0.15
"""Least time between two pages on BLE 4."""
VALID_S: Final = 120
"""Validity of a signature: time from VNB to VNA (section 3.2.4.3)."""
_UTC_S: Final = (EPOCH_S + 1.0, EPOCH_S + 2.0**32 - VALID_S - 2.0)
"""Earliest and latest UTC (Unix seconds) at which something is signed."""
MAX_LINKS: Final = 5
"""Largest number of Links. The apex, RAA, HDA and we need no more, and this many keep their periods."""
_PACKS_HASHED: Final = 5
"""Number of hashes in a Manifest that is sent in a pack. Five hashes take seven pages, which fill the pack
together with Basic ID and Location."""
_ON_AIR_S: Final = 2.0
"""A transport on which no Location was sent for longer than this is not in use."""
_REPEATED_S: Final = 0.9
"""How long packs repeat a Location, also on a transport that was given up. Regions allow an age of 1 s, and a
timestamp is up to 0.1 s old when it is first sent."""


@dataclass(slots=True)
class _Lane:
    """What was sent on one transport, and what is due on it."""

    previous: bytes
    manifest_s: float
    """Time at which the next Manifest is due."""
    link_s: float
    links: Iterator[bytes]
    sent: dict[bytes, bool] = field(default_factory=dict)
    """Messages (BLE 4) or packs since the last Manifest, and whether each is a Location; the newest last."""
    last: dict[type[Message], Message] = field(default_factory=dict)
    pages: deque[Authentication] = field(default_factory=deque)
    """Pages that wait on BLE 4."""
    page_s: float = -math.inf
    location_s: float = -math.inf


class Signer:
    """Signs the broadcasts of one aircraft.

    Args:
        key: private key of `det`.
        links: endorsements, our own first, then those of its parents; at most `MAX_LINKS`.
        period_s: time between two Manifests.
        nonce: eight random bytes, the hash before the first Manifest (section 4.4.3).

    Raises:
        ValueError: the first link is not that of `det`, or there are too many.
    """

    def __init__(
        self,
        key: Ed25519PrivateKey,
        det: Det,
        links: Sequence[Endorsement] = (),
        period_s: float = 2.0,
        nonce: bytes = NO_HASH,
    ) -> None:
        if len(nonce) != HASH_SIZE:
            raise ValueError(f"nonce of {len(nonce)} bytes; allowed: {HASH_SIZE}")
        if len(links) > MAX_LINKS:
            raise ValueError(f"{len(links)} links; allowed: up to {MAX_LINKS}")
        if links and links[0].child != det:
            raise ValueError(f"the first link endorses {links[0].child}, not our own {det}")
        self.det = det
        self.signed = 0
        """Number of Manifests signed."""
        self._key = key
        self._links = [link.link() for link in links]
        self._link_hash = links[0].hash() if links else NO_HASH
        self._period_s = period_s
        self._nonce = nonce
        self._lanes: dict[str, _Lane] = {}

    def add(self, broadcasts: Iterable[Broadcast], now_s: float, utc_s: float | None) -> list[Broadcast]:
        """Return the broadcasts of this step, followed by those that sign earlier ones.

        Args:
            broadcasts: what the core sends in this step; it comes first and unchanged.
            now_s: monotonic time, not before the last call's.
            utc_s: UTC; None while unknown. Nothing is signed then, nor at a time that the format cannot
                hold: a vehicle's clock may be years off.
        """
        if utc_s is not None and not _UTC_S[0] <= utc_s <= _UTC_S[1]:
            utc_s = None
        out = list(broadcasts)
        for broadcast in list(out):
            self._note(broadcast, now_s)
        for transport, lane in self._lanes.items():
            if now_s - lane.location_s > _ON_AIR_S:
                lane.pages.clear()
                lane.sent.clear()
                continue
            in_time = transport == BLE4 or now_s - lane.location_s <= _REPEATED_S
            if utc_s is not None and in_time and not lane.pages:
                data = self._due(transport, lane, now_s, utc_s)
                if data is not None:
                    out += self._paged(
                        transport, lane, AuthenticationData(SPECIFIC_METHOD, float(int(utc_s)), data)
                    )
            if lane.pages and now_s - lane.page_s >= PAGE_GAP_S:
                lane.page_s = now_s
                out.append(Broadcast(transport=transport, messages=(lane.pages.popleft(),)))
        return out

    def _note(self, broadcast: Broadcast, now_s: float) -> None:
        """Remember what a Manifest is to cover."""
        transport, messages = broadcast.transport, broadcast.messages
        lane = self._lanes.get(transport)
        if lane is None:
            lane = self._lanes[transport] = _Lane(self._nonce, now_s, now_s, self._turns())
        for message in messages:
            # Of two Basic IDs, receivers identify us by the first.
            if not (
                type(message) is BasicId and message is not next(m for m in messages if type(m) is BasicId)
            ):
                lane.last[type(message)] = message
        has_location = any(type(message) is Location for message in messages)
        if has_location:
            lane.location_s = now_s
        try:
            if transport == BLE4:
                parts = [(encode(message), type(message) is Location) for message in messages]
            else:
                parts = [(encode_pack(messages[:PACK_MAX_MESSAGES]), has_location)]
        except ValueError:
            return  # the radio refuses it as well, and says so
        for part, is_location in parts:
            lane.sent.pop(part, None)
            lane.sent[part] = is_location
        while len(lane.sent) > 4 * HASHES_ADVISED:
            del lane.sent[next(iter(lane.sent))]

    def _turns(self) -> Iterator[bytes]:
        """Yield our own Link and one of the others in turn, without end."""
        own, others = self._links[:1], self._links[1:]
        turns = [link for other in others for link in (*own, other)] or own
        return itertools.cycle(turns)

    def _due(self, transport: str, lane: _Lane, now_s: float, utc_s: float) -> bytes | None:
        """The next DRIP data of a transport, if any is due."""
        if now_s >= lane.manifest_s and any(lane.sent.values()):
            lane.manifest_s = now_s + self._period_s
            return self._manifest(transport, lane, utc_s)
        if self._links and now_s >= lane.link_s:
            lane.link_s = now_s + LINK_PERIOD_S
            return next(lane.links)
        return None

    def _manifest(self, transport: str, lane: _Lane, utc_s: float) -> bytes:
        covered = _chosen(lane.sent, HASHES_ADVISED if transport == BLE4 else _PACKS_HASHED)
        lane.sent.clear()
        content = manifest_content(lane.previous, self._link_hash, [message_hash(part) for part in covered])
        lane.previous = content[HASH_SIZE : 2 * HASH_SIZE]
        self.signed += 1
        begin = math.ceil(utc_s)  # not before the time of signing
        return sign(self._key, self.det, MANIFEST, content, begin, begin + VALID_S).encode()

    def _paged(self, transport: str, lane: _Lane, data: AuthenticationData) -> list[Broadcast]:
        """Queue the pages (BLE 4), or return the pack that holds them."""
        if transport == BLE4:
            lane.pages += split(data, parity=True)
            return []
        pages = split(data)
        room = PACK_MAX_MESSAGES - len(pages)
        beside = [lane.last[kind] for kind in (BasicId, Location) if kind in lane.last][:room]
        return [Broadcast(transport=transport, messages=(*beside, *pages))]


def _chosen(sent: dict[bytes, bool], most: int) -> list[bytes]:
    """The newest sent messages for a Manifest, in order. At most half of them are other than Locations.

    Args:
        most: largest number of messages.
    """
    others = [part for part, is_location in sent.items() if not is_location][-(most // 2) :]
    locations = [part for part, is_location in sent.items() if is_location][len(others) - most :]
    kept = {*others, *locations}
    return [part for part in sent if part in kept]
