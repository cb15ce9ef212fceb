"""Plausibility flags of received aircraft, with evidence for and against each.

Flags inform the log and the pilot. They never remove an aircraft from the law: a doubtful aircraft is avoided
like any other. A flag is raised after enough evidence and cleared after enough sound messages. What a sender
is free to do (turn, stop, be silent for a while, use several radios, declare nothing) is no evidence.
"""

from __future__ import annotations

import enum
import math
from collections import OrderedDict
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from companion.events import TrackFlagged
from companion.remote_id.messages import Location, Status
from companion.traffic.fix import ALTITUDES_M, Fix


class Flag(enum.StrEnum):
    """What is doubtful about a track, or confirmed (SIGNED)."""

    DUPLICATE_IDENTITY = "duplicate_identity"
    JUMP = "jump"
    STALE_TIMESTAMP = "stale_timestamp"
    FUTURE_TIMESTAMP = "future_timestamp"
    NO_TIMESTAMP = "no_timestamp"
    VELOCITY_MISMATCH = "velocity_mismatch"
    IMPOSSIBLE_VALUES = "impossible_values"
    SIGNAL_MISMATCH = "signal_mismatch"
    REMOTE_ID_FAILURE = "remote_id_failure"
    EMERGENCY = "emergency"
    SIGNED = "signed"
    UNSIGNED = "unsigned"
    BAD_SIGNATURE = "bad_signature"
    FOREIGN_SIGNATURE = "foreign_signature"
    REPLAYED_SIGNATURE = "replayed_signature"
    INCOMPLETE_SIGNATURE = "incomplete_signature"


class Rule(NamedTuple):
    """When a flag is raised, when it is cleared, and its text in the log."""

    raise_at: int
    """Evidence at which the flag is raised."""
    most: int
    """Largest evidence that is counted. This many sound messages in a row always clear the flag."""
    text: str


RULES: Final[dict[Flag, Rule]] = {
    Flag.DUPLICATE_IDENTITY: Rule(
        4, 10, "its identity is heard from two places too far apart for one aircraft"
    ),
    Flag.JUMP: Rule(3, 10, "its position jumped farther than an aircraft can fly"),
    Flag.STALE_TIMESTAMP: Rule(5, 8, "its timestamps are older than allowed when they arrive"),
    Flag.FUTURE_TIMESTAMP: Rule(3, 6, "its timestamps lie in the future: its clock leads, or ours lags"),
    Flag.NO_TIMESTAMP: Rule(3, 6, "its messages carry no timestamp"),
    Flag.VELOCITY_MISMATCH: Rule(2, 3, "its positions do not follow the velocity that it reports"),
    Flag.IMPOSSIBLE_VALUES: Rule(2, 6, "it reports an impossible speed, position or altitude"),
    Flag.SIGNAL_MISMATCH: Rule(1, 1, "its signal strength contradicts the positions that it reports"),
    Flag.REMOTE_ID_FAILURE: Rule(1, 3, "it reports a failure of its Remote ID system"),
    Flag.EMERGENCY: Rule(1, 3, "it reports an emergency"),
    Flag.SIGNED: Rule(1, 1, "a fresh signature proves its identity"),
    Flag.UNSIGNED: Rule(3, 3, "its key is known, but no fresh signature of it is heard"),
    Flag.BAD_SIGNATURE: Rule(2, 6, "it sends signatures that are wrong: altered, or made with another key"),
    Flag.FOREIGN_SIGNATURE: Rule(2, 6, "it sends signatures of another DRIP entity tag than its own"),
    Flag.REPLAYED_SIGNATURE: Rule(2, 6, "it sends signatures that are replayed, or dated wrongly"),
    Flag.INCOMPLETE_SIGNATURE: Rule(3, 3, "its signatures arrive with missing pages"),
}

MESSAGE_FLAGS: Final = frozenset(
    (
        Flag.JUMP,
        Flag.STALE_TIMESTAMP,
        Flag.FUTURE_TIMESTAMP,
        Flag.NO_TIMESTAMP,
        Flag.IMPOSSIBLE_VALUES,
        Flag.REMOTE_ID_FAILURE,
        Flag.EMERGENCY,
    )
)
"""Flags that every new message is evidence for or against."""
UNTRUSTED: Final = frozenset(
    (
        Flag.DUPLICATE_IDENTITY,
        Flag.JUMP,
        Flag.VELOCITY_MISMATCH,
        Flag.IMPOSSIBLE_VALUES,
        Flag.SIGNAL_MISMATCH,
        Flag.BAD_SIGNATURE,
    )
)
"""Flags that end the trust in a track: it is not proven, and in a full table it counts as one that was heard
only a few times. It is avoided as before."""
_STATUS_FLAG: Final = {
    Status.EMERGENCY: Flag.EMERGENCY,
    Status.REMOTE_ID_SYSTEM_FAILURE: Flag.REMOTE_ID_FAILURE,
}

