"""Asks for one flight mode. The request is repeated until HEARTBEAT or CURRENT_MODE shows the mode, or is
given up with a reason.

An acknowledgement proves nothing (PX4 accepts modes that it then does not enter), so only `custom_mode`
confirms the mode. Acknowledgements and the vehicle's texts are kept for the reason. If the vehicle goes to a
third mode meanwhile, the pilot or a failsafe has acted, and the request ends. Every try follows a message
which shows that neither has acted. The first try is sent at once if the last message still shows that. A
request is thus never sent against a pilot whose choice has not been received yet. `ModeTold` defines how long
a message shows that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.autopilot.dialect import CMD_DO_SET_MODE
from companion.autopilot.dialects.definition import CUSTOM_MODE_ENABLED, Dialect
from companion.autopilot.encoders import Outgoing, command_long
from companion.autopilot.wire import names_of
from companion.events import FlightMode

RETRY_S = 1.0
MAX_TRIES = 5
SILENCE_S = 3.0
"""The request is given up if the mode has not been reported for this long after a try."""
_PROMPT_S = 0.6
"""If CURRENT_MODE messages come at most this far apart, PX4 also sends one at each change, and the mode in
one is trusted for this long. PX4 sends them twice a second if they were requested, else every 2 s."""
_SETTLED_S = 0.1
"""How long a try waits after a CURRENT_MODE: twice the interval at which CURRENT_MODE is requested."""
_LONGEST_S = 2 * _SETTLED_S
"""Longest time that a try is held back. PX4 reports its mode with every command that it takes, so a vehicle
whose gimbal is commanded all the time would otherwise hold it back forever."""

_RESULTS = names_of("MAV_RESULT", "MAV_RESULT_")


def result_words(result: int) -> str:
    """MAV_RESULT in words."""
    return _RESULTS.get(result, f"result {result}").lower().replace("_", " ")


@dataclass(slots=True)
class ModeTold:
    """The mode that HEARTBEAT or CURRENT_MODE reported last, and how long it may be trusted.

    When PX4 takes a command, it sends a CURRENT_MODE with the mode that it is still in, and the new mode one
    interval later. No mode must be asked for in between.
    """

    custom_mode: int = 0
    known_until_s: float = -math.inf
    settled_s: float = -math.inf
    _current_s: float = -math.inf

    def heartbeat(self, custom_mode: int, now_s: float, known_s: float) -> None:
        """Take HEARTBEAT; `known_s` is the dialect's `mode_known_s`."""
        self.custom_mode, self.settled_s = custom_mode, now_s
        self.known_until_s = max(self.known_until_s, now_s + known_s)

    def current_mode(self, custom_mode: int, now_s: float) -> None:
        """Take CURRENT_MODE."""
        self.custom_mode, self.settled_s = custom_mode, now_s + _SETTLED_S
        if now_s - self._current_s <= _PROMPT_S:
            self.known_until_s = max(self.known_until_s, now_s + _PROMPT_S)
        self._current_s = now_s

    def forget(self) -> None:
        """The reported mode may be old, so it is not trusted until the next message that shows the mode."""
        self.known_until_s = self._current_s = -math.inf


class ModeRequest:
    """Asks for one mode until `confirmed` or `refused` (a reason)."""

    def __init__(
        self,
        mode: FlightMode,
        dialect: Dialect,
        system_id: int,
        told: ModeTold,
        now_s: float,
        replaced: ModeRequest | None = None,
    ) -> None:
        """Create a request that has not been sent.

        Args:
            told: the mode that the vehicle reports, also while the request runs.
            replaced: the request that this one replaces.
        """
        self.mode = mode
        self.confirmed = False
        self.refused: str | None = None
        self._dialect = dialect
        self._command = dialect.command(mode)
        self._system_id = system_id
        self._told = told
        self._from_mode = told.custom_mode
        self._expected = frozenset({told.custom_mode, self._command.custom_mode})
        if replaced is not None:
            # The vehicle may still enter the mode of the replaced request.
            self._expected |= replaced._expected
        self._replaces = replaced is not None
        self._heard = now_s <= told.known_until_s
        self._held_s: float | None = None
        """Time since which a try has been held back because the mode may not be settled."""
        self._tries = 0
        self._next_s = now_s + RETRY_S
        self._ack: int | None = None
        self._text: str | None = None

    def may_be_entered(self, now_s: float) -> bool:
        """Whether the last try is so recent that the vehicle may still enter the mode, or may not have
        reported it yet."""
        return self._tries > 0 and now_s <= self._next_s - RETRY_S + SILENCE_S

    def due(self, now_s: float) -> Outgoing | None:
        """The command, if it is time to send it. After the last try the request is refused."""
        if self._tries and now_s < self._next_s:
            return None
        if self._tries == MAX_TRIES or (not self._heard and now_s >= self._next_s - RETRY_S + SILENCE_S):
            self.refused = self._reason()
            return None
        if not self._heard:
            return None
        self._held_s = now_s if self._held_s is None else self._held_s
        if now_s < min(self._told.settled_s, self._held_s + _LONGEST_S):
            return None
        self._heard, self._held_s = False, None
        self._next_s = now_s + RETRY_S
        self._tries += 1
        command = self._command
        params = (float(CUSTOM_MODE_ENABLED), command.param2, command.param3)
        return command_long(CMD_DO_SET_MODE, params, self._system_id, confirmation=self._tries - 1)

    def on_mode(self, now_s: float) -> None:
        """The vehicle has reported its mode."""
        custom_mode = self._told.custom_mode
        self._heard = self._heard or now_s <= self._told.known_until_s
        if custom_mode == self._command.custom_mode:
            # Before the first try, the vehicle may still leave this mode for the mode of the replaced
            # request.
            self.confirmed = self._tries > 0 or not self._replaces
        elif custom_mode not in self._expected:
            name = self._dialect.name
            self.refused = (
                f"the vehicle went from {name(self._from_mode)} to {name(custom_mode)} while "
                f"{name(self._command.custom_mode)} was requested"
            )

    def forget(self) -> None:
        """The reported mode may be old: send no try before the mode is reported again."""
        self._heard = False

    def on_ack(self, result: int) -> None:
        """Take COMMAND_ACK of DO_SET_MODE."""
        self._ack = result

    def on_text(self, text: str) -> None:
        """Take a text that the vehicle sent during the request."""
        self._text = text

    def _reason(self) -> str:
        answer = "no answer" if self._ack is None else f"the vehicle answered: {result_words(self._ack)}"
        text = f'; it said: "{self._text}"' if self._text else ""
        name = self._dialect.name(self._command.custom_mode)
        heard = (
            f"the vehicle is still in {self._dialect.name(self._from_mode)}"
            if self._heard
            else "no heartbeat since the last try"
        )
        return f"{name} not entered (tries: {self._tries}; {answer}{text}); {heard}"
