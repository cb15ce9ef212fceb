"""Verifies what others sign by DRIP (RFC 9575), within a budget of processor time.

A signature proves whose message it is, never that the message is true: a signed liar is judged like any
other. It proves an identity for a track only together with a Location that this receiver itself heard
(section 6.4.2), because a Location changes and cannot be known in advance. The Location is found by its hash
(Manifest) or its content (Wrapper) among those that came lately from the same radio address.

Messages are encoded again for this, because only decoded ones are kept. A Location of protocol version 2
without reserved bits gives the same bytes; of other senders nothing is proven.

Replays: the RFC leaves the validity window (VNB to VNA, two minutes or more) to the sender. Here evidence
also counts only for `FRESH_S` after its VNB, never if it is older than the last evidence from the same
address, and only from the address from which it was heard first.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from companion.errors import PeerDataError
from companion.events import RemoteIdHeard
from companion.remote_id.authentication import SPECIFIC_METHOD, AuthenticationData
from companion.remote_id.codec import encode, encode_pack
from companion.remote_id.drip.det import det_of
from companion.remote_id.drip.evidence import (
    FRAME,
    LINK,
    MANIFEST,
    Evidence,
    decode_evidence,
    read_manifest,
    read_wrapper,
)
from companion.remote_id.drip.hashes import message_hash
from companion.remote_id.drip.link import decode_link
from companion.remote_id.drip.trust import Trust
from companion.remote_id.messages import Authentication, Location, Message
from companion.remote_id.transports import BLE4
from companion.traffic.senders.source import Reported, Source
from companion.traffic.track import Track

FRESH_S: Final = 10.0
"""Longest time from the VNB of evidence until it arrives, and from then for which its track is proven."""
_AHEAD_S: Final = 5.0
"""How far a VNB may lie in our future. It is a whole second, and clocks differ."""
_VOUCHED_S: Final = 60.0
"""For this long after its last valid signature, a source uses the budget of checks for sources that have
signed."""
_CHECKS_PER_S: Final = 25.0
"""Signatures checked per second, for unknown sources and as many for sources that have signed before."""
_PROVEN_MOST: Final = 1024
"""Valid signatures that are remembered: more than can be checked while they are fresh."""
_SOURCE_CHECKS_PER_S: Final = 3.0
"""Largest number of checks of one source per second, and largest number that it can save up."""


class Verdict(enum.Enum):
    """Result of judging one Authentication. The value is a text for reports."""

    VALID = "valid"
    WRONG = "the signature is wrong: altered, or made with another key"
    FOREIGN = "signed by another DRIP entity tag than that of the identity"
    REPLAYED = "older than allowed, or than the last one: replayed"
    EXPIRED = "no longer valid"
    EARLY = "not yet valid"
    INCOMPLETE = "a page is missing"
    UNKNOWN_KEY = "the key of the identity is not known"
    NOTHING_HEARD = "covers no Location that was heard"
    POSTPONED = "not checked: more signatures than are checked per second"


@dataclass(slots=True)
class _Bucket:
    """Number of checks that may be made now; it grows with time."""

    left: float = _CHECKS_PER_S
    filled_s: float = -math.inf


class Signatures:
    """Judges the Authentication of all sources."""

    def __init__(self, trust: Trust) -> None:
        self.trust = trust
        self.counts: Counter[Verdict] = Counter()
        self._buckets = (_Bucket(), _Bucket())
        self._proven_by: OrderedDict[bytes, str] = OrderedDict()
        """Radio address of each recently valid signature. The same signature from another address is a
        replay."""

    def is_vouched(self, source: Source, now_s: float) -> bool:
        """Whether a source has signed lately."""
        return now_s - source.vouched_s <= _VOUCHED_S

    def heard(self, source: Source, heard: RemoteIdHeard, tracks: Sequence[Track]) -> None:
        """Remember a frame with Locations.

        Args:
            tracks: those that its Locations fed.
        """
        source.reported.append(Reported(heard.transport, heard.messages, tuple(tracks)))

    def judge(
        self,
        source: Source,
        data: AuthenticationData,
        heard: RemoteIdHeard,
        now_s: float,
        utc_s: float | None,
    ) -> tuple[Verdict | None, Sequence[Track]]:
        """Judge one Authentication that arrived whole.

        Args:
            heard: the frame that completed it, already remembered by `heard`.
            utc_s: our UTC; None while unknown. Nothing can be judged then.

        Returns:
            The verdict (None where there is nothing to judge) and the tracks whose identity it proves.
        """
        if data.auth_type != SPECIFIC_METHOD or utc_s is None or not data.data:
            return None, ()
        tracks: Sequence[Track] = ()
        if data.data[0] == LINK:
            verdict = self._link(source, data.data, now_s, utc_s)
        elif data.data[0] != FRAME and source.identity is not None and self.trust.judges(source.identity):
            verdict, tracks = self._evidence(source, source.identity, data.data, heard, now_s, utc_s)
        else:
            return None, ()
        if verdict is Verdict.WRONG and not data.consistent:
            verdict = Verdict.INCOMPLETE
        if verdict is not None:
            self.counts[verdict] += 1
        return verdict, tracks

    def incomplete(self, source: Source) -> Verdict | None:
        """Judge an Authentication that ended without all of its pages."""
        if source.identity is None or not self.trust.judges(source.identity):
            return None
        self.counts[Verdict.INCOMPLETE] += 1
        return Verdict.INCOMPLETE

    # ------------------------------------------------------------ one Authentication

    def _link(self, source: Source, data: bytes, now_s: float, utc_s: float) -> Verdict | None:
        try:
            endorsement = decode_link(data)
        except PeerDataError:
            return None
        if not self.trust.wants(endorsement):
            return None
        if endorsement.not_after_utc_s < utc_s:
            return Verdict.EXPIRED
        if endorsement.not_before_utc_s > utc_s + _AHEAD_S:
            return Verdict.EARLY
        if not self._may_check(source, now_s):
            return Verdict.POSTPONED
        return Verdict.VALID if self.trust.learn(endorsement) else Verdict.WRONG

    def _evidence(
        self, source: Source, identity: str, data: bytes, heard: RemoteIdHeard, now_s: float, utc_s: float
    ) -> tuple[Verdict | None, Sequence[Track]]:
        try:
            evidence = decode_evidence(data)
        except PeerDataError:
            return Verdict.WRONG, ()
        refused = self._refusal(source, evidence, utc_s)
        if refused is not None:
            return refused, ()
        known = self.trust.owner(identity) == evidence.det
        if not known and det_of(identity) is not None:
            return Verdict.FOREIGN, ()
        key = self.trust.key_of(identity, utc_s)
        if key is None:
            return Verdict.UNKNOWN_KEY, ()
        if data == source.last_signed:
            return None, ()
        if not self._may_check(source, now_s):
            return Verdict.POSTPONED, ()
        if not known and not self.trust.may_own(identity, evidence.det):
            return Verdict.FOREIGN, ()
        try:
            content, covered = _covered(source, evidence, heard)
        except (PeerDataError, ValueError):
            return Verdict.WRONG, ()
        if not evidence.is_signed_by(key, content):
            return Verdict.WRONG, ()
        self.trust.note_owner(identity, evidence.det)
        source.last_signed = data
        source.signed_utc_s = float(evidence.not_before_utc_s)
        if not covered:
            return Verdict.NOTHING_HEARD, ()
        source.vouched_s = now_s
        self._proven_by[evidence.signature] = source.key
        if len(self._proven_by) > _PROVEN_MOST:
            self._proven_by.popitem(last=False)
        return Verdict.VALID, covered

    def _refusal(self, source: Source, evidence: Evidence, utc_s: float) -> Verdict | None:
        """Why evidence is refused for its times; None if it is not."""
        if evidence.not_after_utc_s < utc_s:
            return Verdict.EXPIRED
        begin = evidence.not_before_utc_s
        if begin > utc_s + _AHEAD_S:
            return Verdict.EARLY
        # A signature dated ahead of now was accepted while our clock led. It does not make others count as
        # old.
        older = begin < source.signed_utc_s <= utc_s + _AHEAD_S
        elsewhere = self._proven_by.get(evidence.signature, source.key) != source.key
        return Verdict.REPLAYED if utc_s - begin > FRESH_S or older or elsewhere else None

    def _may_check(self, source: Source, now_s: float) -> bool:
        """Take one check from the budget of the source and of its kind, if both have any."""
        bucket = self._buckets[self.is_vouched(source, now_s)]
        rise = max(0.0, now_s - bucket.filled_s) * _CHECKS_PER_S
        bucket.left, bucket.filled_s = min(_CHECKS_PER_S, bucket.left + rise), now_s
        rise = max(0.0, now_s - source.checks_s) * _SOURCE_CHECKS_PER_S
        source.checks, source.checks_s = min(_SOURCE_CHECKS_PER_S, source.checks + rise), now_s
        if bucket.left < 1.0 or source.checks < 1.0:
            return False
        bucket.left -= 1.0
        source.checks -= 1.0
        return True


def _covered(source: Source, evidence: Evidence, heard: RemoteIdHeard) -> tuple[bytes, list[Track]]:
    """The evidence that was signed, and the tracks of the Locations that it covers.

    Raises:
        PeerDataError: the evidence has a wrong form.
        ValueError: the pack holds a message that cannot be encoded.
    """
    content = evidence.content
    if evidence.sam_type == MANIFEST:
        hashes = frozenset(read_manifest(content).messages)
        found = [track for report in source.reported if _hash(report) in hashes for track in report.tracks]
        return content, found
    wrapped = frozenset(read_wrapper(content))
    if wrapped:
        found = [
            track for report in source.reported for track in report.tracks if wrapped & _locations(report)
        ]
        return content, found
    others = [message for message in heard.messages if type(message) is not Authentication]
    encoded = sorted(map(encode, others), key=lambda message: message[0] >> 4)
    last = source.reported[-1] if source.reported else None
    mine = last is not None and last.messages is heard.messages
    return b"".join(encoded), list(last.tracks) if last is not None and mine else []


def _hash(report: Reported) -> bytes | None:
    """Hash of a remembered frame as its sender's Manifest names it: of the Location (BLE 4) or the pack."""
    if report.hash is None:
        try:
            report.hash = message_hash(_encoded(report.transport, report.messages))
        except ValueError:
            report.hash = b""
    return report.hash


def _encoded(transport: str, messages: tuple[Message, ...]) -> bytes:
    return encode(messages[0]) if transport == BLE4 else encode_pack(messages)


def _locations(report: Reported) -> frozenset[bytes]:
    try:
        return frozenset(encode(message) for message in report.messages if type(message) is Location)
    except ValueError:
        return frozenset()