STALE_S: Final = 2.0
"""Age from which a timestamp is stale. A position may be 1 s old when sent (F3411-22a, every region) and is
repeated for up to 1 s more."""
FUTURE_S: Final = 0.5
"""How far a timestamp may lie in our future, in addition to its declared accuracy. Our own clock is accurate
to some tenths of a second."""
_VERTICAL_MPS: Final = 62.0
"""Greatest vertical speed that a message can express."""
_ACCURACY_UNKNOWN_M: Final = 10.0
_VERTICAL_UNKNOWN_M: Final = 25.0


@dataclass(slots=True)
class Doubts:
    """Evidence about one track, and the flags raised by it."""

    evidence: dict[Flag, int] = field(default_factory=dict)
    """Evidence for each flag that has any; a sound track needs no entries."""
    flags: set[Flag] = field(default_factory=set)
    reported: set[Flag] = field(default_factory=set)

    def judge(self, bad: Collection[Flag], judged: Collection[Flag]) -> bool:
        """Count the evidence of one message.

        Args:
            bad: flags that the message is evidence for.
            judged: flags that the message is evidence against, unless they are in `bad`.

        Returns:
            Whether the flags differ from those last reported.
        """
        if not bad and not self.evidence:
            return False
        for flag in [f for f in self.evidence if f in judged and f not in bad]:
            self.add(flag, -1)
        for flag in bad:
            self.add(flag, 1)
        return self.flags != self.reported

    def add(self, flag: Flag, weight: int) -> None:
        """Count evidence for a flag, or against it if `weight` is negative."""
        rule = RULES[flag]
        count = min(self.evidence.get(flag, 0) + weight, rule.most)
        if count <= 0:
            self.evidence.pop(flag, None)
            self.flags.discard(flag)
            return
        self.evidence[flag] = count
        if count >= rule.raise_at:
            self.flags.add(flag)


def message_doubts(fix: Fix) -> list[Flag]:
    """Flags for which one message by itself is evidence."""
    content, lead_s = fix.content, fix.lead_s
    bad = []
    status_flag = _STATUS_FLAG.get(content.status)
    if status_flag is not None:
        bad.append(status_flag)
    if content.timestamp_s is None:
        bad.append(Flag.NO_TIMESTAMP)
    elif lead_s is not None:
        if lead_s < -STALE_S:
            bad.append(Flag.STALE_TIMESTAMP)
        elif lead_s > FUTURE_S + (content.timestamp_accuracy_s or 0.0):
            bad.append(Flag.FUTURE_TIMESTAMP)
    altitude = content.alt_geodetic_m
    impossible = altitude is not None and not ALTITUDES_M[0] <= altitude <= ALTITUDES_M[1]
    if impossible or fix.too_fast:
        bad.append(Flag.IMPOSSIBLE_VALUES)
    return bad


def status_doubts(content: Location) -> list[Flag]:
    """Flags for which a message without a usable position is evidence."""
    status_flag = _STATUS_FLAG.get(content.status)
    return [] if status_flag is None else [status_flag]


def climbs_impossibly(before: Location, after: Location, elapsed_s: float) -> bool:
    """Whether the altitude changed more than any climb or dive explains."""
    if before.alt_geodetic_m is None or after.alt_geodetic_m is None:
        return False
    noise = 3.0 * (
        (before.vertical_accuracy_m or _VERTICAL_UNKNOWN_M)
        + (after.vertical_accuracy_m or _VERTICAL_UNKNOWN_M)
    )
    return abs(after.alt_geodetic_m - before.alt_geodetic_m) > noise + _VERTICAL_MPS * (abs(elapsed_s) + 0.5)


def noise_m(content: Location) -> float:
    """Horizontal error that the sender declares, without an upper limit; a default if it declares none."""
    return content.horizontal_accuracy_m or _ACCURACY_UNKNOWN_M


