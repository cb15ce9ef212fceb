"""What a simulated vehicle has said to the gate, kept in plain numbers for the oracle."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

ARDUPILOT = {4: "external", 3: "mission", 17: "hold", 5: "sticks"}
PX4 = {0x60000: "external", 0x4040000: "mission", 0x3040000: "hold", 0x30000: "sticks"}


@dataclass
class Told:
    """A reported position in the fence's axes, with the true time of its measurement."""

    measured_s: float
    boot_s: float
    place: tuple[float, float]
    height: float
    velocity: tuple[float, float, float]
    """Along the fence's axes, and down."""
    north_east: tuple[float, float]
    """The same velocity, north and east."""


@dataclass
class Terms:
    """Configuration and limits that bound a companion."""

    use: str
    rearm: str
    firmware: str
    any_vehicle: bool
    take_in_flight: bool
    stale_s: float
    speed: float
    climb: float
    descent: float
    acceleration: float
    floor: float | None
    ceiling: float | None
    turn: float
    """Direction of the fence's first axis, from north (rad)."""
    walls: tuple[float, float, float, float] | None = None
    """Least and greatest coordinate along the first axis, then along the second (m)."""


@dataclass
class Heard:
    """What the vehicle has said in one history, and what follows from it."""

    terms: Terms

    def __post_init__(self) -> None:
        self.most, self.now_s = self.terms, -math.inf
        self.heard = False
        self.system = 0
        self.armed = False
        self.custom = -1
        self.mode_s = -math.inf
        self.kinds = ARDUPILOT if self.terms.firmware == "ardupilot" else PX4
        self.enabled, self.two = True, False
        # Currency: a counter of events, and its values at the last gap and the last mode.
        self.turn, self.gap_ended, self.mode_turn = 0, 0, -1
        self.emptied_s = self.said_s = -math.inf
        self.decided_s = -math.inf
        self.asked_at: float | None = None
        """When the newest answered question was asked."""
        self.answer_s = -math.inf
        """When an answer came that no command has used yet."""
        self.grounded_s: float | None = None
        self.down = self.terms.take_in_flight
        self.position: Told | None = None
        self.boot_s = self.clock_s = -math.inf
        self.written_s: float | None = None
        """When the newest message with the vehicle's clock was written. `clock_s`: when one last arrived."""
        self.least_s = math.inf
        """Least delay of such a message."""
        self.mixed_until_s = -math.inf
        """Until when an old message that came after a newer one forbids commands."""
        self.shut_s = -math.inf
        self.last: tuple[float, float, float] | None = None  # time, north, east
        self.changes: list[tuple[float, float]] = []
        self.asked_s: list[float] = []
        self.gone = False
        self._let_go()

    def _let_go(self) -> None:
        self.engaged, self.gone, self.ended_by_hold, self.away = False, False, False, False
        self.taken_from: int | None = None
        self.asked: dict[int, float] = {}
        self.entered: set[int] = set()
        self.newest: int | None = None
        """The mode that was requested last."""
        self.open: dict[int, float] = {}
        """When each mode was requested that was not reported while authority lasted."""
        self.chosen: int | None = None
        """The mode that the pilot selected last, since authority was lost."""
        self.overruled = False
        """The vehicle has obeyed a request after the pilot selected that mode."""
        self.commanded_s = -math.inf

    def heartbeat(self, system: int, custom: int, armed: bool, now_s: float) -> None:
        self._said(now_s)
        self.heard, self.system, self.armed = True, system, armed
        if not armed:
            self.down = True
            if not self.gone or self.terms.rearm != "never":
                self._let_go()
        self._mode(custom, now_s)

    def _said(self, now_s: float) -> None:
        """The vehicle has sent something. A mode may have been lost in a silence before it."""
        if now_s - self.said_s > 0.5:
            self.turn += 1
            self.gap_ended = self.turn
        self.said_s = now_s

    def old_mode(self, custom: int, now_s: float) -> None:
        """The vehicle has shown a mode, and newer messages have overtaken it."""
        self._said(now_s)
        ours = custom in self.asked or custom in self.entered or custom == self.taken_from
        gives = self.kinds.get(custom) == ("mission" if self.terms.use == "guard" else "external")
        if self.engaged and not (self.gone or ours or gives):
            news = self.mode_turn
            self._mode(custom, now_s)
            self.mode_turn = news

    def current_mode(self, custom: int, now_s: float) -> None:
        self._said(now_s)
        self.turn += 1
        if self.heard:
            self._mode(custom, now_s)
        elif now_s - self.emptied_s <= 0.25 and not self.late(now_s):
            self.mode_turn = self.turn

    def _mode(self, custom: int, now_s: float) -> None:
        self.turn += 1
        if now_s - self.emptied_s <= 0.25 and not self.late(now_s):
            self.mode_turn = self.turn
        before, before_s, self.custom, self.mode_s = self.custom, self.mode_s, custom, now_s
        kind = self.kinds.get(custom, "other")
        guard = self.terms.use == "guard"
        gives = kind == ("mission" if guard else "external")
        if not self.gone:
            self.open.pop(custom, None)
        if self.gone:
            self.ended_by_hold &= kind == "hold"
            late = custom != self.chosen and before_s - self.open.get(custom, -math.inf) <= 3.0
            self.overruled = late or (self.overruled and custom == before)
            if self.overruled:
                self.away &= not gives
                return
            self.chosen = custom
            if gives and self.away and self.terms.rearm == "mode":
                self._let_go()
            self.away |= not gives
            return
        if not self.engaged:
            return
        if custom == self.taken_from:
            if guard and kind == "mission" and now_s - self.commanded_s > 10.0:
                self._let_go()
            return
        wanted = custom in self.entered or now_s <= self.asked.get(custom, -math.inf)
        if wanted or (gives and not guard):
            if kind == "mission" and custom != self.newest:
                self.taken_from = custom
                return
            self.entered.add(custom)
            self.taken_from = None
            if kind == "mission":
                self._let_go()
            return
        self.gone, self.chosen = True, custom
        mission = any(self.kinds[c] == "mission" and now_s <= t for c, t in self.asked.items())
        self.ended_by_hold = kind == "hold" and mission
        self.away = not gives or self.kinds.get(before) != "external"
        if gives and self.away and self.terms.rearm == "mode":
            self._let_go()

    def landed(self, on_ground: bool, now_s: float) -> None:
        self._said(now_s)
        flown = (0.0, 0.0, 0.0) if self.position is None else self.position.velocity
        if not on_ground or math.hypot(*flown) > 2.0:
            self.grounded_s = None
            return
        self.grounded_s = now_s if self.grounded_s is None else self.grounded_s
        self.down = self.down or now_s - self.grounded_s >= 1.5
        if now_s - self.grounded_s >= 12.0 and not self.gone:
            self._let_go()

    def mission_complete(self) -> None:
        if self.gone and self.ended_by_hold:
            self._let_go()

    def told(self, position: Told, now_s: float) -> None:
        """The vehicle has reported its position."""
        self._said(now_s)
        self._stamped(position.measured_s, position.boot_s, now_s)
        if self.position is None or position.boot_s >= self.position.boot_s:
            self.position = position

    def clock(self, measured_s: float, boot_s: float, now_s: float) -> None:
        """The vehicle has sent another message with its clock, which it wrote at `measured_s`."""
        self._said(now_s)
        self._stamped(measured_s, boot_s, now_s)

    def _stamped(self, measured_s: float, boot_s: float, now_s: float) -> None:
        if self.written_s is not None and abs(boot_s - measured_s - self.boot_s + self.written_s) < 0.01:
            if measured_s < self.written_s:
                self.clock_s = now_s
                if measured_s < self.written_s - 0.27:
                    self._overtaken(now_s - measured_s - self.least_s, now_s)
                return
        elif boot_s < self.boot_s - 1.0:
            self.least_s, self.boot_s, self.position = math.inf, -math.inf, None
        elif self.written_s is not None and boot_s - measured_s > self.boot_s - self.written_s + 0.5:
            self.least_s = math.inf  # The clock has jumped ahead.
        if boot_s >= self.boot_s:
            self.boot_s, self.written_s = boot_s, measured_s
        self.least_s = min(self.least_s, now_s - measured_s)
        self.clock_s = now_s
        if self.late(now_s):
            self.turn += 1
            self.gap_ended = self.turn

    def _overtaken(self, delay_s: float, now_s: float) -> None:
        """A message with the vehicle's clock came after newer ones."""
        if delay_s > max(0.5, 0.5 * self.terms.stale_s) + 0.02:
            self.turn += 1
            self.gap_ended = self.turn
            self.mixed_until_s = max(self.mixed_until_s, now_s + min(delay_s, 10.0) - 0.02)

    def parameters(self, speed: float, climb: float, descent: float, acceleration: float) -> None:
        self.terms = replace(
            self.terms,
            speed=min(self.most.speed, speed),
            climb=min(self.most.climb, climb),
            descent=min(self.most.descent, descent),
            acceleration=min(self.most.acceleration, acceleration),
        )
        self.changes = []

    def answered(self, asked_s: float, now_s: float) -> None:
        self._said(now_s)
        if self.asked_at is None or asked_s > self.asked_at:
            self.asked_at = asked_s
            if now_s - asked_s <= 0.25 + 1e-6:  # The question carries its time in nanoseconds.
                self.answer_s = now_s

    def late(self, now_s: float) -> bool:
        """Whether messages that arrive now have waited on the way, by the vehicle's clock."""
        if now_s < self.mixed_until_s:
            return True
        longest_s = max(0.5, 0.5 * self.terms.stale_s) + 0.02
        if self.written_s is None or now_s - self.clock_s > 9.9:
            return False
        return now_s - self.written_s - self.least_s > longest_s

    def emptied(self, now_s: float) -> None:
        self.turn += 1
        if now_s - self.emptied_s > 0.25:
            self.gap_ended = self.turn
        self.emptied_s = now_s

    def behind(self) -> None:
        self.turn += 1
        self.emptied_s = -math.inf
