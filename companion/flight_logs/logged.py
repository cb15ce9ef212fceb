"""Common parts of both log readers: putting events in order of time, and facts about the logged vehicle."""

from __future__ import annotations

import heapq
import math
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

from companion.autopilot.readers import UTC_RANGE_S
from companion.event_record import Step
from companion.events import (
    AdsbVehicle,
    AnyCommand,
    AnyEvent,
    GnssFix,
    Heartbeat,
    RemoteIdModule,
    VelocitySetpoint,
)

WINDOW_S = 1.0
"""Messages are written out of order by less than this. A DataFlash stamp that goes back farther is that of a
vehicle that restarted: the firmware stamps a message when it writes it, or with the sample that it holds.
Thirteen logs of ArduPilot's simulator (Copter 4.7-dev) have no stamp that goes back at all."""
JUMP_S = 60.0
"""A time stamp that is farther than this from the last one counts only if the next message confirms it."""
MOST_WAITING = 20_000
"""Most messages that wait for earlier ones. A log with more of them in `WINDOW_S` is damaged."""
WIND_PERIOD_S = 1.0
"""Least time between two kept estimates of the wind."""
EARLIEST_UTC_S = 1_325_376_000.0
"""The year 2012. Neither format existed before, so an earlier time is that of a receiver that does not know
UTC or that takes GPS time for one before a rollover of its 1024 weeks."""
FIX_3D = 3
"""GPS_FIX_TYPE from which on a position is three-dimensional."""
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")


def plain(text: str) -> str:
    """A logged text without trailing zeros and without the terminal colours that PX4 writes."""
    return _ESCAPES.sub("", text.partition("\0")[0]).strip()


@dataclass(slots=True)
class LogCounts:
    """What a reader of the format has met so far."""

    messages: int = 0
    """Whole messages, of all kinds."""
    damaged_spans: int = 0
    """Number of places where bytes had to be skipped to find the next message."""
    damaged_bytes: int = 0
    torn_bytes: int = 0
    """Bytes at the end that are no whole message."""
    dropouts: int = 0
    """Number of places where the autopilot itself could not write (ULog)."""
    dropouts_s: float = 0.0
    bad_values: int = 0
    """Messages with impossible values or time stamps; they are left out."""
    restarts: int = 0
    """Number of times that the vehicle's clock started again."""


@dataclass(slots=True)
class About:
    """What has been found out about the vehicle. It is complete when the steps have been read to the end."""

    kind: str = ""
    """The log's format in words."""
    system_id: int = 1
    firmware: str = ""
    """The firmware with its version, as far as the log tells."""
    position_from: str = ""
    """The messages whose positions are shown; empty if there are none."""
    first_m: float | None = None
    """Altitude of the first position, if that stands for home because home is not logged."""
    has_fix: bool = False
    """Whether there was a three-dimensional GNSS fix."""
    other_setpoints: int = 0
    """Number of setpoints that are not a velocity in north, east, down."""
    wind: array[float] = field(default_factory=lambda: array("d"))
    """Rows of time (s), and the wind towards north and east (m/s), about one a second."""
    seen: set[type] = field(default_factory=set)
    """Types of the events and commands."""
    modes: dict[int, Heartbeat] = field(default_factory=dict)
    """The first heartbeat of each flight mode, by its number."""
    counts: LogCounts = field(default_factory=LogCounts)

    def blown(self, time_s: float, north_mps: float, east_mps: float) -> None:
        """Note an estimate of the wind, unless it is exactly zero, which stands for no estimate."""
        if not (math.isfinite(north_mps) and math.isfinite(east_mps)) or (north_mps == east_mps == 0.0):
            return
        if not self.wind or time_s - self.wind[-3] >= WIND_PERIOD_S:
            self.wind.extend((time_s, north_mps, east_mps))

    def home(self, known_m: float | None, alt_msl_m: float) -> float:
        """Altitude of home (m); as long as it is not known, that of the first position."""
        if known_m is not None:
            return known_m
        if self.first_m is None:
            self.first_m = alt_msl_m
        return self.first_m

    def missing(self) -> tuple[str, ...]:
        """What the log does not contain, in words."""
        found = []
        if not self.modes:
            found.append("flight modes")
        if not self.position_from:
            found.append("position")
        if self.first_m is not None:
            found.append("home from the beginning (until then heights are above the first position)")
        if not self.has_fix:
            found.append("GNSS fix" if GnssFix not in self.seen else "three-dimensional GNSS fix")
        if not self.wind:
            found.append("wind")
        if VelocitySetpoint not in self.seen:
            others = f" ({self.other_setpoints} of other kinds)" if self.other_setpoints else ""
            found.append(f"velocity setpoints{others}")
        if AdsbVehicle not in self.seen:
            found.append("ADS-B traffic")
        found.append("Remote ID of others")
        if RemoteIdModule not in self.seen:
            found.append("own Remote ID")
        return (*found, "a companion's decisions")

    def damage(self, name: str) -> tuple[str, ...]:
        """What is damaged, one line each."""
        counts, found = self.counts, []
        if counts.damaged_spans:
            found.append(
                f"{name}: {counts.damaged_spans} damaged spans ({counts.damaged_bytes} bytes) were skipped"
            )
        if counts.torn_bytes:
            found.append(
                f"{name}: the file is cut off; its last {counts.torn_bytes} bytes are not a whole message"
            )
        if counts.dropouts:
            times = "once" if counts.dropouts == 1 else f"{counts.dropouts} times"
            found.append(
                f"{name}: the autopilot could not write {times}, for {counts.dropouts_s:.2f} s in all"
            )
        if counts.bad_values:
            found.append(f"{name}: {counts.bad_values} messages with impossible values or times are left out")
        if counts.restarts:
            found.append(
                f"{name}: its clock was set back {counts.restarts} times; "
                "times continue from the last one before"
            )
        return tuple(found)

    def note(self, event: AnyEvent | AnyCommand) -> None:
        """Take in the facts about the vehicle that an event holds."""
        self.seen.add(type(event))
        if isinstance(event, GnssFix):
            self.has_fix |= event.fix_type >= FIX_3D
        elif isinstance(event, Heartbeat):
            self.modes.setdefault(event.custom_mode, event)