@dataclass(slots=True)
class MotionWindow:
    """Compares the positions of some seconds with the velocities reported in that time.

    The displacement by the velocities is integrated with the trapezoidal rule. Between two messages `dt`
    apart, an aircraft with acceleration up to `a` can end at most a dt^2 / 4 away from the trapezoidal result
    (full acceleration in one direction for half of the time, then in the opposite one), for any velocities at
    both ends.
    """

    last: Fix
    received_s: float
    start: Fix | None = None
    span_s: float = 0.0
    north_m: float = 0.0
    east_m: float = 0.0
    slack_m: float = 0.0
    moved_mps: tuple[float, float] = (0.0, 0.0)
    """Velocity (north, east) that the positions showed in the last window that disagreed."""

    def check(self, fix: Fix, now_s: float) -> bool | None:
        """Add the next fix. At the end of a window, return whether positions and velocities disagree; else
        None."""
        before, v0, v1 = self.last, self.last.velocity, fix.velocity
        if before.stamp_s is not None and fix.stamp_s is not None:
            dt, jitter_s = fix.stamp_s - before.stamp_s, _JITTER_S
        else:
            dt, jitter_s = now_s - self.received_s, _RECEPTION_JITTER_S
        if dt == 0.0:
            return None
        self.last, self.received_s = fix, now_s
        if v0 is None or v1 is None or not 0.0 < dt <= _GAP_S:
            self.start = None
            return None
        if self.start is None:
            self.start = before
            self.span_s = self.north_m = self.east_m = self.slack_m = 0.0
        self.span_s += dt
        self.north_m += 0.5 * dt * (v0[0] + v1[0])
        self.east_m += 0.5 * dt * (v0[1] + v1[1])
        self.slack_m += dt * (
            0.25 * _MANOEUVRE_MPS2 * dt + (fix.content.speed_accuracy_mps or _SPEED_UNKNOWN_MPS)
        )
        if self.span_s < _WINDOW_S:
            return None
        start, self.start = self.start, None
        off = math.hypot(
            fix.position[0] - start.position[0] - self.north_m,
            fix.position[1] - start.position[1] - self.east_m,
        )
        speed = max(math.hypot(*(f.velocity or (0.0, 0.0))[:2]) for f in (start, fix))
        allowed = self.slack_m + _NOISES * (noise_m(start.content) + noise_m(fix.content)) + speed * jitter_s
        if off <= allowed + _QUANTUM * math.hypot(self.north_m, self.east_m):
            return False
        self.moved_mps = (
            (fix.position[0] - start.position[0]) / self.span_s,
            (fix.position[1] - start.position[1]) / self.span_s,
        )
        return True


_WINDOW_S: Final = 5.0
_GAP_S: Final = 5.0
"""Longest time between two messages of a window; after a longer silence the aircraft may be anywhere."""
_MANOEUVRE_MPS2: Final = 10.0
_SPEED_UNKNOWN_MPS: Final = 3.0
_NOISES: Final = 3.0
_JITTER_S: Final = 0.5
"""Time error between messages with timestamps: they are in tenths of a second, and position and velocity are
not of exactly the same moment."""
_RECEPTION_JITTER_S: Final = 2.0
_QUANTUM: Final = 0.02
"""Error relative to the displacement, because directions are in whole degrees."""


