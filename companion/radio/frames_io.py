"""Converts between messages and the frames of each transport. Shared by all radios that handle raw frames.

BLE 4 carries one message per frame. BLE 5, the Wi-Fi beacon and the Wi-Fi NAN action frame carry a pack.
Counters and the radio address stay steady per transmitter, because receivers use them to tell aircraft apart
and to detect lost frames.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence

from companion.errors import PeerDataError
from companion.events import RemoteIdHeard
from companion.remote_id.codec import PACK_MAX_MESSAGES, Payload, encode, encode_pack, read_payload
from companion.remote_id.frames import (
    Counters,
    Frame,
    NotRemoteIdError,
    build_beacon,
    build_ble4,
    build_ble5,
    build_nan_action,
    parse_frames,
    parse_wifi_frames,
)
from companion.remote_id.messages import Message
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN

TRANSPORTS = frozenset((BLE4, BLE5, WIFI_BEACON, WIFI_NAN))
_MOST_STRUCTURES = 4
"""Most Remote ID structures that are read of one frame. Transmitters send one. A forged beacon has room for
hundreds, and frames of that kind could hold up the flight loop."""


def radio_address(identity: str) -> str:
    """Derive a radio address (six hex octets with colons) that is always the same for an identity.

    The two highest bits of the first octet make it a BLE random static address. The two lowest bits make it a
    locally administered unicast MAC address. One address thus serves all transports.
    """
    digest = bytearray(hashlib.sha256(identity.encode()).digest()[:6])
    digest[0] = (digest[0] & 0b0011_1100) | 0b1100_0010
    return digest.hex(":")


class FrameSender:
    """Builds the frames of one transmitter, numbered per transport.

    Args:
        address: Radio address of the transmitter. Wi-Fi frames carry it, BLE advertising data does not.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._counters = Counters()

    def frames(self, transport: str, messages: Sequence[Message]) -> list[bytes]:
        """Return the frames that carry these messages once, in order; none if there are no messages.

        Raises:
            ValueError: a transport outside `TRANSPORTS`, or messages that cannot be sent.
        """
        if transport not in TRANSPORTS:
            raise ValueError(f"transport is {transport!r}; allowed: {', '.join(sorted(TRANSPORTS))}")
        if transport == BLE4:
            payloads = [encode(message) for message in messages]
            return [build_ble4(payload, self._counters.next(BLE4, payload)) for payload in payloads]
        packs = [
            encode_pack(messages[start : start + PACK_MAX_MESSAGES])
            for start in range(0, len(messages), PACK_MAX_MESSAGES)
        ]
        return [self._pack_frame(transport, pack, self._counters.next(transport, pack)) for pack in packs]

    def _pack_frame(self, transport: str, pack: bytes, counter: int) -> bytes:
        if transport == BLE5:
            return build_ble5(pack, counter)
        if transport == WIFI_NAN:
            return build_nan_action(pack, counter, self.address)
        return build_beacon(pack, counter, self.address)


class FrameReceiver:
    """Converts received frames to events, and counts faulty ones."""

    def __init__(self) -> None:
        self.heard = 0
        """Number of frames with at least one readable message."""
        self.bad = 0
        """Number of frames that violate the protocol, in part or wholly."""
        self.foreign = 0
        """Number of valid frames without Remote ID, sent by other devices."""
        self.last_error: str | None = None
        """Fault of the last bad frame."""

    def receive(
        self, transport: str, address: str, frame: bytes, rssi_dbm: float | None = None
    ) -> RemoteIdHeard | None:
        """Return the event of one frame; None if it holds no readable message.

        The valid messages of a damaged pack are returned, so that one bad message does not hide an aircraft.
        If a frame holds several Remote ID structures, the event contains the messages of the first four.

        Args:
            transport: One of `TRANSPORTS`. Another value raises ValueError.
            address: Transmitter as the radio reports it. The source address inside a Wi-Fi frame takes
                precedence.
            frame: Bytes as the radio reports them.
            rssi_dbm: Signal strength, if the radio reports it.
        """
        return self._receive(lambda: parse_frames(transport, frame), address, rssi_dbm)

    def receive_wifi(self, frame: bytes, rssi_dbm: float | None = None) -> RemoteIdHeard | None:
        """Same as `receive` for any 802.11 frame. Transport and transmitter are read from the frame."""
        return self._receive(lambda: parse_wifi_frames(frame), "", rssi_dbm)

    def _receive(
        self, parse: Callable[[], tuple[Frame, ...]], address: str, rssi_dbm: float | None
    ) -> RemoteIdHeard | None:
        try:
            parsed = parse()
        except NotRemoteIdError:
            self.foreign += 1
            return None
        except PeerDataError as error:
            self._note(str(error))
            return None
        messages, faults = _read_all(parsed)
        if faults:
            self._note(faults[0])
        if not messages:
            return None
        self.heard += 1
        return RemoteIdHeard(
            transport=parsed[0].transport,
            address=parsed[0].address or address,
            messages=messages,
            rssi_dbm=rssi_dbm,
            counter=parsed[0].counter,
        )

    def _note(self, error: str) -> None:
        self.bad += 1
        self.last_error = error


def _read_all(frames: Sequence[Frame]) -> Payload:
    """Return the messages of the Remote ID structures of a frame. Repeats across structures are dropped."""
    messages: list[Message] = []
    faults: list[str] = []
    if len(frames) > _MOST_STRUCTURES:
        faults.append(f"{len(frames)} Remote ID structures in one frame; read: {_MOST_STRUCTURES}")
    for frame in frames[:_MOST_STRUCTURES]:
        try:
            payload = read_payload(frame.payload)
        except PeerDataError as error:
            faults.append(str(error))
            continue
        messages += payload.messages
        faults += payload.faults
    return Payload(tuple(dict.fromkeys(messages) if len(frames) > 1 else messages), tuple(faults))
