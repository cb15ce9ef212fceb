"""Simulated radio: exchanges real Remote ID frames with the simulated air, over UDP on loopback."""

from __future__ import annotations

import socket
from collections.abc import Mapping

from companion.errors import ConfigError, PeerDataError
from companion.events import RemoteIdHeard
from companion.radio.ether import datagrams
from companion.radio.ether.datagrams import Heard, Join, Leave, Send, Welcome
from companion.radio.ether.section import EtherRadio
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender
from companion.radio.radio import Health, RadioContext
from companion.remote_id.messages import Message

_MAX_READS = 256
"""Maximum number of datagrams read per call, so that a flood does not hold up the loop."""
_SILENT_AFTER_S = 3 * datagrams.JOIN_PERIOD_S


class EtherTransport:
    """A `Radio` that is a client of the simulated air.

    Args:
        endpoint: "HOST:PORT" of the air (config key radio.address).
        name: Name of this aircraft in the air's statistics, up to 80 bytes of UTF-8.
        address: Own radio address, as `frames_io.radio_address` derives it.

    Raises:
        ConfigError: `endpoint` has a wrong form or cannot be resolved.
    """

    def __init__(self, endpoint: str, name: str, address: str) -> None:
        host, port = datagrams.parse_endpoint(endpoint, "radio.address")
        if port == 0:
            raise ConfigError(f"radio.address: {endpoint!r}: port 0; allowed: 1 to 65535")
        self._endpoint = endpoint
        self._address = address
        self._sender = FrameSender(address)
        self._receiver = FrameReceiver()
        self._join = datagrams.encode(Join(name))
        self._joined_s: float | None = None
        self._answered_s: float | None = None
        self._now_s = 0.0
        self._sent = 0
        self._unsent = 0
        self._bad_datagrams = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))
        except (OSError, TypeError) as error:  # TypeError: a zero byte in the name
            self._socket.close()
            raise ConfigError(f"radio.address: {endpoint!r}: {error}") from error
        # Join before sending the first frame, so that no frame of others is missed meanwhile.
        self._put(self._join)

    @property
    def capabilities(self) -> frozenset[str]:
        """All simulated transports."""
        return TRANSPORTS

    @property
    def hears(self) -> frozenset[str]:
        """All transports while the air answers, because it delivers every frame of the others."""
        return TRANSPORTS if self._answers(self._now_s) else frozenset()

    @property
    def own_addresses(self) -> frozenset[str]:
        """The address that the frames carry."""
        return frozenset((self._address,))

    @property
    def wifi_channel(self) -> int | None:
        """Always 6, the standard channel. The simulated air has no other."""
        return 6

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Do nothing."""
        return ()

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once. Raises ValueError for a transport outside `capabilities`."""
        self._keep_joined(now_s)
        for frame in self._sender.frames(transport, messages):
            if self._put(datagrams.encode(Send(transport, self._address, frame))):
                self._sent += 1
            else:
                self._unsent += 1

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return what arrived since the last call. Bad frames and datagrams are counted, never raised."""
        self._keep_joined(now_s)
        events = []
        for _ in range(_MAX_READS):
            try:
                data = self._socket.recv(datagrams.MAX_DATAGRAM + 1)
            except BlockingIOError:
                break
            except OSError:
                # The kernel reports that no process listens at the port. `health` reports the silence.
                continue
            event = self._take(data, now_s)
            if event is not None:
                events.append(event)
        return events

    def health(self, now_s: float) -> Health:
        """Report ok while the air answers."""
        if self._answered_s is None:
            text = f"simulated air at {self._endpoint}: no answer yet"
        elif not self._answers(now_s):
            text = f"simulated air at {self._endpoint}: silent for {now_s - self._answered_s:.0f} s"
        else:
            text = f"simulated air at {self._endpoint}: connected"
        if self._unsent:
            text += f"; {self._unsent} frames could not be sent"
        return Health(
            ok=self._answers(now_s),
            text=text,
            frames_sent=self._sent,
            frames_heard=self._receiver.heard,
            bad_frames=self._receiver.bad + self._bad_datagrams,
            can_send=TRANSPORTS if self._answers(now_s) else frozenset(),
        )

    def close(self) -> None:
        """Leave the air and release the socket."""
        self._put(datagrams.encode(Leave()))
        self._socket.close()

    def _take(self, data: bytes, now_s: float) -> RemoteIdHeard | None:
        try:
            datagram = datagrams.decode(data)
        except PeerDataError:
            self._bad_datagrams += 1
            return None
        if isinstance(datagram, Heard):
            return self._receiver.receive(datagram.transport, datagram.address, datagram.frame)
        if isinstance(datagram, Welcome):
            self._answered_s = now_s
        else:
            self._bad_datagrams += 1
        return None

    def _answers(self, now_s: float) -> bool:
        return self._answered_s is not None and now_s - self._answered_s <= _SILENT_AFTER_S

    def _keep_joined(self, now_s: float) -> None:
        pause_s, self._now_s = now_s - self._now_s, now_s
        if self._answered_s is not None and pause_s > datagrams.JOIN_PERIOD_S:
            # This process stood still and asked for no answer: the air was not silent.
            self._answered_s += pause_s
        if self._joined_s is None or now_s - self._joined_s >= datagrams.JOIN_PERIOD_S:
            self._joined_s = now_s
            self._put(self._join)

    def _put(self, data: bytes) -> bool:
        try:
            self._socket.send(data)
        except OSError:
            # The buffer is full or no process listens. A radio does not stop for that; the caller counts it.
            return False
        return True


def open_radio(section: EtherRadio, context: RadioContext) -> EtherTransport:
    """Join the simulated air that a configuration names.

    Raises:
        ConfigError: its address cannot be resolved.
    """
    return EtherTransport(section.address, context.name, context.address)
