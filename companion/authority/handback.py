"""A guarded vehicle is given back to its mission: when it may be, whether it was, and what is told of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.authority.guard import GuardPlan
from companion.authority.table import Found, Trigger
from companion.autopilot.dialect import DIALECTS
from companion.events import Command, Firmware, FlightMode, Heartbeat, Say, SetMode, SetSpeed, Severity
from companion.ownship import Ownship

_OBEYS_S = 8.0
"""For this long after the mission was asked for, the vehicle may still obey; then it is asked again."""
_UNREAD_S = 90.0
"""A mission that could not be fetched for so long, with the vehicle ready to be given back, is not resumed:
longer than one download may take."""
_RETAKEN_S = 60.0
"""A guarded vehicle that is taken again within this time after it was given back, as what its mission flies
next leads into somebody, or as one after another crosses, is given back later: after twice as long without a
conflict each time."""
_LONGEST_PATIENCE_S = 60.0


class HandBack:
    """Hands the mission back, each time that the vehicle was taken from it.

    Args:
        clear_after_s: without a conflict for so long, there is none any more.
    """

    def __init__(self, guard: GuardPlan, own: Ownship, clear_after_s: float) -> None:
        self._guard = guard
        self._own = own
        self._clear_after_s = clear_after_s
        self._asked_s = -math.inf
        """When the vehicle was last asked to fly its mission on."""
        self._recalled = False
        """Since then it was asked for our mode again, as somebody came."""
        self._resumed_s = -math.inf
        """When it last did."""
        self._patience_s = 0.0
        """A vehicle that was taken again is not given back before so long without a conflict."""
        self._unread_s = math.inf
        """Since when the vehicle could be given back, if its mission were known to be the same."""
        self._taken_s = -math.inf
        self._off_m = 0.0
        """Farthest from the way to the mission's item since then."""

    def begin(self, now_s: float) -> list[Command]:
        """The vehicle is taken from its mission."""
        self._guard.leave(self._own, now_s)
        self._taken_s, self._off_m = now_s, 0.0
        self._asked_s = -math.inf
        again = now_s - self._resumed_s < _RETAKEN_S
        longer_s = min(2.0 * max(self._patience_s, self._clear_after_s), _LONGEST_PATIENCE_S)
        self._patience_s = longer_s if again else 0.0
        if not self._patience_s:
            return []
        text = f"DMUCA: taken again: given back after {self._patience_s:g} s without a conflict"
        return [Say(severity=Severity.NOTICE, text=text)]

    def note_way(self, now_s: float) -> None:
        """The vehicle is flown: how far off its way it is. Needs a law."""
        assert self._guard.course.law is not None
        here = self._own.position_ned_m(now_s)
        _, nearest = self._guard.course.law.trajectory.nearest(here)
        self._off_m = max(self._off_m, math.dist(nearest, here))

    def ask(self, now_s: float, clear_s: float) -> tuple[list[Command], bool]:
        """On the path, and no conflict: the mission goes on, if it is still the same.

        Args:
            clear_s: for how long there has been no conflict.

        Returns:
            What is to be asked; and whether the mission is not to be resumed (`why_not`).
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
        """What the modes that the vehicle showed, in the order of arrival, say about its mission."""
        if not shown:
            return {}
        found: Found = {}
        elsewhere = [heartbeat for heartbeat in shown if heartbeat.mode is not FlightMode.MISSION]
        if elsewhere:
            found[Trigger.LEFT] = elsewhere[0]
        if self.ended(shown[-1], now_s):
            found[Trigger.ENDED] = shown[-1]
        elif shown[-1].mode is FlightMode.MISSION and self.asked(now_s):
            # Not before it was asked for: the vehicle may be in our mode already, and not have said so.
            found[Trigger.RESUMED] = None
        return found

    def interrupted(self) -> None:
        """The state has changed: a mission that cannot be read is waited for anew."""
        self._unread_s = math.inf

    def asked(self, now_s: float) -> bool:
        """The vehicle was asked to fly its mission on, and may still obey."""
        return now_s - self._asked_s < _OBEYS_S

    def recall(self, now_s: float) -> list[Command]:
        """There is a conflict again. The mission may still be entered: what was asked for last counts.
        Returns what is to be asked."""
        if not self.asked(now_s):
            return []
        self._recalled = True
        return [SetMode(mode=FlightMode.EXTERNAL)]

    def obeyed(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """The mode that the vehicle shows is what was asked for, or the mission's end."""
        on_mission = heartbeat.mode is FlightMode.MISSION
        return (on_mission and self.asked(now_s)) or self.ended(heartbeat, now_s)

    def done(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """The same, where nothing else was asked for since: the vehicle is its mission's again."""
        return not self._recalled and self.obeyed(heartbeat, now_s)

    def ended(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """The mission came to its end as it was given back."""
        return self.ends_in_hold(heartbeat, now_s) and self._own.mission_complete

    def ends_in_hold(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """The vehicle holds, as PX4 does after a mission's last item, and its mission was just given back.
        Whether that was done is told by MISSION_CURRENT, which may come later."""
        holds = heartbeat.firmware is Firmware.PX4 and heartbeat.mode is FlightMode.HOLD
        return holds and self.asked(now_s)

    def resumed(self, now_s: float) -> list[Command]:
        """The vehicle flies its mission on: at which speed."""
        self._resumed_s = now_s
        speed_mps = self._forgotten_speed_mps()
        if speed_mps is not None:
            return [SetSpeed(speed_mps=speed_mps)]
        if not self._forgets_speed or not self._guard.speed_is_open(self._own):
            return []
        text = (
            "DMUCA: the mission jumps, which of its speeds holds is not known: flown on at the vehicle's own"
        )
        return [Say(severity=Severity.WARNING, text=text)]

    def _forgotten_speed_mps(self) -> float | None:
        """The mission's own speed. It must come right behind the request for the mission's mode: a leg that
        was begun at the vehicle's own speed overshoots it by metres a second."""
        return self._guard.mission_speed_mps(self._own) if self._forgets_speed else None

    @property
    def _forgets_speed(self) -> bool:
        """ArduPilot does, when the mission's mode is entered."""
        heartbeat = self._own.heartbeat
        return heartbeat is not None and heartbeat.firmware is Firmware.ARDUPILOT

    def how(self, now_s: float) -> str:
        """The vehicle flies its mission on: what came in between, in words."""
        return (
            f"the vehicle flies its mission on at item {self._own.mission_seq}, taken for "
            f"{now_s - self._taken_s:.0f} s, {self._off_m:.0f} m off its way at most"
        )

    @property
    def why_not(self) -> str:
        """Why the mission is not resumed, and what is left to the pilot, in words. Needs a heartbeat."""
        assert self._own.heartbeat is not None
        why = self._guard.why_not or f"the vehicle's mission could not be read for {_UNREAD_S:g} s"
        dialect = DIALECTS[self._own.heartbeat.firmware]
        mode = dialect.name(dialect.command(FlightMode.MISSION).custom_mode)
        return f"{why}: it is not resumed, the vehicle is to hold. To fly it select {mode}"
