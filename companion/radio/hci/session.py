"""Host side of one session with a Bluetooth controller: bytes in, bytes out, time as an argument.

A session covers HCI Reset, probing, set-up, sending and scanning. Every fault ends the session and is
described in `failure`. A new session starts again with Reset. Commands are sent one at a time, when the
controller accepts one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from companion.errors import PeerDataError
from companion.radio.hci.advertising import AdvertisingSet, Done, HciCounts
from companion.radio.hci.controller_events import (
    CommandResult,
    H4Reader,
    HardwareError,
    Report,
    Reports,
    SetTerminated,
    parse_event,
)
from companion.radio.hci.packets import HciCommand, Opcode, Status, status_words
from companion.radio.hci.reports import HeardFrame, Reassembler
from companion.radio.hci.setup import Abilities, RefusedError, set_up

ANSWER_S: Final = 2.0
"""Longest wait for an answer. Controllers answer within milliseconds."""
_RESET_S: Final = 1.0
_RESET_TRIES: Final = 3
"""The first Reset may be lost in a stream that is out of step."""
_ALIVE_S: Final = 2.0
"""After this much silence a command is sent to check whether the controller still answers and scans."""
_MAX_GARBAGE: Final = 4096
_MAX_TROUBLES: Final = 3
"""After this many frames in a row that were not sent, the session restarts with a Reset. It does not restart
if that would interrupt a set that works."""
_IN_USE_S: Final = 5.0
"""A set that sent a frame within this time counts as working."""
_MAX_HEARD: Final = 1024

_WHAT_TO_CHECK: Final = (
    "check that it is a Bluetooth controller with HCI, that no other program uses it, and on a UART the baud "
    "rate and the RTS/CTS lines"
)


class HciSession:
    """One session with a controller.

    Args:
        address: Own random static address, six octets with colons.
        counts: Counts that continue from session to session.
    """

    def __init__(self, address: str, *, send: bool, listen: bool, counts: HciCounts, now_s: float) -> None:
        self.ready = False
        """Set-up is complete."""
        self.failure: str | None = None
        self.stopped = False
        """The controller has answered the Reset of `stop`."""
        self.abilities = Abilities()
        self.sets: dict[str, AdvertisingSet] = {}
        self.heard: deque[HeardFrame] = deque()
        """Frames that may hold Remote ID. The caller removes them."""
        self._counts = counts
        self._reader = H4Reader()
        self._reassembler = Reassembler()
        self._waiting: deque[tuple[HciCommand, Callable[[CommandResult, float], None]]] = deque()
        self._outstanding: Opcode | None = None
        self._answered: Callable[[CommandResult, float], None] | None = None
        self._credit = 1
        self._answer_by_s = float("inf")
        self._alive_s = now_s
        """Time of the last event; of the last report, if it can be checked whether the controller scans."""
        self._resets_sent = 1
        self._reset_answered = False
        self._output: list[bytes] = []
        self._script = set_up(address, send=send, listen=listen)
        self._waiting.append((HciCommand(Opcode.RESET), self._reset_done))
        self._next_command(now_s)

    # ------------------------------------------------------------ input and output

    @property
    def next_s(self) -> float:
        """Latest time for the next call of `tick`."""
        times = [each.next_s for each in self.sets.values()]
        if self._is_idle:
            times.append(self._alive_s + _ALIVE_S)
        return min(self._answer_by_s, *times, float("inf"))

    @property
    def _is_idle(self) -> bool:
        return self._outstanding is None and not self._waiting

    @property
    def can_send(self) -> frozenset[str]:
        """Transports that work now."""
        if not self.ready or self.failure is not None:
            return frozenset()
        return frozenset(name for name, each in self.sets.items() if each.trouble is None)

    @property
    def trouble(self) -> str | None:
        """Current troubles of the advertising sets; None if there are none."""
        return "; ".join(each.trouble for each in self.sets.values() if each.trouble is not None) or None

    def packets(self) -> list[bytes]:
        """Return and clear the packets to send to the controller."""
        output, self._output = self._output, []
        return output

    def offer(self, transport: str, frames: Sequence[bytes], now_s: float) -> None:
        """Queue frames, one advertising event each. They are lost if the radio is not up."""
        target = self.sets.get(transport)
        if target is None or not self.ready or self.failure is not None:
            self._counts.lost += len(frames)
            return
        target.queue.put(frames)
        target.advance(now_s)
        self._next_command(now_s)

    def receive(self, data: bytes, now_s: float) -> None:
        """Process bytes from the controller."""
        if self.failure is not None:
            return
        before = self._reader.dropped
        events = self._reader.feed(data)
        self._counts.garbage += self._reader.dropped - before
        for packet in events:
            try:
                event = parse_event(packet)
            except PeerDataError:
                self._counts.malformed += 1
                continue
            if self.abilities.scan_check is None or isinstance(event, Reports):
                self._alive_s = now_s
            match event:
                case CommandResult():
                    self._result(event, now_s)
                case Reports(reports):
                    for report in reports:
                        self._report(report, now_s)
                case SetTerminated(status, handle):
                    for each in self.sets.values():
                        if each.handle == handle:
                            each.terminated(status, now_s)
                case HardwareError(code):
                    self._fail(f"the controller reports a hardware error (0x{code:02x})")
        if self._reader.dropped_in_row > _MAX_GARBAGE:
            self._fail(f"it sends data, but no HCI events (H4): {_WHAT_TO_CHECK}")
        self.tick(now_s)

    def tick(self, now_s: float) -> None:
        """Process timeouts, and send what is due."""
        if self.failure is not None:
            return
        if now_s >= self._answer_by_s:
            self._no_answer(now_s)
        for each in self.sets.values():
            each.advance(now_s)
            if each.troubles_in_row >= _MAX_TROUBLES and not self._another_works(each, now_s):
                self._fail(f"{each.trouble}, {each.troubles_in_row} times in a row")
        if self._is_idle and now_s - self._alive_s >= _ALIVE_S:
            self._alive_s = now_s
            check = self.abilities.scan_check or HciCommand(Opcode.READ_LOCAL_VERSION_INFORMATION)
            self._waiting.append((check, self._checked))
        self._next_command(now_s)

    def _checked(self, result: CommandResult, now_s: float) -> None:
        # A controller that was reset answers as before, but neither scans nor knows its event mask.
        if self.abilities.scan_check is not None and result.status == Status.SUCCESS:
            self._fail("it no longer scans: it was reset")

    def _another_works(self, troubled: AdvertisingSet, now_s: float) -> bool:
        since_s = max(troubled.troubled_since_s, now_s - _IN_USE_S)
        return any(each.sent_s > since_s for each in self.sets.values())

    def stop(self, now_s: float) -> None:
        """Stop advertising and scanning with a Reset. `stopped` becomes True when it is answered."""
        self.ready = False
        for each in self.sets.values():
            each.queue.clear()
        self.sets = {}
        self._waiting.clear()
        self._waiting.append((HciCommand(Opcode.RESET), self._stop_done))
        self._next_command(now_s)

    # ------------------------------------------------------------ commands, one at a time

    def _submit(self, command: HciCommand, done: Done) -> None:
        """Queue a command of an advertising set."""
        self._waiting.append((command, partial(self._set_result, done)))

    def _set_result(self, done: Done, result: CommandResult, now_s: float) -> None:
        self._counts.refused += result.status != Status.SUCCESS
        done(result.status, now_s)

    def _next_command(self, now_s: float) -> None:
        if self._outstanding is not None or not self._waiting or self.failure is not None:
            return
        if self._credit < 1:
            if self._answer_by_s == float("inf"):
                self._answer_by_s = now_s + ANSWER_S
            return
        command, self._answered = self._waiting.popleft()
        self._outstanding = command.opcode
        self._credit -= 1
        self._answer_by_s = now_s + (_RESET_S if command.opcode is Opcode.RESET else ANSWER_S)
        self._output.append(command.packet())

    def _result(self, result: CommandResult, now_s: float) -> None:
        if not self._reset_answered and result.opcode != Opcode.RESET:
            return  # left over from the previous user of the controller
        self._credit = result.credit
        if result.opcode != self._outstanding:
            if self._outstanding is None and result.credit:
                self._answer_by_s = float("inf")  # we only waited for permission to send a command
            return
        self._outstanding = None
        self._answer_by_s = float("inf")
        assert self._answered is not None
        self._answered(result, now_s)

    def _no_answer(self, now_s: float) -> None:
        if self._outstanding is None:
            self._fail("the controller accepts no more commands")
        elif self._reset_answered:
            self._fail(f"no answer to {self._outstanding.words}: {_WHAT_TO_CHECK}")
        elif self._resets_sent < _RESET_TRIES:
            self._resets_sent += 1
            self._output.append(HciCommand(Opcode.RESET).packet())
            self._answer_by_s = now_s + _RESET_S
        elif self._reader.dropped:
            self._fail(f"no answer to Reset, only bytes that are not HCI events (H4): {_WHAT_TO_CHECK}")
        else:
            self._fail(f"no answer to Reset: {_WHAT_TO_CHECK}")

    def _fail(self, why: str) -> None:
        if self.failure is None:
            self.failure = why
            for each in self.sets.values():
                each.queue.clear()

    # ------------------------------------------------------------ set-up

    def _reset_done(self, result: CommandResult, now_s: float) -> None:
        self._reset_answered = True
        if result.status != Status.SUCCESS:
            self._fail(f"Reset: {status_words(result.status)}")
            return
        self._step(partial(next, self._script), now_s)

    def _stop_done(self, result: CommandResult, now_s: float) -> None:
        self.stopped = True

    def _step(self, resume: Callable[[], HciCommand], now_s: float) -> None:
        """Advance the set-up to its next command."""
        try:
            command = resume()
        except StopIteration as end:
            self.abilities = end.value
            self.sets = {
                transport: AdvertisingSet(transport, commands, self._counts, self._submit)
                for transport, commands in self.abilities.sets.items()
            }
            self.ready = self.failure is None
        except (RefusedError, PeerDataError) as error:
            self._fail(str(error))
        else:
            self._waiting.append((command, partial(self._script_answered, command)))

    def _script_answered(self, command: HciCommand, result: CommandResult, now_s: float) -> None:
        if result.status == Status.SUCCESS:
            self._step(partial(self._script.send, result.data), now_s)
        else:
            self._step(partial(self._script.throw, RefusedError(command, result.status)), now_s)

    # ------------------------------------------------------------ receiving

    def _report(self, report: Report, now_s: float) -> None:
        frame = self._reassembler.add_report(report, now_s)
        if frame is None:
            return
        if len(self.heard) >= _MAX_HEARD:
            self.heard.popleft()
            self._counts.overrun += 1
        self.heard.append(frame)