class TimeOrder:
    """Puts events in the order of their time stamps.

    A log's messages are nearly in order. Those that come too late, because they were known long before they
    were written, get the time of the latest one. A stamp that jumps ahead, or back after a restart of the
    vehicle, counts if the next message confirms it. Otherwise it is a damaged one or, if it is back by no
    more than `JUMP_S`, that of a message that came late.
    """

    def __init__(self, about: About, *, may_restart: bool, start_s: float | None = None) -> None:
        self._about = about
        self._may_restart = may_restart
        self._newest = start_s
        self._doubtful: tuple[float, AnyEvent | AnyCommand] | None = None
        self._shift_s = 0.0
        self._last_s = -math.inf if start_s is None else start_s
        self._number = 0
        self._heap: list[tuple[float, int, AnyEvent | AnyCommand]] = []

    def add(self, time_s: float, item: AnyEvent | AnyCommand) -> Iterator[Step]:
        """Add an event or command; yields what is now certain to be next."""
        if self._newest is None:
            self._newest = time_s
        ahead_s = time_s - self._newest
        doubtful, self._doubtful = self._doubtful, None
        if ahead_s > JUMP_S or (self._may_restart and ahead_s < -WINDOW_S):
            if doubtful is None or abs(time_s - doubtful[0]) > JUMP_S:
                self._unconfirmed(doubtful)
                self._doubtful = time_s, item
                return
            yield from self._jump(doubtful, back=ahead_s < 0.0)
        else:
            self._unconfirmed(doubtful)
        self._push(time_s, item)
        due_s = self._newest + self._shift_s - WINDOW_S
        while self._heap and (self._heap[0][0] < due_s or len(self._heap) > MOST_WAITING):
            yield self._pop()

    def _unconfirmed(self, doubtful: tuple[float, AnyEvent | AnyCommand] | None) -> None:
        """Take in a message that came late, or count one with a damaged stamp."""
        if doubtful is None:
            return
        assert self._newest is not None
        if abs(doubtful[0] - self._newest) <= JUMP_S:
            self._push(*doubtful)
        else:
            self._about.counts.bad_values += 1

    def rest(self) -> Iterator[Step]:
        """Yield everything that was added."""
        doubtful, self._doubtful = self._doubtful, None
        self._unconfirmed(doubtful)
        while self._heap:
            yield self._pop()

    def shifted(self, time_s: float) -> float:
        """A time stamp on the clock of the steps, which continues where the vehicle's clock started again."""
        return time_s + self._shift_s

    def _jump(self, first: tuple[float, AnyEvent | AnyCommand], *, back: bool) -> Iterator[Step]:
        yield from self.rest()
        if back:
            self._about.counts.restarts += 1
            self._shift_s = self._last_s - first[0]
        self._newest = first[0]
        self._push(*first)

    def _push(self, time_s: float, item: AnyEvent | AnyCommand) -> None:
        assert self._newest is not None
        if time_s < self._newest - JUMP_S:  # known long before it was written
            time_s = self._newest
        self._newest = max(self._newest, time_s)
        heapq.heappush(self._heap, (time_s + self._shift_s, self._number, item))
        self._number += 1

    def _pop(self) -> Step:
        time_s, _, item = heapq.heappop(self._heap)
        self._last_s = max(self._last_s, time_s)
        self._about.note(item)
        if isinstance(item, VelocitySetpoint):
            return Step(now_s=self._last_s, events=(), commands=(item,))
        # A velocity setpoint is the only command that a log is read for.
        return Step(now_s=self._last_s, events=(item,), commands=())  # type: ignore[arg-type]


def is_utc(utc_s: float) -> bool:
    """Whether a vehicle with this time (Unix seconds) knows UTC."""
    return EARLIEST_UTC_S <= utc_s <= UTC_RANGE_S[1]


def on_earth(lat_deg: float, lon_deg: float, *numbers: float) -> bool:
    """Whether a place is one on Earth other than exactly 0, 0, and all further numbers are finite."""
    return (
        abs(lat_deg) <= 90.0
        and abs(lon_deg) <= 180.0
        and (lat_deg, lon_deg) != (0.0, 0.0)
        and all(map(math.isfinite, numbers))
    )
