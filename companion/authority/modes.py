"""Tells modes that we commanded from modes that the pilot selected, and gets the vehicle into ours."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.authority.handback import HandBack
from companion.autopilot.dialect import DIALECTS
from companion.events import Command, FlightMode, Heartbeat, Say, SetMode, Severity
from companion.ownship import Ownship

_STREAM_FIRST_S = 0.5
"""How long setpoints stream before the mode is requested: PX4 enters OFFBOARD only if they already stream."""
_OBEYS_S = 8.0
"""How long after a request the vehicle may still enter the mode: the link repeats it for five seconds."""
_OBEYED_LATE_S = 3.0
"""How long after the pilot selected his mode the vehicle may still obey a request that was on its way."""


class OurModes:
    """Modes of one vehicle that result from our commands.

    Args:
        handback: hands a guarded mission back; None if no mission is guarded.
    """

    def __init__(self, own: Ownship, handback: HandBack | None) -> None:
        self.left_in: frozenset[FlightMode] = frozenset()
        """Modes that the vehicle may be in because of our own commands after a fault ended our control."""
        self.confirmed = False
        """The vehicle has reported our mode, the one in which it flies setpoints."""
        self._own = own
        self._handback = handback
        self._stream_s: float | None = None
        """Start of the setpoint stream; None once the mode has been requested."""
        self._custom_before: int | None = None
        self._shown = False
        """Our mode has been reported, if only for a moment, since `seek`."""

    def seek(self, now_s: float) -> None:
        """Start to bring the vehicle from its present mode into ours."""
        heartbeat = self._own.heartbeat
        self.confirmed, self._shown, self._stream_s = False, False, now_s
        self._custom_before = None if heartbeat is None else heartbeat.custom_mode

    @property
    def asked(self) -> bool:
        """Whether our mode has been requested and not been reported yet."""
        return self._stream_s is None and not self.confirmed

    @property
    def entered_late(self) -> bool:
        """Whether the vehicle has entered our mode after a fault gave up the request for it."""
        given_up = FlightMode.EXTERNAL in self.left_in and len(self.left_in) > 1
        return given_up and self._own.mode is FlightMode.EXTERNAL and FlightMode.HOLD not in self.left_in

    def keep(self, now_s: float) -> list[Command]:
        """Get the vehicle into our mode, and keep it there, while setpoints stream. Returns requests."""
        if self._own.mode is FlightMode.EXTERNAL:
            self.confirmed = True
        elif self.confirmed:
            # The vehicle has entered the requested mission after all, but there is a new conflict.
            self.seek(now_s)
        elif self._stream_s is not None and now_s - self._stream_s >= _STREAM_FIRST_S:
            self._stream_s = None
            return [SetMode(mode=FlightMode.EXTERNAL)]
        return []

    def judge(self, shown: Sequence[Heartbeat], now_s: float, held: bool) -> Heartbeat | None:
        """Take in the reported modes, in the order of arrival. Each mode counts, whichever follows it.

        Args:
            held: we control the vehicle.

        Returns:
            The first heartbeat with a mode that we did not command; None if there is none.
        """
        found, gone = None, False
        for heartbeat in shown:
            if heartbeat.mode not in self.left_in:
                # The vehicle has left the modes in which a fault left it.
                self.left_in = frozenset()
            ours = heartbeat.mode is FlightMode.EXTERNAL
            if found is None and (gone if ours else self._not_ours(heartbeat, now_s)):
                found = heartbeat
            if held:
                self._shown = self._shown or ours
                # The vehicle flies its mission again: if our mode appears now, the pilot selected it.
                gone = gone or (self._handback is not None and self._handback.done(heartbeat, now_s))
        return found

    def _not_ours(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """Whether we did not command this mode.

        Ours are the requested mode and, until that is reported, the mode from which we take the vehicle.
        """
        if heartbeat.mode in self.left_in:
            return False
        if self._handback is not None and self._handback.obeyed(heartbeat, now_s):
            return False
        return not self.being_taken(heartbeat)

    def being_taken(self, heartbeat: Heartbeat) -> bool:
        """Whether this is the mode from which we take the vehicle, and ours has not been reported yet."""
        sought = not self.confirmed and not self._shown
        return sought and heartbeat.custom_mode == self._custom_before

    def let_go(self, *, asks_hold: bool) -> list[Command]:
        """Note the modes in which a fault leaves the vehicle. Returns requests.

        Args:
            asks_hold: ask the vehicle to hold if it is in our mode.
        """
        mode = self._own.mode
        if mode is FlightMode.EXTERNAL:
            self.left_in = frozenset({FlightMode.EXTERNAL})
            if asks_hold:
                self.left_in |= {FlightMode.HOLD}
                return [SetMode(mode=FlightMode.HOLD)]
        elif mode is not None and not self.confirmed:
            # The vehicle may enter our mode without our seeing it.
            self.left_in = frozenset({mode, FlightMode.EXTERNAL})
        return []


class LateRequests:
    """Notices that the vehicle obeys a request of ours after the pilot has selected another mode.

    The request was on its way as he selected it. The vehicle is then in a mode that nobody wants: the pilot
    is told, and his mode is requested once if it is one that we can request. If he has selected our mode
    himself so soon, he has to do it again.

    Args:
        guards: the vehicle flies its mission and is guarded, so that its mode is one that we request.
    """

    def __init__(self, own: Ownship, *, guards: bool) -> None:
        self._own = own
        self._askable = {FlightMode.HOLD, FlightMode.STICKS} | ({FlightMode.MISSION} if guards else set())
        self._asked: dict[FlightMode, float] = {}
        """Requested modes that have not been reported yet, with the times of the requests."""
        self._from: set[int] = set()
        """custom_mode of the vehicle at these requests."""
        self._chosen: Heartbeat | None = None
        """Latest mode that the pilot or a failsafe has selected since."""
        self._chosen_s = self._seen_s = -math.inf
        """When it was reported, and when the vehicle was last heard before the reports being judged: what
        changed in a silence may have changed at its beginning."""
        self._told = False

    def note(self, commands: Sequence[Command], now_s: float) -> None:
        """Note the mode requests among commands."""
        for command in commands:
            if type(command) is SetMode and self._own.heartbeat is not None:
                self._asked[command.mode] = now_s
                self._from.add(self._own.heartbeat.custom_mode)

    def judge(self, shown: Sequence[Heartbeat], now_s: float) -> list[Command]:
        """Take in the reported modes, in the order of arrival. Returns messages and requests."""
        before_s, self._seen_s = self._seen_s, self._own.heartbeat_s
        if not self._asked:
            self._forget()
            return []
        over = self._chosen is not None and before_s - self._chosen_s > _OBEYED_LATE_S
        if over or not all(heartbeat.armed for heartbeat in shown):
            self._asked.clear()
        self._asked = {mode: at_s for mode, at_s in self._asked.items() if before_s - at_s <= _OBEYS_S}
        if not self._asked:
            self._forget()
        commands: list[Command] = []
        for heartbeat in shown if self._asked else ():
            commands += self._take(heartbeat, now_s)
        return commands

    def _forget(self) -> None:
        self._from.clear()
        self._chosen, self._told = None, False

    def _take(self, heartbeat: Heartbeat, now_s: float) -> list[Command]:
        chosen, custom = self._chosen, heartbeat.custom_mode
        if chosen is not None and custom == chosen.custom_mode:
            return []
        if heartbeat.mode not in self._asked:
            if chosen is not None or not (custom in self._from or self._ends_mission(heartbeat)):
                self._chosen, self._chosen_s, self._told = heartbeat, now_s, False
            return []
        if chosen is None:
            del self._asked[heartbeat.mode]
            return []
        if self._told:
            return []
        self._told = True
        dialect = DIALECTS[heartbeat.firmware]
        name = dialect.name(chosen.custom_mode)
        command = dialect.commands.get(chosen.mode)
        can_ask = command is not None and command.custom_mode == chosen.custom_mode
        # After a silence he may have selected our mode himself.
        asks = can_ask and chosen.mode in self._askable and now_s - self._chosen_s <= _OBEYED_LATE_S
        then = "is requested again" if asks else "must be selected again"
        text = f"DMUCA: {dialect.name(custom)} entered after {name}, by our earlier request: {name} {then}"
        said = Say(severity=Severity.WARNING, text=text)
        return [said, SetMode(mode=chosen.mode)] if asks else [said]

    def _ends_mission(self, heartbeat: Heartbeat) -> bool:
        """Whether this may be the hold at the end of a mission that we requested."""
        ends = DIALECTS[heartbeat.firmware].mission_ends_in_hold
        return ends and heartbeat.mode is FlightMode.HOLD and FlightMode.MISSION in self._asked