@dataclass(slots=True)
class Drift:
    """Compares positions of ADS-B with the velocities reported meanwhile, by the rule of `MotionWindow`, and
    finds the error of the velocities. It has two axes.

    If the positions of two windows in succession leave what the velocities say at nearly the same speed, that
    speed is the error. Positions or velocities that contradict each other show nothing: one report from
    another place makes two windows that differ.

    Args:
        noise_m: distance by which noise may move two positions apart.
        noise_mps: error of each velocity, one standard deviation.
    """

    noise_m: float
    noise_mps: float
    error_mps: tuple[float, float] = (0.0, 0.0)
    """What to add to a reported velocity."""
    suspected_mps: tuple[float, float] = (0.0, 0.0)
    """The same by the last window alone."""
    span_s: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    slack_m: float = 0.0

    @property
    def found(self) -> bool:
        """Whether the reported velocity is wrong."""
        return self.error_mps != (0.0, 0.0)

    def add(
        self,
        moved_m: tuple[float, float],
        before_mps: tuple[float, float],
        now_mps: tuple[float, float],
        passed_s: float,
    ) -> None:
        """Take in the next report.

        Args:
            moved_m: change of the position since the last one.
            before_mps, now_mps: velocities of both.
        """
        x_m = moved_m[0] - 0.5 * passed_s * (before_mps[0] + now_mps[0])
        y_m = moved_m[1] - 0.5 * passed_s * (before_mps[1] + now_mps[1])
        if passed_s > _GAP_S:
            # It shows no error, but may show that there is none any more.
            self._begin()
            if self._ends(x_m, y_m, passed_s):
                self.error_mps = self.suspected_mps = (0.0, 0.0)
            return
        if math.dist(before_mps, now_mps) > _TURN_MPS + _TURN_MPS2 * passed_s:
            # They are from two senders. Neither of them is corrected.
            self._begin()
            self.error_mps = self.suspected_mps = (0.0, 0.0)
            return
        self.span_s += passed_s
        self.x_m += x_m
        self.y_m += y_m
        self.slack_m += passed_s * (0.25 * _MANOEUVRE_MPS2 * passed_s + 2.0 * self.noise_mps)
        if self.span_s >= _LEAST_SPAN_S:
            self._look(max(math.hypot(*before_mps), math.hypot(*now_mps)))

    def _look(self, speed_mps: float) -> None:
        off_m = math.hypot(self.x_m, self.y_m)
        if self._ends(self.x_m, self.y_m, self.span_s):
            self.error_mps = self.suspected_mps = (0.0, 0.0)
        elif off_m > self.noise_m + self.slack_m + _AGES_S * speed_mps:
            error = self.x_m / self.span_s, self.y_m / self.span_s
            if math.dist(error, self.suspected_mps) <= 0.5 * math.hypot(*error):
                self.error_mps = error
            self.suspected_mps = error
        elif self.span_s >= _MOST_SPAN_S:
            self.suspected_mps = self.error_mps
        else:
            return
        self._begin()

    def _ends(self, x_m: float, y_m: float, span_s: float) -> bool:
        """Whether the positions fit the reported velocities better than the corrected ones."""
        x, y = self.error_mps
        return self.found and math.hypot(x_m, y_m) <= math.hypot(x_m - span_s * x, y_m - span_s * y)

    def _begin(self) -> None:
        self.span_s = self.x_m = self.y_m = self.slack_m = 0.0


_LEAST_SPAN_S: Final = 3.0
_MOST_SPAN_S: Final = 15.0
"""Length of a window. It ends as soon as the positions leave the velocities by more than noise explains."""
_AGES_S: Final = 1.0
"""Error of the time between two reports, whose ages are whole seconds."""
_TURN_MPS: Final = 10.0
_TURN_MPS2: Final = 20.0
"""Change of velocity that the reports of one aircraft may show."""


@dataclass(slots=True)
class Reports:
    """Changes of flags that wait to be logged. At most `REPORTS_PER_S` are released per second."""

    _changed: OrderedDict[str, Doubts] = field(default_factory=OrderedDict)
    _left: float = 0.0
    _filled_s: float = -math.inf

    def __len__(self) -> int:
        """Number of tracks with waiting changes."""
        return len(self._changed)

    def mark(self, track_id: str, doubts: Doubts) -> None:
        """Queue the changes of a track."""
        self._changed[track_id] = doubts

    def forget(self, track_id: str) -> None:
        """Drop the changes of a track that was removed."""
        self._changed.pop(track_id, None)

    def due(self, now_s: float) -> list[TrackFlagged]:
        """Changes that may be logged now, in the order in which tracks changed. A flag that was raised and
        cleared meanwhile is left out."""
        if not self._changed:
            return []
        rise = (now_s - self._filled_s) * REPORTS_PER_S
        self._left, self._filled_s = min(float(REPORTS_PER_S), self._left + rise), now_s
        items: list[TrackFlagged] = []
        while self._changed and self._left >= 1.0:
            track_id, doubts = next(iter(self._changed.items()))
            changes = sorted(doubts.flags ^ doubts.reported)
            for flag in changes[: int(self._left)]:
                raised = flag in doubts.flags
                (doubts.reported.add if raised else doubts.reported.discard)(flag)
                text = RULES[flag].text
                items.append(
                    TrackFlagged(
                        track_id=track_id, flag=flag.value, text=text if raised else f"no longer: {text}"
                    )
                )
                self._left -= 1.0
            if doubts.flags == doubts.reported:
                del self._changed[track_id]
        return items


REPORTS_PER_S: Final = 10
