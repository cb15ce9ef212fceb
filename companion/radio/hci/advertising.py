"""One advertising set. It sends frames one by one, in one advertising event each, and counts those sent.

A set stops by itself after its event. Therefore nothing outdated is on the air, and nothing stays there after
this program ends in any way. A controller without extended advertising is different: the last frame of a
killed program is repeated until the controller is reset or unplugged.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from companion.radio.hci import packets
from companion.radio.hci.packets import HciCommand, Status, status_words
from companion.remote_id.codec import MESSAGE_SIZE, PACK_HEADER_SIZE
from companion.remote_id.transports import BLE4, BLE5

NAMES: Final = {BLE4: "BLE 4", BLE5: "BLE 5 Long Range"}

_MAX_WAITING: Final = 32
_CONFIRM_S: Final = 0.5
"""Longest wait for a confirmation. An event lasts at most 20 ms and begins within 10 ms, but the controller
may have other events to process first."""
_LEGACY_EVENT_S: Final = 0.125
"""Legacy advertising has no event count and is switched off by a command. It begins at once or after the
first interval of 100 ms, depending on the controller. A frame is therefore sent once or twice, with the same
counter."""
_SLOW_S: Final = 1.0
"""A set that needs longer than this for a frame is in trouble until it is done with it. Regions require a
Location every second. A UART that received frames fill holds up the answers to commands, for instance."""
_FORGIVEN_S: Final = 5.0
"""A trouble is cleared after this time, so that the set may be tried again."""
_SENT: Final = frozenset((Status.SUCCESS, Status.ADVERTISING_TIMEOUT, Status.LIMIT_REACHED))
"""The standard requires Limit Reached. We never set a duration, so a controller that reports Advertising
Timeout must mean the same."""

_MESSAGE_AT: Final = 6
"""Offset of the message in a BLE 4 frame, and of the pack in a BLE 5 frame."""
_MANIFOLD: Final = frozenset((0, 2))
"""Message types of which several may coexist (Basic ID, Authentication). The next byte tells them apart."""

Key = tuple[int, ...]
_FIRST: Final[Key] = (1,)
"""Key of the Location on BLE 4."""


@dataclass(slots=True)
class HciCounts:
    """Counts since the start, across all controllers and channels."""

    sent: int = 0
    """Advertising events that the controller confirmed."""
    lost: int = 0
    """Frames that were never sent, because the radio was down or too many were waiting."""
    replaced: int = 0
    """Frames replaced by a newer one of their kind before they were sent."""
    refused: int = 0
    """Commands that the controller answered with an error."""
    unconfirmed: int = 0
    """Advertising events that were started but never reported by the controller."""
    malformed: int = 0
    """HCI events that could not be parsed."""
    garbage: int = 0
    """Bytes that belonged to no HCI event."""
    overrun: int = 0
    """Received frames that were dropped because they were not fetched in time."""


def frame_key(transport: str, frame: bytes) -> Key:
    """Return the key under which a newer frame replaces an older one: the kinds of its messages.

    A pack never replaces one of other kinds. A signed pack, or its part on a controller with small packs, may
    follow a pack at once, and does not hold the same messages.
    """
    first = _MESSAGE_AT if transport == BLE4 else _MESSAGE_AT + PACK_HEADER_SIZE
    kinds: list[int] = []
    for at in range(first, len(frame) - 1, MESSAGE_SIZE):
        kind = frame[at] >> 4
        kinds += (kind, frame[at + 1]) if kind in _MANIFOLD else (kind,)
    return tuple(kinds)


class FrameQueue:
    """Frames that wait for their set: first in, first out, but Locations take precedence.

    Two Locations are never sent in a row while other frames wait. On a controller slower than the requested
    rate they would leave no time for the identity.
    """

    def __init__(self, transport: str, counts: HciCounts) -> None:
        self._transport = transport
        self._counts = counts
        self._waiting: dict[Key, bytes] = {}
        self._was_first = False

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, frames: Sequence[bytes]) -> None:
        """Add the frames of one broadcast."""
        for frame in frames:
            key = frame_key(self._transport, frame)
            if key in self._waiting:
                self._counts.replaced += 1
            elif len(self._waiting) >= _MAX_WAITING:
                del self._waiting[next(other for other in self._waiting if other != _FIRST)]
                self._counts.lost += 1
            self._waiting[key] = frame

    def pop_frame(self) -> bytes | None:
        """Remove and return the next frame; None if none waits."""
        if not self._waiting:
            return None
        key = next(iter(self._waiting))
        if self._transport == BLE4 and _FIRST in self._waiting:
            other = next((key for key in self._waiting if key != _FIRST), _FIRST)
            key = other if self._was_first else _FIRST
        self._was_first = key == _FIRST
        return self._waiting.pop(key)

    def clear(self) -> None:
        """Drop the waiting frames, because they would be sent late."""
        self._counts.lost += len(self._waiting)
        self._waiting.clear()


class SetCommands:
    """Drives a set with the extended commands."""

    confirms: Final = True
    """The controller reports the end of each advertising event."""
    event_s: Final = _CONFIRM_S

    def __init__(self, handle: int) -> None:
        self.handle = handle

    def load(self, frame: bytes) -> list[HciCommand]:
        """Return the commands that load new data."""
        return packets.set_data(self.handle, frame)

    def enable(self) -> HciCommand:
        """Return the command that starts one event."""
        return packets.set_enable(self.handle, 1)

    def disable(self) -> HciCommand:
        """Return the command that stops advertising."""
        return packets.set_disable(self.handle)


class LegacyCommands:
    """Drives the only set of a controller without extended advertising."""

    confirms: Final = False
    event_s: Final = _LEGACY_EVENT_S
    handle: Final = 0

    def load(self, frame: bytes) -> list[HciCommand]:
        """Return the commands that load new data.

        The parameters are set for each frame. A controller that was reset would advertise as a connectable
        device with its own address. Now it refuses, because it has lost the random address.
        """
        return [packets.legacy_parameters(), packets.legacy_data(frame)]

    def enable(self) -> HciCommand:
        """Return the command that starts events, 100 ms apart, until disabled."""
        return packets.legacy_enable(True)

    def disable(self) -> HciCommand:
        """Return the command that stops advertising."""
        return packets.legacy_enable(False)


class _State(enum.Enum):
    IDLE = enum.auto()
    LOADING = enum.auto()
    ENABLING = enum.auto()
    ON_AIR = enum.auto()
    DISABLING = enum.auto()
    ENDED = enum.auto()
    """The event was counted. Only the answer to Enable or Disable is pending."""


Done = Callable[[int, float], None]
"""Callback that receives a command's status and the time."""


