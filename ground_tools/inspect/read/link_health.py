"""Quality of a telemetry link: frames received and missing for each component, and what the radio reports.

MAVLink numbers each component's frames from 0 to 255. A skipped number is a frame that is not in the log: it
was lost on the way, or never written. The number may wrap around during a silence, so a silence counts as at
most 254 missing frames, however long it is. The same number twice in a row is a repeated frame.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace

import numpy as np

from companion.arrays import Floats
from companion.autopilot.tlog import TlogCounts

GAP_S = 3.0
"""A component's silence longer than this is a gap: three heartbeats."""
_REPEATED = 255


@dataclass(frozen=True, slots=True)
class ComponentHealth:
    """Frame counts of one component."""

    system_id: int
    component_id: int
    frames: int
    missing: int
    """Number of missing frames, from the gaps in the sequence numbers."""
    repeated: int
    gaps_s: Floats
    """(n, 2) start and duration of each silence longer than GAP_S, including one at the end of the log."""
    seconds: Floats
    """(n, 3) now_s, frames, missing frames; one row for every second with a frame."""

    @property
    def missing_share(self) -> float:
        """Share of missing frames among all sent frames, by their sequence numbers."""
        return self.missing / (self.frames + self.missing)


@dataclass(frozen=True, slots=True)
class LinkHealth:
    """Link quality in one log, for one vehicle. Times are `now_s` of that vehicle's record."""

    components: tuple[ComponentHealth, ...]
    """Components of all systems in the log, in order of their ids."""
    radio: Floats
    """(n, 8) from RADIO_STATUS: now_s, rssi, remote rssi, noise, remote noise, receive errors, corrected
    packets, free transmit buffer (%). Signal and noise are in the radio's own units."""
    reboots_s: Floats
    """(n,) times at which this vehicle's boot clock restarted."""
    counts: TlogCounts
    """Numbers of records, damaged spans, and bytes that belong to no record."""
    unknown: int
    """Number of records with messages that this software's dialect does not have."""
    bad_values: int
    """Number of messages of this vehicle with invalid values."""
    problems: tuple[str, ...] = ()
    """Damage of a log that is read for the quality of the link only, one line each."""

    def moved(self, offset_s: float) -> LinkHealth:
        """Return a copy with `offset_s` added to all times."""
        columns = np.array([offset_s, 0.0])
        return replace(
            self,
            components=tuple(
                replace(
                    one,
                    gaps_s=one.gaps_s + columns,
                    seconds=one.seconds + np.append(columns, 0.0),
                )
                for one in self.components
            ),
            radio=self.radio + np.append([offset_s], np.zeros(7)),
            reboots_s=self.reboots_s + offset_s,
        )


@dataclass(slots=True)
class _Component:
    frames: int = 0
    missing: int = 0
    repeated: int = 0
    number: int | None = None
    last_s: float = 0.0
    second: int | None = None
    gaps: array[float] = field(default_factory=lambda: array("d"))
    seconds: array[float] = field(default_factory=lambda: array("d"))


class Tally:
    """Counts frames as they are read."""

    def __init__(self) -> None:
        self.unknown = 0
        self._components: dict[tuple[int, int], _Component] = {}
        self._radio = array("d")
        self._end_s = 0.0

    def frame(self, now_s: float, system_id: int, component_id: int, number: int) -> None:
        """Count one frame, given the fields of its header."""
        self._end_s = now_s
        one = self._components.get((system_id, component_id))
        if one is None:
            one = self._components[system_id, component_id] = _Component(last_s=now_s)
        elif now_s - one.last_s > GAP_S:
            one.gaps.extend((one.last_s, now_s - one.last_s))
        skipped = 0 if one.number is None else (number - one.number - 1) & 0xFF
        if skipped == _REPEATED:
            one.repeated += 1
            skipped = 0
        one.frames += 1
        one.missing += skipped
        one.number, one.last_s = number, now_s
        second = int(now_s)
        if second != one.second:
            one.second = second
            one.seconds.extend((second, 0.0, 0.0))
        one.seconds[-2] += 1.0
        one.seconds[-1] += skipped

    def radio(self, now_s: float, fields: tuple[int, ...]) -> None:
        """Add a RADIO_STATUS with its fields in wire order: rxerrors, fixed, rssi, remrssi, txbuf, noise,
        remnoise."""
        errors, fixed, rssi, remote, buffer, noise, remote_noise = fields
        self._radio.extend((now_s, rssi, remote, noise, remote_noise, errors, fixed, buffer))

    def health(self, reboots_s: array[float], counts: TlogCounts, bad_values: int) -> LinkHealth:
        """Return everything counted so far, plus the given values from the vehicle's own messages."""
        return LinkHealth(
            components=tuple(
                ComponentHealth(
                    system_id=system,
                    component_id=component,
                    frames=one.frames,
                    missing=one.missing,
                    repeated=one.repeated,
                    gaps_s=np.array([*one.gaps, *self._silence(one)]).reshape(-1, 2),
                    seconds=np.array(one.seconds).reshape(-1, 3),
                )
                for (system, component), one in sorted(self._components.items())
            ),
            radio=np.array(self._radio).reshape(-1, 8),
            reboots_s=np.array(reboots_s),
            counts=counts,
            unknown=self.unknown,
            bad_values=bad_values,
        )

    def _silence(self, one: _Component) -> tuple[float, ...]:
        """Return the gap from a component's last frame to the end of the log, if longer than GAP_S."""
        silence = self._end_s - one.last_s
        return (one.last_s, silence) if silence > GAP_S else ()
