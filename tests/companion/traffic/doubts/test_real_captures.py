"""Real aircraft and modules, as captured: flagged for nothing but what is true of them.

The captures hold true serial numbers and positions, so they stay outside the project, beside the checkout.
"""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from companion.config import TrafficConfig
from companion.errors import PeerDataError
from companion.events import RemoteIdHeard
from companion.geometry import LocalFrame
from companion.remote_id.codec import read_payload
from companion.remote_id.messages import Location
from companion.traffic.tracks import Traffic

DECODED = Path(__file__).resolve().parents[5] / "shared" / "data" / "remote_id" / "captures_decoded.json"

pytestmark = pytest.mark.skipif(
    not DECODED.is_file(), reason=f"real captures are not here: {DECODED} is missing"
)


def listened(name: str) -> tuple[Traffic, Counter[str]]:
    """The traffic after a capture, heard 500 m away at its own time, and how often each flag was raised."""
    traffic, raised = Traffic(TrafficConfig(), "OWN"), Counter[str]()
    frame = None
    start_s = None
    for entry in json.loads(DECODED.read_text())["captures"][name]:
        if "payload_hex" not in entry or entry.get("crc_ok") is False:
            continue
        utc_s = float(entry["time_epoch"])
        start_s = utc_s if start_s is None else start_s
        try:
            messages = read_payload(bytes.fromhex(entry["payload_hex"])).messages
        except PeerDataError:
            continue
        for message in messages:
            if frame is None and isinstance(message, Location) and message.lat_deg is not None:
                frame = LocalFrame(message.lat_deg + 0.0045, message.lon_deg or 0.0, 100.0)
        if frame is None or not messages:
            continue
        now_s = utc_s - start_s
        heard = RemoteIdHeard(transport="wifi", address=entry.get("mac", "a"), messages=messages)
        traffic.hear(heard, now_s, start_s, frame, -30.0)
        raised.update(report.flag for report in traffic.flagged(now_s))
    return traffic, raised


def test_a_dji_air_3_is_sound():
    traffic, raised = listened("wifi_beacon_dji_air3.pcapng")
    (track,) = traffic.tracks.values()
    assert not raised
    assert track.messages == 9
    assert track.latest.system is not None
    assert track.latest.basic_id is not None
    assert track.latest.basic_id.uas_id == track.identity


@pytest.mark.parametrize(
    ("name", "flag"),
    [
        ("wifi_beacon_esp32.pcap", "future_timestamp"),
        ("wifi_nan_and_beacon_esp32.pcap", "stale_timestamp"),
    ],
)
def test_a_module_that_always_says_the_full_hour(name, flag):
    """Timestamp 0.0 throughout: the nearest full hour was to come in one capture, gone by in the other."""
    _, raised = listened(name)
    assert raised == {flag: 1}


def test_authentication_of_a_linux_transmitter():
    """Three pages in a pack of nine; not a signature, and no key to say so."""
    traffic, raised = listened("wifi_beacon_hostapd.pcapng")
    (track,) = traffic.tracks.values()
    assert not raised
    assert track.latest.authentication is not None
    assert track.latest.authentication.auth_type == 1
    assert len(track.latest.authentication.data) == 63