class AdvertisingSet:
    """State machine of one advertising set.

    Args:
        submit: Hands a command to the controller, and calls back with its status.
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
        """Why the last frame was not sent."""
        self.troubles_in_row = 0
        self.troubled_since_s = float("-inf")
        """Time of the first trouble in the current row."""
        self.sent_s = float("-inf")
        """Time of the last confirmed frame."""
        self._trouble_s = float("-inf")
        self.queue = FrameQueue(transport, counts)
        self._commands = commands
        self._counts = counts
        self._submit = submit
        self._state = _State.IDLE
        self._to_load: list[HciCommand] = []
        self._until_s = float("inf")
        self._slow_s = float("inf")
        """Time at which the frame that is being sent has taken too long."""

    @property
    def next_s(self) -> float:
        """Latest time for the next call of `advance`."""
        if self._state is _State.IDLE:
            return float("inf")
        return min(self._until_s if self._state is _State.ON_AIR else float("inf"), self._slow_s)

    def advance(self, now_s: float) -> None:
        """Start the next frame, or end one whose time is over."""
        if self.trouble is not None and now_s - self._trouble_s > _FORGIVEN_S:
            self.trouble = None
        if self._state is _State.IDLE:
            frame = self.queue.pop_frame()
            if frame is not None:
                self._slow_s = now_s + _SLOW_S
                self._to_load = self._commands.load(frame)
                self._load()
            return
        if now_s >= self._slow_s:
            self._slow_s = float("inf")
            self._note(f"{NAMES[self.transport]}: a frame takes longer than {_SLOW_S:g} s", now_s)
        if self._state is _State.ON_AIR and now_s >= self._until_s:
            if self._commands.confirms:
                self._counts.unconfirmed += 1
                self._note(f"{NAMES[self.transport]}: advertising was not confirmed", now_s)
            self._state = _State.DISABLING
            self._submit(self._commands.disable(), self._disabled)

    def terminated(self, status: int, now_s: float) -> None:
        """Handle the controller's report that the set has stopped."""
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
        if self.troubles_in_row < 2:  # queued frames would get the same answer now
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
