"""Troubles that do not end the flight.

Each kind is reported once, on the console and to the pilot, and shown in the status for as long as it lasts.
"""

from __future__ import annotations

import enum
from collections.abc import Callable

from companion.events import Say, Severity


class Trouble(enum.Enum):
    """Kinds of trouble. The value is the text for the pilot, which fits one STATUSTEXT."""

    NOT_RECORDED = "DMUCA: this flight is not recorded"
    SLOW_DISK = "DMUCA: the disk is too slow for the record"
    SETTINGS_UNREAD = "DMUCA: stored settings are not used"
    SETTINGS_NOT_KEPT = "DMUCA: settings cannot be saved to disk"
    SIGNING_UNREAD = "DMUCA: the last signing time is unknown"
    SIGNING_CLOCK = "DMUCA: the clock for signing is wrong"
    RADIO_MISSING = "DMUCA: Remote ID radio does not work"
    SIGNING_NOT_KEPT = "DMUCA: signing time cannot be saved to disk"


class Troubles:
    """The troubles of one flight.

    Args:
        say: receives lines for the console.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._lasting: dict[Trouble, str] = {}
        self._told: set[Trouble] = set()
        self._for_pilot: list[Say] = []

    @property
    def texts(self) -> tuple[str, ...]:
        """Texts of the troubles that still last."""
        return tuple(self._lasting.values())

    def note(self, kind: Trouble, text: str | None) -> None:
        """Update the state of one kind of trouble.

        Args:
            text: text for the console; None if there is no such trouble, or no longer.
        """
        if text is None:
            self._lasting.pop(kind, None)
            return
        self._lasting[kind] = text
        if kind not in self._told:
            self._told.add(kind)
            self._say(f"{text}; the flight continues")
            self._for_pilot.append(Say(severity=Severity.WARNING, text=kind.value))

    def pop_messages(self) -> list[Say]:
        """Return the messages to the pilot that have not been taken yet, and mark them as taken."""
        said, self._for_pilot = self._for_pilot, []
        return said
