"""Checks the frames of every transport against their reference vectors."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from companion.errors import PeerDataError
from companion.remote_id import frames
from companion.remote_id.conformance.vector_fields import Fields, bytes_of, integer_of, text_of
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN


def _check_frame(
    vector: Fields,
    transport: str,
    payload_name: str,
    build: Callable[[bytes, int], bytes],
    address: str | None,
) -> Iterator[str]:
    """Check building and reading of a frame."""
    payload, counter, theirs = (
        bytes_of(vector, payload_name),
        integer_of(vector, "counter"),
        bytes_of(vector, "hex"),
    )
    try:
        ours = build(payload, counter)
    except ValueError as error:
        yield f"refused ({error})"
        return
    if ours != theirs:
        yield f"built {ours.hex()}, expected {theirs.hex()}"
    try:
        frame = frames.parse_frame(transport, theirs)
    except PeerDataError as error:
        yield f"refused to read ({error})"
        return
    expected = frames.Frame(transport=transport, address=address, counter=counter, payload=payload)
    if frame != expected:
        yield f"read {frame}, expected {expected}"


def check_ble4(vector: Fields) -> Iterator[str]:
    """Check the advertisement of one message on Bluetooth 4."""
    return _check_frame(vector, BLE4, "message_hex", frames.build_ble4, None)


def check_ble5(vector: Fields) -> Iterator[str]:
    """Check the advertisement of a pack on Bluetooth 5."""
    return _check_frame(vector, BLE5, "pack_hex", frames.build_ble5, None)


def check_beacon(vector: Fields) -> Iterator[str]:
    """Check a Wi-Fi beacon with a pack."""
    address, ssid = bytes_of(vector, "mac").hex(":"), text_of(vector, "ssid")
    interval_tu = integer_of(vector, "beacon_interval_tu")

    def build(pack: bytes, counter: int) -> bytes:
        return frames.build_beacon(pack, counter, address, ssid=ssid, interval_tu=interval_tu)

    return _check_frame(vector, WIFI_BEACON, "pack_hex", build, address)


def check_nan_action(vector: Fields) -> Iterator[str]:
    """Check a Wi-Fi NAN service discovery frame with a pack."""
    address = bytes_of(vector, "mac").hex(":")

    def build(pack: bytes, counter: int) -> bytes:
        return frames.build_nan_action(pack, counter, address)

    return _check_frame(vector, WIFI_NAN, "pack_hex", build, address)


def check_nan_sync_beacon(vector: Fields) -> Iterator[str]:
    """Check building a beacon, and recognising that it holds no Remote ID."""
    address, theirs = bytes_of(vector, "mac").hex(":"), bytes_of(vector, "hex")
    try:
        ours = frames.build_nan_sync_beacon(address)
    except ValueError as error:
        yield f"refused ({error})"
        return
    if ours != theirs:
        yield f"built {ours.hex()}, expected {theirs.hex()}"
    try:
        read: object = frames.parse_wifi(theirs)
    except frames.NanSyncBeaconError as error:
        if error.address != address:
            yield f"read as a synchronisation beacon of {error.address}, expected {address}"
        return
    except PeerDataError as error:
        read = error
    yield f"read as {read}, expected a synchronisation beacon"
