"""Collects the evidence of each received message for and against the flags of its track.

`plausibility` judges what a single message or a single track shows. This module also uses the other tracks of
the same identity, the radio addresses and the signatures. Changed flags are reported to the log.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from companion.events import RemoteIdHeard
from companion.remote_id.authentication import AuthenticationData
from companion.traffic.fix import Fix
from companion.traffic.plausibility import (
    MESSAGE_FLAGS,
    Flag,
    Reports,
    climbs_impossibly,
    message_doubts,
)
from companion.traffic.senders.source import Source
from companion.traffic.signal_strength import MATCH, MISMATCH
from companion.traffic.signatures import FRESH_S, Signatures, Verdict
from companion.traffic.track import ESTABLISHED, Track, apart, beside

_TWIN_S = 5.0
"""Two tracks of one identity that are both received within this time count as two senders."""
_HOP = 2
_LEAP = 6
"""Evidence of a jump. `_HOP`: the first message at another place. `_LEAP`: the new track becomes established
there while the old one is silent."""
_TWIN_FLAG = (Flag.DUPLICATE_IDENTITY,)
_SIGNAL_FLAG = (Flag.SIGNAL_MISMATCH,)
_MOTION_FLAG = (Flag.VELOCITY_MISMATCH,)
_SIGNER_FLAGS = (Flag.SIGNED, Flag.UNSIGNED)
_VERDICT_FLAGS = {
    Verdict.WRONG: Flag.BAD_SIGNATURE,
    Verdict.FOREIGN: Flag.FOREIGN_SIGNATURE,
    Verdict.REPLAYED: Flag.REPLAYED_SIGNATURE,
    Verdict.EXPIRED: Flag.REPLAYED_SIGNATURE,
    Verdict.EARLY: Flag.REPLAYED_SIGNATURE,
    Verdict.INCOMPLETE: Flag.INCOMPLETE_SIGNATURE,
}
_SIGNATURE_FLAGS = frozenset(_VERDICT_FLAGS.values())
_NO_EVIDENCE = (Verdict.UNKNOWN_KEY, Verdict.NOTHING_HEARD, Verdict.POSTPONED)
"""Verdicts that neither speak for a sender nor against it."""


@dataclass(slots=True)
class Judge:
    """Raises and clears the flags of tracks."""

    own_uas_id: str
    tracks: Mapping[str, Track]
    verifier: Signatures | None
    """None if neither keys nor anchors are configured."""
    reports: Reports = field(default_factory=Reports)

    def note(self, track: Track, bad: Collection[Flag], judged: Collection[Flag] = ()) -> None:
        """Add evidence for the flags in `bad`, and against the others in `judged`."""
        if track.doubts.judge(bad, judged):
            self.reports.mark(track.track_id, track.doubts)

    def message(self, track: Track, known: Sequence[Track], fix: Fix, sample_s: float, now_s: float) -> None:
        """Judge the next message of a track, before the track is updated with it.

        Args:
            known: all tracks of its identity.
        """
        bad = message_doubts(fix)
        elapsed_s = max(sample_s - track.sample_s, now_s - track.received_s)
        if Flag.IMPOSSIBLE_VALUES not in bad and climbs_impossibly(track.content, fix.content, elapsed_s):
            bad.append(Flag.IMPOSSIBLE_VALUES)
        self.note(track, bad, MESSAGE_FLAGS)
        strays = track.motion.check(fix, now_s)
        if strays is not None:
            self.note(track, _MOTION_FLAG if strays else (), _MOTION_FLAG)
        if track.split_from is not None and track.messages + 1 >= ESTABLISHED:
            before = self.tracks.get(track.split_from)
            track.split_from = None
            if before is not None and before.received_s <= track.opened_s and track.leapt:
                self.note(track, (Flag.JUMP,) * _LEAP)
        if len(known) > 1 or track.doubts.evidence or track.identity == self.own_uas_id:
            self._twins(track, known, fix, now_s)

    def first_message(
        self, track: Track, known: Sequence[Track], source: Source, fix: Fix, now_s: float
    ) -> None:
        """Judge the first message of a new track. If its address also feeds another track, the aircraft may
        have jumped."""
        here = [t for t in known if t is not track and source.key in t.sources]
        before = max(here, key=lambda t: t.received_s, default=None)
        if before is not None:
            track.split_from, track.hypothesis = before.track_id, True
            track.leapt = apart(before, fix, now_s)
            track.inherit(here, fix, now_s)
        if track.leapt:
            earlier = max(t.doubts.evidence.get(Flag.JUMP, 0) for t in here)
            self.note(track, (Flag.JUMP,) * (earlier + _HOP))
        self.note(track, message_doubts(fix))

    def _twins(self, track: Track, known: Sequence[Track], fix: Fix, now_s: float) -> None:
        """Flag tracks of one identity that are received in turns: they are two senders, also if they share an
        address."""
        if track.identity == self.own_uas_id:
            self.note(track, _TWIN_FLAG)
            return
        live = [t for t in known if t is not track and now_s - t.received_s <= _TWIN_S]
        live = [t for t in live if apart(t, fix, now_s) or (_shares(t, track) and beside(t, fix, now_s))]
        turns = [t for t in live if t.received_s > track.received_s]
        for twin in (track, *turns) if turns else ():
            self.note(twin, _TWIN_FLAG)
        if not live:
            self.note(track, (), _TWIN_FLAG)

    def signal(self, track: Track, log_ratio: float) -> None:
        """Judge the signal strength of a track's messages by their log likelihood ratio against its
        positions."""
        if log_ratio > MISMATCH:
            self.note(track, _SIGNAL_FLAG)
        elif log_ratio < MATCH:
            self.note(track, (), _SIGNAL_FLAG)

    def proves(
        self,
        source: Source,
        tracks: Sequence[Track],
        whole: AuthenticationData | None,
        heard: RemoteIdHeard,
        now_s: float,
        utc_offset_s: float | None,
    ) -> None:
        """Judge the Authentication that a frame completed or ended.

        Args:
            tracks: those that the frame's address feeds; they are flagged.
            whole: what the frame completed; None if it ended a set of which pages are missing.
        """
        if self.verifier is None:
            return
        if whole is None:
            self._flag(tracks, self.verifier.incomplete(source))
            return
        utc_s = None if utc_offset_s is None else now_s + utc_offset_s
        verdict, proven = self.verifier.judge(source, whole, heard, now_s, utc_s)
        self._flag(tracks, verdict)
        for track in proven:
            track.vouched_s = now_s
            self.note(track, (Flag.SIGNED,), _SIGNER_FLAGS)

    def _flag(self, tracks: Sequence[Track], verdict: Verdict | None) -> None:
        if verdict is None or verdict in _NO_EVIDENCE:
            return
        flag = _VERDICT_FLAGS.get(verdict)
        for track in tracks:
            self.note(track, () if flag is None else (flag,), _SIGNATURE_FLAGS)

    def signer(self, track: Track, now_s: float, utc_known: bool) -> None:
        """Judge whether a track whose key is known is sent by the key's owner; called after each update."""
        if self.verifier is None or not self.verifier.trust.knows(track.identity):
            return
        bad: tuple[Flag, ...] = ()
        if now_s - track.vouched_s <= FRESH_S:
            bad = (Flag.SIGNED,)
        elif utc_known and now_s - track.opened_s > FRESH_S:
            bad = (Flag.UNSIGNED,)
        self.note(track, bad, _SIGNER_FLAGS)


def _shares(a: Track, b: Track) -> bool:
    """Whether one radio address feeds both tracks."""
    return any(key in b.sources for key in a.sources)
