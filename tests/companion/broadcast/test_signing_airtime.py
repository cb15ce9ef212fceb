"""The table of docs/remote-id-results.md: frames and airtime that signatures add to each transport."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from sitl_mocks.channel.parameters import load
from tests.companion.broadcast.test_signer import a_signer, flown, raw

ROOT = Path(__file__).parents[3]
CHANNEL = load(ROOT / "config" / "channel" / "standard.toml")
SECONDS = 300.0
NAMES = {BLE4: "BLE 4", BLE5: "BLE 5", WIFI_BEACON: "Wi-Fi beacon"}


def airtime_ms(transport, size):
    """Time for which a frame with a payload of this size (without message counter) is on the air.

    BLE 4: three PDUs. BLE 5: three pointers and the auxiliary packet on the Coded PHY with S=8 (0.4 ms of
    preamble, access address, coding indicator and terminators, 64 us for each of 15 + 6 + payload octets).
    Wi-Fi: 0.192 ms of preamble and 8 us for each octet of an access point's beacon.
    """
    if transport == BLE4:
        return 3 * CHANNEL.ble4.packet_ms
    if transport == BLE5:
        return 3 * CHANNEL.ble5.packet_ms + 0.4 + 0.064 * (15 + 6 + size)
    return 0.192 + 0.008 * (63 + size)


def test_the_airtimes_are_those_of_the_channel_model():
    """Its figures are for packs of four messages."""
    pack = 3 + 4 * 25
    assert airtime_ms(BLE5, pack) == pytest.approx(3 * CHANNEL.ble5.packet_ms + CHANNEL.ble5.auxiliary_ms)
    assert airtime_ms(WIFI_BEACON, pack) == pytest.approx(CHANNEL.wifi.beacon_ms)


def measured(transport, rate):
    """Frames, pages and milliseconds on the air a second: of the core, and of the signer."""
    sums = {"core": [0, 0.0], "signer": [0, 0.0]}
    pages = 0
    for _, core, sent in flown(SECONDS, {transport: rate}, a_signer()):
        for number, broadcast in enumerate(sent):
            into = sums["core" if number < len(core) else "signer"]
            for frame in raw(broadcast):
                into[0] += 1
                into[1] += airtime_ms(transport, len(frame))
            if number >= len(core):
                pages += sum(hasattr(m, "auth_type") for m in broadcast.messages)
    (frames, ms), (more, more_ms) = sums["core"], sums["signer"]
    return frames / SECONDS, ms / SECONDS, more / SECONDS, pages / SECONDS, more_ms / SECONDS


def row(transport, rate):
    frames, ms, more, pages, more_ms = measured(transport, rate)
    return (
        f"| {NAMES[transport]}, {rate} | {frames:.1f} | {ms / 10:.2f} % | {more:.1f} | {pages:.1f} "
        f"| {(ms + more_ms) / 10:.2f} % |"
    )


@pytest.mark.parametrize("transport", [BLE4, BLE5, WIFI_BEACON])
@pytest.mark.parametrize("rate", [1, 10])
def test_the_table_in_the_docs(transport, rate):
    assert row(transport, rate) in (ROOT / "docs" / "remote-id-results.md").read_text()
