"""A Bluetooth controller driven with raw HCI. It sends BLE 4 and BLE 5 Long Range at once, and scans.

A separate thread talks to the controller. Frames thus follow each other at the pace of the controller and not
of the flight loop, and a lost controller is reopened while the flight goes on.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Final

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.frames_io import FrameReceiver, FrameSender
from companion.radio.hci.advertising import NAMES, HciCounts
from companion.radio.hci.channel import READ_SIZE, Channel, open_channel
from companion.radio.hci.reports import HeardFrame
from companion.radio.hci.section import HciRadio
from companion.radio.hci.session import HciSession
from companion.radio.radio import Health, RadioContext
from companion.remote_id.messages import Message
from companion.remote_id.transports import BLE5

_MAX_FRAMES: Final = 256
"""Maximum number of frames read per call of `heard`, so that a flood does not hold up the loop."""
_SELECT_S: Final = 0.25
_FLOOD_PAUSE_S: Final = 0.002
"""Pause after a full read, because this thread shares the processor with the flight loop."""
_GOODBYE_S: Final = 0.5
_PAUSE_S: Final = 1.0
"""Pause before the first attempt to reopen a lost controller. It doubles with each further attempt."""
_LONGEST_PAUSE_S: Final = 15.0
_STEADY_S: Final = 20.0
"""After a session that lasted this long, the pause starts again at its first value."""
_JOIN_S: Final = 10.0


class _Link:
    """A channel and its session. One thread uses it at a time; `lock` guards the session."""

    def __init__(
        self, channel: Channel, session: HciSession, lock: threading.Lock, woken: socket.socket
    ) -> None:
        self.channel = channel
        self.session = session
        self._lock = lock
        self._woken = woken
        self._output: deque[bytes] = deque()

    def pump(self, longest_s: float = _SELECT_S) -> bool:
        """Send pending packets, wait, and process what arrived. Return True after a full read.

        After a full read, more data is probably waiting.

        Raises:
            OSError: the channel is lost.
        """
        with self._lock:
            now_s = time.monotonic()
            self.session.tick(now_s)
            self._output += self.session.packets()
            wait_s = min(max(0.0, self.session.next_s - now_s), longest_s)
        self._write()
        mine, woken = self.channel.fileno(), self._woken.fileno()
        readable, _, _ = select.select([mine, woken], [mine] if self._output else [], [], wait_s)
        if woken in readable:
            self._woken.recv(256)
        if mine not in readable:
            return False
        data = self.channel.receive()
        with self._lock:
            self.session.receive(data, time.monotonic())
        return len(data) == READ_SIZE

    def say_goodbye(self) -> None:
        """Stop advertising and scanning, if the controller still answers."""
        end_s = time.monotonic() + _GOODBYE_S
        with self._lock:
            self.session.stop(time.monotonic())
        with contextlib.suppress(OSError):
            while not self.session.stopped and self.session.failure is None and time.monotonic() < end_s:
                self.pump(0.05)

    def _write(self) -> None:
        while self._output:
            packet = self._output[0]
            taken = self.channel.send(packet)
            if taken < len(packet):
                self._output[0] = packet[taken:]
                return
            self._output.popleft()


class HciTransport:
    """A `Radio` that uses a Bluetooth controller which no other software uses.

    Args:
        channel: user:NUMBER, uart:DEVICE:BAUD or tcp:HOST:PORT (config key radio.channel).
        address: Own radio address, as `frames_io.radio_address` derives it.
        send: Advertise.
        listen: Scan.

    Raises:
        ConfigError: no channel, no controller behind it, or a controller that supports none of this.
    """

    def __init__(self, channel: str, address: str, *, send: bool, listen: bool) -> None:
        self._name = channel
        self._address = address
        self._send = send
        self._listen = listen
        self._sender = FrameSender(address)
        self._receiver = FrameReceiver()
        self._counts = HciCounts()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._woken, self._waker = socket.socketpair()
        self._woken.setblocking(False)
        self._waker.setblocking(False)
        self._lost: str | None = None
        """Why there is no controller now."""
        try:
            self._link: _Link | None = self._bring_up()
        except BaseException:
            self._close_wakers()
            raise
        abilities = self._link.session.abilities
        self._capabilities = frozenset(abilities.sets)
        self._per_pack = abilities.messages_per_pack
        self._missing = tuple(abilities.missing)
        self._thread = threading.Thread(target=self._run, name=f"hci {channel}", daemon=True)
        self._thread.start()

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that the controller can advertise on."""
        return self._capabilities

    @property
    def hears(self) -> frozenset[str]:
        """Transports that it scans for; none while there is no controller."""
        with self._lock:
            link = self._link
            if link is None or link.session.failure is not None:
                return frozenset()
            return link.session.abilities.hears

    @property
    def own_addresses(self) -> frozenset[str]:
        """The address that all its advertising sets share."""
        return frozenset((self._address,)) if self._send else frozenset()

    @property
    def wifi_channel(self) -> int | None:
        """Always None for Bluetooth."""
        return None

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Do nothing, because every frame is an advertising event of its own."""
        return ()

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once. Raises ValueError for a transport outside `capabilities`."""
        if transport not in self._capabilities:
            allowed = ", ".join(sorted(self._capabilities)) or "none"
            raise ValueError(f"transport is {transport!r}; allowed on this controller: {allowed}")
        chunk = self._per_pack if transport == BLE5 else len(messages)
        frames = [
            frame
            for start in range(0, len(messages), max(1, chunk))
            for frame in self._sender.frames(transport, messages[start : start + chunk])
        ]
        with self._lock:
            if self._link is None:
                self._counts.lost += len(frames)
                return
            self._link.session.offer(transport, frames, time.monotonic())
        self._wake()

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return what arrived since the last call, up to a limit. Bad frames are counted, never raised."""
        frames: list[HeardFrame] = []
        with self._lock:
            waiting = self._link.session.heard if self._link is not None else None
            while waiting and len(frames) < _MAX_FRAMES:
                frames.append(waiting.popleft())
        received = (self._receiver.receive(f.transport, f.address, f.data, f.rssi_dbm) for f in frames)
        return [event for event in received if event is not None]

    def health(self, now_s: float) -> Health:
        """Report the controller's state. `frames_sent` counts the advertising events that it confirmed."""
        with self._lock:
            link = self._link
            failure = self._lost if link is None else link.session.failure
            trouble = None if link is None else link.session.trouble or self._loss(link.session)
            can_send = frozenset() if link is None else link.session.can_send
            counts = self._counts
            sent, lost, refused = counts.sent, counts.lost, counts.refused
            unconfirmed, malformed, overrun = counts.unconfirmed, counts.malformed, counts.overrun
        if not self._thread.is_alive() and not self._closed.is_set():
            failure, can_send = "its thread has ended; this is a fault of this program", frozenset()
        ok = failure is None and trouble is None and not self._closed.is_set()
        parts = [self._state(failure, trouble)]
        if lost:
            parts.append(f"{lost} frames could not be sent")
        if refused:
            parts.append(f"{refused} commands refused")
        if unconfirmed:
            parts.append(f"{unconfirmed} advertising events not confirmed")
        if overrun:
            parts.append(f"{overrun} received frames lost because they came too fast")
        return Health(
            ok=ok,
            text="; ".join(parts),
            frames_sent=sent,
            frames_heard=self._receiver.heard,
            bad_frames=self._receiver.bad + malformed,
            can_send=(can_send & self._capabilities) if failure is None else frozenset(),
            missing=self._missing,
        )

    def close(self) -> None:
        """Stop advertising and scanning, and release the channel."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake()
        self._thread.join(_JOIN_S)
        if not self._thread.is_alive():
            self._close_wakers()

    def _loss(self, session: HciSession) -> str | None:
        """What a controller that was reopened lacks of what it had at first."""
        lost = self._capabilities - session.sets.keys() if session.failure is None else frozenset()
        if not lost:
            return None
        what = " and ".join(NAMES[name] for name in sorted(lost))
        return "; ".join((f"no {what} since it was reopened", *session.abilities.missing))

    def _state(self, failure: str | None, trouble: str | None) -> str:
        where = f"Bluetooth controller on {self._name}"
        if self._closed.is_set():
            return f"{where}: closed"
        if failure is not None:
            return f"{where}: lost, trying again: {failure}"
        if trouble is not None:
            return f"{where}: {trouble}"
        does = [" and ".join(NAMES[name] for name in sorted(self._capabilities))] if self._send else []
        if self._listen:
            does.append("scanning")
        return f"{where}: {', '.join(does)}"

    # ------------------------------------------------------------ the thread

    def _run(self) -> None:
        pause_s = _PAUSE_S
        while not self._closed.is_set():
            if self._link is None:
                if self._closed.wait(pause_s):
                    return
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                try:
                    link = self._bring_up()
                except Exception as error:  # `health` reports it; a radio's fault must not end the flight
                    with self._lock:
                        self._lost = str(error) if isinstance(error, ConfigError) else _fault(error)
                    continue
                with self._lock:
                    self._link = link
            since_s = time.monotonic()
            self._serve(self._link)
            if time.monotonic() - since_s > _STEADY_S:
                pause_s = _PAUSE_S

    def _serve(self, link: _Link) -> None:
        """Run a session until the controller is lost or this transport is closed."""
        try:
            while not self._closed.is_set() and link.session.failure is None:
                if link.pump():
                    self._closed.wait(_FLOOD_PAUSE_S)
            if self._closed.is_set():
                link.say_goodbye()
            failure = link.session.failure
        except OSError as error:
            failure = error.strerror or str(error)
        except Exception as error:  # the radio continues: a new session starts with a Reset
            failure = _fault(error)
        link.channel.close()
        with self._lock:
            self._lost = failure or "closed"
            self._link = None
            for each in link.session.sets.values():
                each.queue.clear()

    def _bring_up(self) -> _Link:
        """Open the channel and set up the controller.

        Raises:
            ConfigError: one of the two failed.
        """
        channel = open_channel(self._name)
        session = HciSession(
            self._address, send=self._send, listen=self._listen, counts=self._counts, now_s=time.monotonic()
        )
        link = _Link(channel, session, self._lock, self._woken)
        try:
            while not session.ready and session.failure is None and not self._closed.is_set():
                link.pump()
            if not session.ready:
                raise ConfigError(f"radio.channel: {self._name}: {session.failure or 'closed'}")
        except OSError as error:
            channel.close()
            raise ConfigError(f"radio.channel: {self._name}: {error.strerror or error}") from error
        except BaseException:
            channel.close()
            raise
        return link

    def _wake(self) -> None:
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    def _close_wakers(self) -> None:
        self._woken.close()
        self._waker.close()


def _fault(error: Exception) -> str:
    return f"a fault of this program: {error!r}"


def open_radio(section: HciRadio, context: RadioContext) -> HciTransport:
    """Open the controller that a configuration names.

    Raises:
        ConfigError: it cannot be opened. The text says what is missing.
    """
    return HciTransport(section.channel, context.address, send=section.send, listen=section.listen)
