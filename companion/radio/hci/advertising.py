"""One advertising set: frames go out one by one, one advertising event each, and are counted when they did.

A set stops by itself after its event, so what is on the air is never older than what was asked last, and
nothing stays there when this program ends in whatever way. Not so on a controller without extended
advertising: there the last frame of a killed program goes on, until the controller is reset or unplugged.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from companion.radio.hci import packets
from companion.radio.hci.packets import HciCommand, Status, status_words
from companion.remote_id.transports import BLE4, BLE5

NAMES: Final = {BLE4: "BLE 4", BLE5: "BLE 5 Long Range"}

_MAX_WAITING: Final = 32
_CONFIRM_S: Final = 0.5
"""An event lasts 20 ms at most and begins within 10 ms; the controller may have others to do before."""
_LEGACY_EVENT_S: Final = 0.125
"""Legacy advertising knows no number of events and is switched off by hand. It begins at once or after the
first interval of 100 ms, as the controller likes: a frame goes out once or twice, with the same counter."""
_FORGIVEN_S: Final = 5.0
"""A trouble is believed to last this long; then the set may be tried again."""
_SENT: Final = frozenset((Status.SUCCESS, Status.ADVERTISING_TIMEOUT, Status.LIMIT_REACHED))
"""Limit Reached is what the standard asks for. No duration is ever set, so that a controller which says
Advertising Timeout can mean nothing else."""

_MESSAGE_AT: Final = 6
"""Offset of the message in a BLE 4 frame."""
_MANIFOLD: Final = frozenset((0, 2))
"""Message types that stand side by side (Basic ID, Authentication): their next byte tells them apart."""

Key = tuple[int, ...]
_FIRST: Final[Key] = (1,)
"""The Location on BLE 4."""


@dataclass(slots=True)
class HciCounts:
    """What happened so far, whatever controllers and channels came and went."""

    sent: int = 0
    """Advertising events that the controller confirmed."""
    lost: int = 0
    """Frames that never went out: the radio was down, or too many waited."""
    replaced: int = 0
    """Frames overtaken by a newer one of their kind."""
    refused: int = 0
    """Commands with an error in the answer."""
    unconfirmed: int = 0
    """Advertising events that the controller was given but never reported."""
    malformed: int = 0
    """Events that could not be read."""
    garbage: int = 0
    """Bytes that belonged to no event."""
    overrun: int = 0
    """Frames heard that nobody took in time."""


def frame_key(transport: str, index: int, frame: bytes) -> Key:
    """What a newer frame replaces: the same message on BLE 4, the pack of the same place elsewhere."""
    if transport != BLE4:
        return (index,)
    kind = frame[_MESSAGE_AT] >> 4
    return (kind, frame[_MESSAGE_AT + 1]) if kind in _MANIFOLD else (kind,)


class FrameQueue:
    """Frames that wait for their set: first come, first served, but Locations before all.

    Never two Locations in a row while others wait: on a controller slower than the asked rate they would
    leave no time for the identity.
    """

    def __init__(self, transport: str, counts: HciCounts) -> None:
        self._transport = transport
        self._counts = counts
        self._waiting: dict[Key, bytes] = {}
        self._was_first = False

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, frames: Sequence[bytes]) -> None:
        """Add frames of one broadcast."""
        for index, frame in enumerate(frames):
            key = frame_key(self._transport, index, frame)
            if key in self._waiting:
                self._counts.replaced += 1
            elif len(self._waiting) >= _MAX_WAITING:
                del self._waiting[next(other for other in self._waiting if other != _FIRST)]
                self._counts.lost += 1
            self._waiting[key] = frame

    def take(self) -> bytes | None:
        """The next frame."""
        if not self._waiting:
            return None
        key = next(iter(self._waiting))
        if self._transport == BLE4 and _FIRST in self._waiting:
            other = next((key for key in self._waiting if key != _FIRST), _FIRST)
            key = other if self._was_first else _FIRST
        self._was_first = key == _FIRST
        return self._waiting.pop(key)

    def clear(self) -> None:
        """Give up what waits: it would go out late."""
        self._counts.lost += len(self._waiting)
        self._waiting.clear()


class SetCommands:
    """How a set is driven with the extended commands."""

    confirms: Final = True
    """The controller reports the end of the event."""
    event_s: Final = _CONFIRM_S

    def __init__(self, handle: int) -> None:
        self.handle = handle

    def load(self, frame: bytes) -> list[HciCommand]:
        """New data."""
        return packets.set_data(self.handle, frame)

    def enable(self) -> HciCommand:
        """One event."""
        return packets.set_enable(self.handle, 1)

    def disable(self) -> HciCommand:
        """Off."""
        return packets.set_disable(self.handle)


class LegacyCommands:
    """How the only set of a controller without extended advertising is driven."""

    confirms: Final = False
    event_s: Final = _LEGACY_EVENT_S
    handle: Final = 0

    def load(self, frame: bytes) -> list[HciCommand]:
        """New data."""
        return [packets.legacy_data(frame)]

    def enable(self) -> HciCommand:
        """Events, 100 ms apart, until disabled."""
        return packets.legacy_enable(True)

    def disable(self) -> HciCommand:
        """Off."""
        return packets.legacy_enable(False)


class _State(enum.Enum):
    IDLE = enum.auto()
    LOADING = enum.auto()
    ENABLING = enum.auto()
    ON_AIR = enum.auto()
    DISABLING = enum.auto()
    ENDED = enum.auto()
    """Counted; only the answer to Enable or Disable is still to come."""


Done = Callable[[int, float], None]
"""Called with a command's status and the time."""


