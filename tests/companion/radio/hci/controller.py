"""A scripted Bluetooth controller: H4 packets in, H4 packets out, with the faults a test asks for."""

import contextlib
import socket
import struct
import threading
from dataclasses import dataclass, field

RESET = 0x0C03
VERSION = 0x1001
COMMANDS = 0x1002
FEATURES = 0x2003
RANDOM_ADDRESS = 0x2005
LEGACY_PARAMETERS = 0x2006
LEGACY_DATA = 0x2008
LEGACY_ENABLE = 0x200A
LEGACY_SCAN_PARAMETERS = 0x200B
LEGACY_SCAN = 0x200C
PARAMETERS = 0x2036
DATA = 0x2037
ENABLE = 0x2039
MAX_DATA = 0x203A
SETS = 0x203B
SCAN_PARAMETERS = 0x2041
SCAN = 0x2042

EXTENDED = 1 << 12
CODED = 1 << 11


def complete(opcode: int, status: int = 0, data: bytes = b"", credit: int = 1) -> bytes:
    body = struct.pack("<BHB", credit, opcode, status) + data
    return bytes((0x04, 0x0E, len(body))) + body


def terminated(handle: int, status: int = 0x43, events: int = 1) -> bytes:
    return bytes((0x04, 0x3E, 0x06, 0x12, status, handle, 0, 0, events))


def extended_report(
    data: bytes,
    *,
    event_type: int = 0,
    address: bytes = bytes((6, 5, 4, 3, 2, 0xC1)),
    sid: int = 1,
    rssi: int = -60,
) -> bytes:
    head = struct.pack("<HB6sBBBbbHB6s", event_type, 1, address, 3, 3, sid, 127, rssi, 0, 0, bytes(6))
    body = bytes((0x0D, 1)) + head + bytes((len(data),)) + data
    return bytes((0x04, 0x3E, len(body))) + body


@dataclass
class Controller:
    """By default one that can do all of it."""

    features: int = EXTENDED | CODED
    commands: bytes = b"\xff" * 64
    sets: int = 4
    max_data: int = 1650
    status: dict[int, int] = field(default_factory=dict)
    """Error codes to answer with, by opcode."""
    silent: set[int] = field(default_factory=set)
    """Opcodes that get no answer."""
    short: set[int] = field(default_factory=set)
    """Opcodes whose answer has no return parameters behind the status."""
    confirms: bool = True
    terminated_status: int = 0x43
    early: bool = False
    """Reports the end of advertising before it answers Enable."""
    credit: int = 1
    scanning: bool = False
    has_address: bool = False
    """A random address was set."""
    needs_address: bool = False
    """Legacy advertising is to use the random address. By default it uses the controller's own."""
    log: list[tuple[int, bytes]] = field(default_factory=list)

    def reset(self) -> None:
        """As HCI Reset does, and a controller's own watchdog, which tells nobody."""
        self.scanning = self.has_address = self.needs_address = False

    def opcodes(self) -> list[int]:
        return [opcode for opcode, _ in self.log]

    def loaded(self, handle: int) -> list[bytes]:
        """Advertising data that a set was given."""
        return [data[4:] for opcode, data in self.log if opcode == DATA and data[0] == handle]

    def feed(self, stream: bytes) -> bytes:
        """Whole commands; answers in order."""
        output = b""
        while stream:
            kind, opcode, length = struct.unpack_from("<BHB", stream)
            assert kind == 0x01
            assert len(stream) >= 4 + length
            output += self._answer(opcode, stream[4 : 4 + length])
            stream = stream[4 + length :]
        return output

    def _answer(self, opcode: int, data: bytes) -> bytes:
        self.log.append((opcode, data))
        if opcode in self.silent:
            return b""
        status = self.status.get(opcode, 0) or self._status(opcode, data)
        values = {
            VERSION: bytes((9, 0, 0, 9, 0xF1, 0x05, 0, 0)),
            COMMANDS: self.commands,
            FEATURES: struct.pack("<Q", self.features),
            SETS: bytes((self.sets,)),
            MAX_DATA: struct.pack("<H", self.max_data),
            PARAMETERS: b"\x08",
        }
        returned = b"" if status or opcode in self.short else values.get(opcode, b"")
        answer = complete(opcode, status, returned, self.credit)
        if opcode == ENABLE and data[0] == 1 and not status and self.confirms:
            event = terminated(data[2], self.terminated_status)
            return event + answer if self.early else answer + event
        return answer

    def _status(self, opcode: int, data: bytes) -> int:
        """Keep the state that the standard demands, and return the error code that follows from it."""
        if opcode == RESET:
            self.reset()
        elif opcode == RANDOM_ADDRESS:
            self.has_address = True
        elif opcode == LEGACY_PARAMETERS:
            self.needs_address = data[5] == 1
        elif opcode in (SCAN, LEGACY_SCAN):
            self.scanning = data[0] == 1
        elif opcode in (SCAN_PARAMETERS, LEGACY_SCAN_PARAMETERS) and self.scanning:
            return 0x0C
        elif opcode == LEGACY_ENABLE and data[0] == 1 and self.needs_address > self.has_address:
            return 0x12
        return 0


class TcpController:
    """Controllers behind a TCP port, one for each connection in turn; None refuses by hanging up."""

    def __init__(self, *controllers: Controller | None) -> None:
        self._waiting = list(controllers)
        self._server = socket.create_server(("127.0.0.1", 0))
        self._connection: socket.socket | None = None
        self._lock = threading.Lock()
        self.connections = 0
        self.closed_by_peer = threading.Event()
        self.name = f"tcp:127.0.0.1:{self._server.getsockname()[1]}"
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self.connections += 1
            controller = self._waiting.pop(0) if self._waiting else None
            with connection:
                if controller is None:
                    continue
                self._connection = connection
                buffer = b""
                with contextlib.suppress(OSError):
                    while data := connection.recv(4096):
                        buffer += data
                        whole = 0
                        while len(buffer) - whole >= 4 and len(buffer) - whole >= 4 + buffer[whole + 3]:
                            whole += 4 + buffer[whole + 3]
                        self.send(controller.feed(buffer[:whole]))
                        buffer = buffer[whole:]
                    self.closed_by_peer.set()

    def send(self, data: bytes) -> None:
        """Bytes out of turn."""
        assert self._connection is not None
        with self._lock:
            self._connection.sendall(data)

    def die(self) -> None:
        """Hang up."""
        assert self._connection is not None
        self._connection.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        # A blocked accept does not notice close() alone.
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        with contextlib.suppress(OSError, AssertionError):
            self.die()
        self._thread.join(60.0)
