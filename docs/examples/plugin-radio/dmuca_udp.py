"""Sends each Remote ID frame as one UDP datagram, and receives those that others send.

A datagram is the name of the transport, a zero byte, and the frame. A BLE frame holds no address of its
sender, so aircraft are told apart by where a datagram came from. Options: `to` (HOST:PORT) and `listen` (a
port of this computer).
"""

import socket

from companion.errors import ConfigError
from companion.radio.frames_io import TRANSPORTS, FrameReceiver, FrameSender
from companion.radio.radio import Health

MOST_BYTES = 4096
MOST_DATAGRAMS = 200


class UdpRadio:
    """A `companion.radio.radio.Radio` on one socket that never blocks."""

    wifi_channel = None

    def __init__(self, to, listen, address):
        self.capabilities = self.hears = TRANSPORTS
        self.own_addresses = frozenset({address})
        self._to = to
        self._sender, self._receiver = FrameSender(address), FrameReceiver()
        self._sent = self._heard = self._bad = 0
        self._trouble = None
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        try:
            self.socket.bind(("127.0.0.1", listen))
        except OSError as error:
            self.socket.close()
            raise ConfigError(f"listen: {listen}: {error.strerror}") from error

    def configure(self, rates, *, probe=False):
        return ()

    def broadcast(self, transport, messages, now_s):
        for frame in self._sender.frames(transport, messages):  # ValueError for what cannot be sent
            try:
                self.socket.sendto(transport.encode() + b"\0" + frame, self._to)
            except OSError as error:
                self._trouble = error.strerror
            else:
                self._sent, self._trouble = self._sent + 1, None

    def heard(self, now_s):
        found = []
        for _ in range(MOST_DATAGRAMS):
            try:
                datagram, (host, port) = self.socket.recvfrom(MOST_BYTES)
            except BlockingIOError:
                break
            except OSError as error:
                self._trouble = error.strerror
                break
            found.append(self._read(datagram, f"{host}:{port}"))
        return [event for event in found if event is not None]

    def _read(self, datagram, address):
        transport, zero, frame = datagram.partition(b"\0")
        name = transport.decode("latin-1")
        event = self._receiver.receive(name, address, frame) if zero and name in TRANSPORTS else None
        self._heard, self._bad = self._heard + (event is not None), self._bad + (event is None)
        return event

    def health(self, now_s):
        return Health(
            ok=self._trouble is None,
            text=f"UDP to {self._to[0]}:{self._to[1]}: {self._trouble or f'{self._sent} frames'}",
            frames_sent=self._sent,
            frames_heard=self._heard,
            bad_frames=self._bad,
            can_send=self.capabilities,
        )

    def close(self):
        self.socket.close()


def open_radio(options, context):
    """Open the radio for a table of options."""
    unknown = options.keys() - {"to", "listen"}
    if unknown:
        raise ConfigError(f"{sorted(unknown)[0]}: unknown key; allowed: to, listen")
    host, _, port = str(options.get("to", "")).rpartition(":")
    if not (host and port.isdigit() and 0 < int(port) < 65536):
        raise ConfigError(f"to: {options.get('to')!r}: allowed: HOST:PORT")
    listen = options.get("listen", 0)
    if not isinstance(listen, int) or not 0 <= listen < 65536:
        raise ConfigError(f"listen: {listen!r}: allowed: a port, 0 to 65535")
    return UdpRadio((host, int(port)), listen, context.address)
