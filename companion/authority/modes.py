"""Which of the vehicle's modes are by our doing, and how it comes into the one that takes setpoints."""

from __future__ import annotations

from collections.abc import Sequence

from companion.authority.handback import HandBack
from companion.events import Command, FlightMode, Heartbeat, SetMode
from companion.ownship import Ownship

_STREAM_FIRST_S = 0.5
"""PX4 enters OFFBOARD only while setpoints already stream."""


class OurModes:
    """Of one vehicle.

    Args:
        handback: of a mission that is guarded; None: none is.
    """

    def __init__(self, own: Ownship, handback: HandBack | None) -> None:
        self.left_in: frozenset[FlightMode] = frozenset()
        """Modes that the vehicle may be in by our own doing, after a fault ended our flight."""
        self.confirmed = False
        """It has shown the mode in which it flies what we command."""
        self._own = own
        self._handback = handback
        self._stream_s: float | None = None
        """Since when setpoints stream, while the mode has not been asked for."""
        self._custom_before: int | None = None
        self._shown = False
        """That mode was shown since it was sought, if only for a moment."""

    def seek(self, now_s: float) -> None:
        """Our mode is to be entered, from the one that the vehicle is in."""
        heartbeat = self._own.heartbeat
        self.confirmed, self._shown, self._stream_s = False, False, now_s
        self._custom_before = None if heartbeat is None else heartbeat.custom_mode

    def keep(self, now_s: float) -> list[Command]:
        """Setpoints stream: get the vehicle to take them. Returns what is to be asked."""
        if self._own.mode is FlightMode.EXTERNAL:
            self.confirmed = True
        elif self.confirmed:
            # The mission that was asked for is entered after all, and there is a conflict again.
            self.seek(now_s)
        elif self._stream_s is not None and now_s - self._stream_s >= _STREAM_FIRST_S:
            self._stream_s = None
            return [SetMode(mode=FlightMode.EXTERNAL)]
        return []

    def judge(self, shown: Sequence[Heartbeat], now_s: float, held: bool) -> Heartbeat | None:
        """Take in what the vehicle showed, in the order of arrival: each mode counts, whatever follows it.

        Args:
            held: the vehicle is ours to command.

        Returns:
            The first that shows a mode which we did not command; None: none does.
        """
        found, gone = None, False
        for heartbeat in shown:
            if heartbeat.mode not in self.left_in:
                # What a fault left the vehicle in is forgotten once it has left that.
                self.left_in = frozenset()
            ours = heartbeat.mode is FlightMode.EXTERNAL
            if found is None and (gone if ours else self._not_ours(heartbeat, now_s)):
                found = heartbeat
            if held:
                self._shown = self._shown or ours
                # The mission that was given back is flown: who selects our mode now is not us.
                gone = gone or (self._handback is not None and self._handback.done(heartbeat, now_s))
        return found

    def _not_ours(self, heartbeat: Heartbeat, now_s: float) -> bool:
        """A mode that we did not command: any but the one we asked for and, until that is shown, the one we
        took the vehicle from."""
        if heartbeat.mode in self.left_in:
            return False
        if self._handback is not None and self._handback.obeyed(heartbeat, now_s):
            return False
        return not self.being_taken(heartbeat)

    def being_taken(self, heartbeat: Heartbeat) -> bool:
        """The vehicle shows the mode that we are taking it from, and has not yet shown ours."""
        sought = not self.confirmed and not self._shown
        return sought and heartbeat.custom_mode == self._custom_before

    def let_go(self, *, asks_hold: bool) -> list[Command]:
        """A fault ends our flight: what the vehicle may be in from now on.

        Args:
            asks_hold: where it is in our mode, it is asked to hold.
        """
        mode = self._own.mode
        if mode is FlightMode.EXTERNAL:
            self.left_in = frozenset({FlightMode.EXTERNAL})
            if asks_hold:
                self.left_in |= {FlightMode.HOLD}
                return [SetMode(mode=FlightMode.HOLD)]
        elif mode is not None and not self.confirmed:
            # Our mode may be entered unseen.
            self.left_in = frozenset({mode, FlightMode.EXTERNAL})
        return []
