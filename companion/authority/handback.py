"""Hands a guarded vehicle back to its mission, and reports whether that was allowed and succeeded."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.authority.guard import GuardPlan
from companion.authority.table import Found, Trigger
from companion.autopilot.dialect import DIALECTS
from companion.events import Command, FlightMode, Heartbeat, Say, SetMode, SetSpeed, Severity
from companion.ownship import Ownship

_OBEYS_S = 8.0
"""How long after a request for the mission's mode the vehicle may still obey. Then it is asked again."""
_UNREAD_S = 90.0
"""If the mission cannot be fetched for this long while the vehicle is ready to be handed back, it is not
resumed. This is longer than one download may take."""
_RETAKEN_S = 60.0
"""If a guarded vehicle is taken again within this time after it was handed back, the time without a conflict
that the next handback requires is doubled. This happens when the mission leads into another aircraft, or when
several aircraft cross one after another."""
_LONGEST_PATIENCE_S = 60.0


class HandBack:
    """Hands the mission back to the autopilot each time the vehicle was taken from it.

    Args:
        clear_after_s: time without a conflict after which a conflict counts as over.
    """

    def __init__(self, guard: GuardPlan, own: Ownship, clear_after_s: float) -> None:
        self._guard = guard
        self._own = own
        self._clear_after_s = clear_after_s
        self._asked_s = -math.inf
        """Time of the last request to resume the mission."""
        self._recalled = False
        """Whether we asked for our mode again since that request, because of a new conflict."""
        self._resumed_s = -math.inf
        """Time at which the vehicle last resumed its mission."""
        self._patience_s = 0.0
        """Time without a conflict that the next handback requires, after the vehicle was taken again."""
        self._unread_s = math.inf
        """Time since which only the comparison of the mission has kept us from handing the vehicle back."""
        self._taken_s = -math.inf
        self._off_m = 0.0
        """Largest distance from the path to the mission's item since the vehicle was taken."""

    def begin(self, now_s: float) -> list[Command]:
        """Take the vehicle from its mission. Returns messages for the pilot."""
        self._guard.leave(self._own, now_s)
        self._taken_s, self._off_m = now_s, 0.0
        self._asked_s = -math.inf
        again = now_s - self._resumed_s < _RETAKEN_S
        longer_s = min(2.0 * max(self._patience_s, self._clear_after_s), _LONGEST_PATIENCE_S)
        self._patience_s = longer_s if again else 0.0
        if not self._patience_s:
            return []
        text = f"DMUCA: control taken again; next handback after {self._patience_s:g} s without conflict"
        return [Say(severity=Severity.NOTICE, text=text)]

    def note_way(self, now_s: float) -> None:
        """Update the largest distance from the path while we control the vehicle. Needs a law."""
        assert self._guard.course.law is not None
        here = self._own.position_ned_m(now_s)
        _, nearest = self._guard.course.law.trajectory.nearest(here)
        self._off_m = max(self._off_m, math.dist(nearest, here))

    def ask(self, now_s: float, clear_s: float) -> tuple[list[Command], bool]:
        """Ask the vehicle to resume its mission, if the mission is unchanged.

        Call this while the vehicle is on its path without a conflict.

        Args:
            clear_s: time since the last conflict.

        Returns:
            Requests, and True if the mission must not be resumed at all (see `why_not`).
        """
        if self.asked(now_s) or clear_s < self._patience_s:
            return [], False
        same, commands = self._guard.give_back(self._own, now_s)
        if same:
            self._asked_s, self._recalled, self._unread_s = now_s, False, math.inf
            mission = SetMode(mode=FlightMode.MISSION, speed_mps=self._forgotten_speed_mps())
            return [*commands, mission], False
        self._unread_s = min(self._unread_s, now_s)
        return commands, same is False or now_s - self._unread_s >= _UNREAD_S

    def triggers(self, shown: Sequence[Heartbeat], now_s: float) -> Found:
        """Triggers that follow from the reported modes, given in the order of arrival."""
        if not shown:
            return {}
        found: Found = {}
        elsewhere = [heartbeat for heartbeat in shown if heartbeat.mode is not FlightMode.MISSION]
        if elsewhere:
            found[Trigger.LEFT] = elsewhere[0]
        if self.ended(shown[-1], now_s):
            found[Trigger.ENDED] = shown[-1]
        elif shown[-1].mode is FlightMode.MISSION and self.asked(now_s):
            # Only after the request: before it, the vehicle may be in our mode already without having
            # reported that yet.
            found[Trigger.RESUMED] = None
        return found

    def interrupted(self) -> None:
        """Restart the wait for an unreadable mission, because the authority state has changed."""
        self._unread_s = math.inf

    def asked(self, now_s: float) -> bool:
        """Whether the vehicle was asked to resume its mission and may still obey."""
        return now_s - self._asked_s < _OBEYS_S

    def recall(self, now_s: float) -> list[Command]:
        """Ask for our mode again after a new conflict. Returns requests.

        The vehicle may still enter the mission's mode, so our mode must be the latest request.
        """
        if not self.asked(now_s):
            return []
        self._recalled = True
        return [SetMode(mode=FlightMode.EXTERNAL)]

    def obeyed(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether the reported mode follows from our request: the mission's mode, or the hold at its end."""
        on_mission = heartbeat.mode is FlightMode.MISSION
        return (on_mission and self.asked(now_s)) or self.ended(heartbeat, now_s)

    def done(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether the handback succeeded: the vehicle obeyed, and we asked for nothing else since."""
        return not self._recalled and self.obeyed(heartbeat, now_s)

    def ended(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether the mission ended just as it was handed back."""
        return self.ends_in_hold(heartbeat, now_s) and self._own.mission_complete

    def ends_in_hold(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether the vehicle reports a hold just after the handback, as it does at the end of a mission.

        MISSION_CURRENT, which may arrive later, tells whether the mission is complete.
        """
        ends_so = DIALECTS[heartbeat.firmware].mission_ends_in_hold
        holds = ends_so and heartbeat.mode is FlightMode.HOLD
        return holds and self.asked(now_s)

    def resumed(self, now_s: float) -> list[Command]:
        """Note that the vehicle has resumed its mission. Returns the speed to request, or a warning."""
        self._resumed_s = now_s
        speed_mps = self._forgotten_speed_mps()
        if speed_mps is not None:
            return [SetSpeed(speed_mps=speed_mps)]
        if not self._forgets_speed or not self._guard.speed_is_open(self._own):
            return []
        text = (
            "DMUCA: the mission jumps, so its present speed is unknown; "
            "resumed at the vehicle's default speed"
        )
        return [Say(severity=Severity.WARNING, text=text)]

    def _forgotten_speed_mps(self) -> float | None:
        """Speed set by the mission, if the vehicle forgets it.

        It must be sent right after the request for the mission's mode. A leg that begins at the vehicle's own
        speed overshoots the mission's speed by metres per second.
        """
        return self._guard.mission_speed_mps(self._own) if self._forgets_speed else None

    @property
    def _forgets_speed(self) -> bool:
        """Whether the vehicle forgets the mission's speed when it enters the mission's mode."""
        heartbeat = self._own.heartbeat
        return heartbeat is not None and DIALECTS[heartbeat.firmware].forgets_mission_speed

    def how(self, now_s: float) -> str:
        """Report, in words, that the mission was resumed: after how long and how far off its path."""
        return (
            f"mission resumed at item {self._own.mission_seq} after {now_s - self._taken_s:.0f} s "
            f"under companion control, at most {self._off_m:.0f} m off its path"
        )

    @property
    def why_not(self) -> str:
        """Why the mission is not resumed and what the pilot can do, in words. Needs a heartbeat."""
        assert self._own.heartbeat is not None
        why = self._guard.why_not or f"the vehicle's mission could not be read for {_UNREAD_S:g} s"
        dialect = DIALECTS[self._own.heartbeat.firmware]
        mode = dialect.name(dialect.command(FlightMode.MISSION).custom_mode)
        return f"mission not resumed, vehicle asked to hold: {why}. Select {mode} to fly the mission"
