"""One flight mode being asked for: sent again until a heartbeat shows it, given up with a reason.

An acknowledgement proves nothing (PX4 accepts modes that it then does not enter), so only `custom_mode`
confirms; acknowledgements and the vehicle's texts are kept for the reason. When the vehicle goes to a third
mode meanwhile, the pilot or a failsafe has acted: the request ends there. Every try follows a heartbeat that
shows that nobody has, the first one at once where the last heartbeat still does: it is never sent against a
pilot whose choice is not heard yet. How long a heartbeat shows that is the dialect's (`mode_known_s`).
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.events import FlightMode

from .dialect import CMD_DO_SET_MODE, CUSTOM_MODE_ENABLED, Dialect
from .encoders import Outgoing, command_long

RETRY_S = 1.0
MAX_TRIES = 5
SILENCE_S = 3.0
"""Without a heartbeat for this long after a try, the request is given up."""

_RESULTS: dict[int, str] = {
    number: entry.name.removeprefix("MAV_RESULT_").lower().replace("_", " ")
    for number, entry in mavlink.enums["MAV_RESULT"].items()
}


def result_words(result: int) -> str:
    """MAV_RESULT in words."""
    return _RESULTS.get(result, f"result {result}")


class ModeRequest:
    """Asks for one mode until `confirmed` or `refused` (a reason)."""

    def __init__(
        self,
        mode: FlightMode,
        dialect: Dialect,
        system_id: int,
        from_mode: int,
        now_s: float,
        replaced: ModeRequest | None = None,
        *,
        heard_s: float = -math.inf,
    ) -> None:
        """A request that has not been sent.

        Args:
            from_mode: the vehicle's custom mode in its last heartbeat.
            replaced: what was asked for until now.
            heard_s: when that heartbeat came.
        """
        self.mode = mode
        self.confirmed = False
        self.refused: str | None = None
        self._dialect = dialect
        self._command = dialect.command(mode)
        self._system_id = system_id
        self._from_mode = from_mode
        self._expected = frozenset({from_mode, self._command.custom_mode})
        if replaced is not None:
            # The vehicle may still be on its way to what was asked for before.
            self._expected |= replaced._expected
        self._heard = now_s - heard_s <= dialect.mode_known_s
        self._tries = 0
        self._next_s = now_s + RETRY_S
        self._ack: int | None = None
        self._text: str | None = None

    def may_be_entered(self, now_s: float) -> bool:
        """It was sent so lately that the vehicle may still enter it, or not have said so yet."""
        return self._tries > 0 and now_s <= self._next_s - RETRY_S + SILENCE_S

    def due(self, now_s: float) -> Outgoing | None:
        """The command, when it is time to send it; after the last try the request is refused."""
        if self._tries and now_s < self._next_s:
            return None
        if self._tries == MAX_TRIES or (not self._heard and now_s >= self._next_s - RETRY_S + SILENCE_S):
            self.refused = self._reason()
            return None
        if not self._heard:
            return None
        self._heard = False
        self._next_s = now_s + RETRY_S
        self._tries += 1
        command = self._command
        params = (float(CUSTOM_MODE_ENABLED), command.param2, command.param3)
        return command_long(CMD_DO_SET_MODE, params, self._system_id, confirmation=self._tries - 1)

    def on_heartbeat(self, custom_mode: int) -> None:
        """The vehicle says which mode it is in."""
        self._heard = True
        if custom_mode == self._command.custom_mode:
            self.confirmed = True
        elif custom_mode not in self._expected:
            name = self._dialect.name
            self.refused = (
                f"the vehicle went from {name(self._from_mode)} to {name(custom_mode)} while "
                f"{name(self._command.custom_mode)} was asked for"
            )

    def on_ack(self, result: int) -> None:
        """COMMAND_ACK of DO_SET_MODE."""
        self._ack = result

    def on_text(self, text: str) -> None:
        """A text of the vehicle that came while it was being asked."""
        self._text = text

    def _reason(self) -> str:
        answer = "no answer" if self._ack is None else f"the vehicle answered: {result_words(self._ack)}"
        text = f'; it said: "{self._text}"' if self._text else ""
        name = self._dialect.name(self._command.custom_mode)
        heard = (
            f"still in {self._dialect.name(self._from_mode)}"
            if self._heard
            else "no heartbeat since the last"
        )
        return f"{name} not entered, tries: {self._tries} ({answer}{text}); {heard}"
