"""The Wi-Fi radio on a TAP device that hands out radiotap, with tshark as receiver.

They need root, /dev/net/tun and tshark; the reason of a skip names what is missing.
"""

from __future__ import annotations

import itertools
import os
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.radio.wifi.packet_socket import PacketSocket
from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import SYNC_PERIOD_S, WifiTransport, stamp
from companion.remote_id.captures.radiotap import build_radiotap, parse_radiotap
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import (
    build_beacon,
    build_nan_action,
    build_nan_sync_beacon,
    build_vendor_element,
    parse_wifi,
)
from tests.integration.wifi.parts import (
    BASIC_ID,
    ETHERNET_LINK,
    FULL,
    LOCATION,
    OTHER,
    OWN,
    PATIENCE_S,
    RADIOTAP_LINK,
    SELF_ID,
    Tap,
    captured,
    hear,
    needs_tap,
    needs_tshark,
    until,
)

# ---------------------------------------------------------------- TAP


@needs_tap
def test_a_beacon_goes_out_byte_for_byte(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("wifi", FULL, 1.5)
    radio.broadcast("wifi", FULL, 2.0)
    pack = encode_pack(FULL)
    assert tap.sent(2) == [
        build_radiotap() + stamp(build_beacon(pack, 0, OWN), 0, 1_500_000),
        build_radiotap() + stamp(build_beacon(pack, 0, OWN), 1, 2_000_000),
    ]
    health = radio.health(2.0)
    assert (health.ok, health.frames_sent, health.missing) == (True, 2, ())
    assert health.can_send == {"wifi", "nan"}
    assert radio.own_addresses == {OWN}


@needs_tap
def test_nan_goes_out_once_with_its_synchronisation_beside_it(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("nan", (LOCATION,), 1.0)
    action = build_nan_action(encode_pack((LOCATION,)), 0, OWN)
    sync = build_nan_sync_beacon(OWN)
    assert tap.sent(2) == [
        build_radiotap() + stamp(sync, 0, 1_000_000),
        build_radiotap() + stamp(action, 1, 0),
    ]
    assert radio.health(1.0).frames_sent == 1  # a synchronisation beacon is no Remote ID
    # On a grid of 512 TU, whatever the loop's rhythm, until NAN has been silent for 3 s.
    for n in range(1, 500):
        radio.heard(1.0 + 0.01 * n)
    times = [struct.unpack_from("<Q", frame, 12 + 24)[0] / 1e6 for frame in tap.sent(5)]
    for n, sent_s in enumerate(times, start=1):
        assert 1.0 + n * SYNC_PERIOD_S <= sent_s < 1.0 + n * SYNC_PERIOD_S + 0.011
    assert tap.waiting() == []


@needs_tap
def test_a_late_loop_sends_one_synchronisation_not_a_burst(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("nan", (LOCATION,), 0.0)
    tap.sent(2)
    for now_s in (2.5, 2.6, 2.9):
        radio.heard(now_s)
    tap.sent(1)
    assert tap.waiting() == []


@needs_tap
@pytest.mark.parametrize(
    ("transport", "build"), [("wifi", build_beacon), ("nan", build_nan_action)], ids=["beacon", "nan"]
)
def test_frames_on_the_air_are_heard(
    tap: Tap, radio: WifiTransport, transport: str, build: Callable[[bytes, int, str], bytes]
) -> None:
    frame = build(encode_pack((BASIC_ID, SELF_ID)), 7, OTHER)
    tap.put(captured(frame))
    tap.put(captured(frame + b"\xde\xad\xbe\xef", flags=0x10, rssi_dbm=-90))
    heard = hear(radio, 2)
    assert heard == [
        RemoteIdHeard(
            transport=transport, address=OTHER, messages=(BASIC_ID, SELF_ID), rssi_dbm=rssi, counter=7
        )
        for rssi in (-61.0, -90.0)
    ]
    health = radio.health(0.0)
    assert (health.frames_heard, health.bad_frames, health.ok) == (2, 0, True)


@needs_tap
def test_what_is_no_hearing_is_left_out_and_what_is_bad_is_counted(tap: Tap, radio: WifiTransport) -> None:
    pack = encode_pack((SELF_ID,))
    theirs, own = build_beacon(pack, 0, OTHER), build_beacon(pack, 0, OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)  # its own socket's copy
    tap.put(build_radiotap() + theirs)  # TX flags: the card reports what it sent
    tap.put(captured(own))
    tap.put(captured(theirs, flags=0x40))  # bad FCS
    tap.put(captured(theirs[:-30]))  # a torn element
    tap.put(captured(b"\x08\x01" + bytes(60)))  # a data frame
    tap.put(captured(b"\x80\x00" + bytes(40)))  # somebody's beacon
    tap.put(b"\0\0\xff\xff" + bytes(60))  # no radiotap
    tap.put(captured(theirs))
    (event,) = hear(radio, 1)
    assert (event.address, event.messages) == (OTHER, (SELF_ID,))
    health = radio.health(0.0)
    assert health.frames_heard == 1
    assert health.bad_frames == 2


@needs_tap
def test_a_flood_is_taken_in_portions_and_losses_are_told(tap: Tap, radio: WifiTransport) -> None:
    frame = captured(build_beacon(encode_pack(FULL[:5]), 0, OTHER))
    sent = 8000
    for _ in range(sent):
        tap.put(frame)
    total = portion = len(radio.heard(0.0))
    assert portion == 256
    while portion:
        portion = len(radio.heard(0.0))
        assert portion <= 256
        total += portion
    assert total < sent
    assert f"{sent - total} received frames lost" in radio.health(0.0).text


@needs_tap
def test_an_interface_that_goes_down_and_comes_back(tap: Tap, radio: WifiTransport) -> None:
    tap.set_up(False)
    until(lambda: radio.heard(0.0) or not radio.hears, "the loss")
    radio.broadcast("wifi", (SELF_ID,), 0.1)
    health = radio.health(0.1)
    assert not health.ok
    assert health.can_send == frozenset()
    assert "1 frames could not be sent" in health.text
    radio.heard(5.0)
    assert f"'{tap.name}' is down: `ip link set {tap.name} up`" in radio.health(5.0).text
    tap.set_up(True)
    radio.heard(5.5)
    assert radio.hears == frozenset()  # tried once a second
    radio.heard(6.1)
    assert radio.hears == {"wifi", "nan"}
    assert radio.health(6.1).can_send == {"wifi", "nan"}
    radio.broadcast("wifi", (SELF_ID,), 6.2)
    tap.sent(1)
    tap.put(captured(build_beacon(encode_pack((SELF_ID,)), 0, OTHER)))
    hear(radio, 1)


@needs_tap
def test_an_interface_that_vanishes(tap: Tap, radio: WifiTransport) -> None:
    tap.close()
    until(lambda: radio.heard(0.0) or not radio.hears, "the loss")
    for now_s in (1.0, 2.0, 3.0):
        radio.broadcast("wifi", (SELF_ID,), now_s)
        radio.broadcast("nan", (SELF_ID,), now_s)
        assert radio.heard(now_s) == []
    health = radio.health(3.0)
    assert not health.ok
    assert f"there is no network interface '{tap.name}'" in health.text
    assert health.can_send == frozenset()


@needs_tap
def test_an_interface_that_another_program_takes_out_of_monitor_mode(tap: Tap, radio: WifiTransport) -> None:
    radio.broadcast("wifi", (SELF_ID,), 1.0)
    tap.sent(1)
    # Between two frames, so that no send fails.
    tap.set_up(False)
    tap.set_link(ETHERNET_LINK)
    tap.set_up(True)
    radio.broadcast("wifi", (SELF_ID,), 2.0)
    health = radio.health(2.0)
    assert not health.ok
    assert health.can_send == frozenset()
    assert f"'{tap.name}' is not a Wi-Fi interface" in health.text
    assert tap.waiting() == []


@needs_tap
def test_a_card_tuned_elsewhere_is_told(tap: Tap, radio: WifiTransport) -> None:
    tap.put(captured(build_beacon(encode_pack((SELF_ID,)), 0, OTHER), mhz=2412))
    hear(radio, 1)
    health = radio.health(0.0)
    assert not health.ok
    assert "listens on channel 1, not on 6" in health.text


@needs_tap
def test_the_kernel_hands_over_what_others_sent_and_can_carry_remote_id(tap: Tap) -> None:
    listener = PacketSocket("radio.monitor", tap.name, 6, listen=True)
    sender = PacketSocket("radio.inject", tap.name, 6, listen=False)
    assert sender.send(captured(b"\x80\x00" + bytes(40)), 0.0)
    wanted = [captured(bytes((kind, 0)) + bytes(40)) for kind in (0x80, 0x50, 0xD0)]
    for kind in (0x08, 0x40, 0xB4, 0xC0):
        tap.put(captured(bytes((kind, 0)) + bytes(40)))
    for data in wanted:
        tap.put(data)
    received: list[bytes] = []

    def all_there() -> bool:
        received.extend(listener.receive())
        return len(received) >= len(wanted)

    until(all_there, "frames")
    assert received == wanted
    assert listener.dropped == 0
    assert sender.receive() == []
    listener.close()
    sender.close()


@needs_tap
def test_long_frames_are_taken_in_smaller_portions(tap: Tap, radio: WifiTransport) -> None:
    """A frame of empty elements takes forty times as long to read as an ordinary one."""
    frame = captured(build_beacon(encode_pack((SELF_ID,)), 0, OTHER) + bytes(2) * 1000)
    for _ in range(100):
        tap.put(frame)
    assert len(radio.heard(0.0)) == -(-(1 << 16) // len(frame))


@needs_tap
def test_without_the_right_to_raw_frames_it_says_which(tap: Tap) -> None:
    os.seteuid(65534)
    try:
        with pytest.raises(ConfigError, match=f"radio.inject: '{tap.name}': .*CAP_NET_RAW"):
            WifiTransport(WifiRadio(inject=tap.name), OWN)
    finally:
        os.seteuid(0)


@needs_tap
def test_five_ghz_goes_out_at_its_lowest_rate(tap: Tap) -> None:
    radio = WifiTransport(WifiRadio(inject=tap.name, channel=149), OWN)
    radio.broadcast("wifi", (SELF_ID,), 0.0)
    (data,) = tap.sent(1)
    assert data[:12] == build_radiotap(12)
    assert parse_wifi(parse_radiotap(data).frame).address == OWN
    assert (radio.wifi_channel, radio.hears) == (149, frozenset())
    radio.close()


@needs_tap
@pytest.mark.parametrize(
    ("link", "up", "words"),
    [
        (RADIOTAP_LINK, False, "is down: `ip link set"),
        (801, True, "link type 801; radiotap"),
        (1, True, "is not a Wi-Fi interface"),
    ],
)
def test_an_interface_that_is_none_for_us_says_why(link: int, up: bool, words: str) -> None:
    tap = Tap(link)
    try:
        tap.set_up(up)
        with pytest.raises(ConfigError, match=words):
            WifiTransport(WifiRadio(inject=tap.name), OWN)
    finally:
        tap.close()


@needs_tap
def test_a_part_that_fails_is_told_and_the_rest_works(tap: Tap, tmp_path: Path) -> None:
    config = WifiRadio(hostapd=str(tmp_path / "none"), inject="nosuch0", monitor=tap.name)
    radio = WifiTransport(config, OWN)
    health = radio.health(0.0)
    assert not health.ok
    assert [text.split(":")[0] for text in health.missing] == ["radio.hostapd", "radio.inject"]
    assert (radio.capabilities, radio.hears) == (frozenset(), {"wifi", "nan"})
    with pytest.raises(ValueError, match=r"radio\.inject: there is no network interface 'nosuch0'"):
        radio.broadcast("wifi", (SELF_ID,), 0.0)
    with pytest.raises(ConfigError, match="cannot send wifi"):
        radio.configure({"wifi": 1})
    radio.close()


# ---------------------------------------------------------------- tshark


FIELDS = [
    "wlan.fc.type_subtype",
    "wlan.sa",
    "wlan.bssid",
    "wlan.seq",
    "wlan.fixed.timestamp",
    "wlan.tag.oui",
    "wlan.tag.vendor.data",
    "nan.service_id",
    "nan.sda.service_info",
    "nan.sdea.service_update_indicator",
]


@needs_tap
@needs_tshark
def test_tshark_sees_what_we_send(tap: Tap, radio: WifiTransport, tmp_path: Path) -> None:
    """A receiver that is none of ours finds element and attributes where the standards want them."""
    wanted = f"wlan.sa == {OWN}"
    command = ["tshark", "-i", tap.name, "-n", "-l", "-Y", wanted, "-T", "fields"]
    command += [part for field in FIELDS for part in ("-e", field)]
    out = tmp_path / "fields.txt"
    with out.open("w") as stdout, (tmp_path / "log.txt").open("w") as log:
        process = subprocess.Popen(command, stdout=stdout, stderr=log)
    try:
        # How soon a capture begins nobody tells: the aircraft sends until it was seen on both transports.
        seconds = itertools.count(1.0)

        def seen() -> bool:
            assert process.poll() is None, (tmp_path / "log.txt").read_text()
            now_s = next(seconds)
            radio.broadcast("wifi", FULL, now_s)
            radio.broadcast("nan", FULL, now_s)
            return out.read_text().count("\n") >= 3

        until(seen, "a frame in tshark")
    finally:
        process.terminate()
        process.wait(PATIENCE_S)
    lines = [line.split("\t") for line in out.read_text().splitlines()]
    rows = [dict(zip(FIELDS, line, strict=True)) for line in lines if len(line) == len(FIELDS)]
    element = build_vendor_element(encode_pack(FULL), 0)
    (beacon,) = {row["wlan.tag.vendor.data"] for row in rows if row["wlan.bssid"] == OWN}
    assert bytes.fromhex(beacon.replace(":", "")) == element[5:]
    assert {int(row["wlan.tag.oui"]) for row in rows if row["wlan.bssid"] == OWN} == {0xFA0BBC}
    nan = [row for row in rows if row["wlan.bssid"] == "50:6f:9a:01:00:ff"]
    assert {row["nan.service_id"] for row in nan} == {"88:69:19:9d:92:09"}
    infos = {row["nan.sda.service_info"] for row in nan} - {""}
    assert [bytes.fromhex(info.replace("-", "")) for info in infos] == [element[6:]]
    assert {row["nan.sdea.service_update_indicator"] for row in nan} == {"", "0"}
    numbers = [int(row["wlan.seq"]) for row in rows]
    # A capture on a busy computer may miss a frame.
    assert all(0 < (after - before) % 4096 <= 5 for before, after in itertools.pairwise(numbers))
