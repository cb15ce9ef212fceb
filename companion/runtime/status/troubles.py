"""What goes wrong beside the flight and does not end it: told once of each kind, on the console and to the
pilot, and shown for as long as it lasts."""

from __future__ import annotations

import enum
from collections.abc import Callable

from companion.events import Say, Severity


class Trouble(enum.Enum):
    """The kinds, each with the pilot's words: they fit one STATUSTEXT."""

    NOT_RECORDED = "DMUCA: this flight is not recorded"
    SLOW_DISK = "DMUCA: the disk is too slow for the record"
    SETTINGS_UNREAD = "DMUCA: stored settings are not used"
    SETTINGS_NOT_KEPT = "DMUCA: settings are not kept on the disk"
    SIGNING_UNREAD = "DMUCA: the last signing time is not known"
    SIGNING_NOT_KEPT = "DMUCA: signing time is not kept on the disk"


class Troubles:
    """Of one flight.

    Args:
        say: takes lines for the console.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._lasting: dict[Trouble, str] = {}
        self._told: set[Trouble] = set()
        self._for_pilot: list[Say] = []

    @property
    def texts(self) -> tuple[str, ...]:
        """Those that last."""
        return tuple(self._lasting.values())

    def note(self, kind: Trouble, text: str | None) -> None:
        """How it stands with one kind now.

        Args:
            text: the console's words; None: all is well, or well again.
        """
        if text is None:
            self._lasting.pop(kind, None)
            return
        self._lasting[kind] = text
        if kind not in self._told:
            self._told.add(kind)
            self._say(f"{text}; the flight goes on")
            self._for_pilot.append(Say(severity=Severity.WARNING, text=kind.value))

    def take(self) -> list[Say]:
        """What the pilot has not been told yet; from now on he has."""
        said, self._for_pilot = self._for_pilot, []
        return said