class AdvertisingSet:
    """The states of one set.

    Args:
        submit: hands a command to the controller, and calls back with its status.
    """

    def __init__(
        self,
        transport: str,
        commands: SetCommands | LegacyCommands,
        counts: HciCounts,
        submit: Callable[[HciCommand, Done], None],
    ) -> None:
        self.transport = transport
        self.handle = commands.handle
        self.trouble: str | None = None
        """Why the last frame did not go out."""
        self.troubles_in_row = 0
        self.troubled_since_s = float("-inf")
        """The first of these."""
        self.sent_s = float("-inf")
        """When the last frame was confirmed."""
        self._trouble_s = float("-inf")
        self.queue = FrameQueue(transport, counts)
        self._commands = commands
        self._counts = counts
        self._submit = submit
        self._state = _State.IDLE
        self._to_load: list[HciCommand] = []
        self._until_s = float("inf")

    @property
    def next_s(self) -> float:
        """When `advance` has to be called at the latest."""
        return self._until_s if self._state is _State.ON_AIR else float("inf")

    def advance(self, now_s: float) -> None:
        """Begin the next frame, or end one whose time is over."""
        if self.trouble is not None and now_s - self._trouble_s > _FORGIVEN_S:
            self.trouble = None
        if self._state is _State.IDLE:
            frame = self.queue.take()
            if frame is not None:
                self._to_load = self._commands.load(frame)
                self._load()
        elif self._state is _State.ON_AIR and now_s >= self._until_s:
            if self._commands.confirms:
                self._counts.unconfirmed += 1
                self._note(f"{NAMES[self.transport]}: advertising was not confirmed", now_s)
            self._state = _State.DISABLING
            self._submit(self._commands.disable(), self._disabled)

    def terminated(self, status: int, now_s: float) -> None:
        """The controller reports that the set has stopped."""
        awaited = self._state in (_State.ENABLING, _State.ON_AIR, _State.DISABLING)
        if not awaited or not self._commands.confirms:
            return
        if status in _SENT:
            self._sent(now_s)
        else:
            self._note(f"{NAMES[self.transport]}: advertising ended: {status_words(status)}", now_s)
        if self._state is _State.ON_AIR:
            self._state = _State.IDLE
            self.advance(now_s)
        else:
            self._state = _State.ENDED

    def _load(self) -> None:
        self._state = _State.LOADING
        self._submit(self._to_load.pop(0), self._loaded)

    def _loaded(self, status: int, now_s: float) -> None:
        if self._is_refused(status, now_s):
            return
        if self._to_load:
            self._load()
            return
        self._state = _State.ENABLING
        self._submit(self._commands.enable(), self._enabled)

    def _enabled(self, status: int, now_s: float) -> None:
        if self._state is _State.ENDED:
            self._state = _State.IDLE
            self.advance(now_s)
        elif not self._is_refused(status, now_s):
            self._state = _State.ON_AIR
            self._until_s = now_s + self._commands.event_s

    def _disabled(self, status: int, now_s: float) -> None:
        if self._is_refused(status, now_s):
            return
        if not self._commands.confirms:
            self._sent(now_s)
        self._state = _State.IDLE
        self.advance(now_s)

    def _is_refused(self, status: int, now_s: float) -> bool:
        if status == Status.SUCCESS:
            return False
        self._note(f"{NAMES[self.transport]}: {status_words(status)}", now_s)
        self._state = _State.IDLE
        if self.troubles_in_row < 2:  # what is queued would meet the same answer at once
            self.advance(now_s)
        return True

    def _sent(self, now_s: float) -> None:
        self._counts.sent += 1
        self.sent_s = now_s
        self.trouble = None
        self.troubles_in_row = 0

    def _note(self, trouble: str, now_s: float) -> None:
        self.trouble = trouble
        self._trouble_s = now_s
        if not self.troubles_in_row:
            self.troubled_since_s = now_s
        self.troubles_in_row += 1
