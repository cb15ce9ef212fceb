"""The Wi-Fi radio over sockets that are none: what it sends, hears, counts and says."""

import errno
import os
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import ConfigError
from companion.radio.wifi import packet_socket, wifi_radio
from companion.radio.wifi.hostapd import ApStatus
from companion.radio.wifi.packet_socket import PacketSocket, channel_of, check_monitor, tuned_channel
from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import WifiTransport, stamp
from companion.remote_id.captures.radiotap import build_radiotap
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import (
    build_beacon,
    build_nan_action,
    build_nan_sync_beacon,
    build_vendor_element,
)
from companion.remote_id.messages import Authentication, Message, SelfId

OWN = "c2:01:02:03:04:05"
OTHER = "c2:00:00:00:00:01"
BSSID = "02:00:00:aa:bb:cc"
MESSAGES: tuple[Message, ...] = (SelfId(description_type=0, text="survey"),)
PACK = encode_pack(MESSAGES)
BARE = struct.pack("<BBHI", 0, 0, 8, 0)
"""Radiotap header without fields."""


class FakeSocket:
    """An interface that always works, until it is told not to."""

    def __init__(self, key: str, interface: str, channel: int, *, listen: bool) -> None:
        if interface == "none":
            raise ConfigError(f"{key}: there is no network interface 'none'")
        self.interface, self.channel, self.listen = interface, channel, listen
        self.trouble: str | None = None
        self.dropped = 0
        self.takes = True
        self.sent: list[bytes] = []
        self.air: list[bytes] = []
        self.closed = False

    def keep_open(self, now_s: float, channel: int) -> None:
        self.channel = channel

    def send(self, data: bytes, now_s: float) -> bool:
        if self.takes:
            self.sent.append(data)
        return self.takes

    def receive(self) -> list[bytes]:
        taken, self.air = self.air, []
        return taken

    def close(self) -> None:
        self.closed = True


class FakeControl:
    """A hostapd that takes everything at once."""

    status = ApStatus("ENABLED", BSSID, 11, 1000)

    def __init__(self, path: str) -> None:
        self.path = path
        self.trouble: str | None = None
        self.elements: list[bytes] = []
        self.closed = False

    @property
    def updates(self) -> int:
        return len(self.elements)

    def set_element(self, element: bytes, now_s: float) -> None:
        self.elements.append(element)

    def poll(self, now_s: float) -> None:
        pass

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Callable[..., WifiTransport]:
    monkeypatch.setattr(wifi_radio, "PacketSocket", FakeSocket)
    monkeypatch.setattr(wifi_radio, "HostapdControl", FakeControl)
    return lambda **keys: WifiTransport(WifiRadio(**keys), OWN)


def test_injected_frames_are_numbered_through(opened: Callable[..., WifiTransport]) -> None:
    radio = opened(inject="w")
    for n in range(4097):
        radio.broadcast("wifi", MESSAGES, 1.0 + n * 1e-3)
    sent = radio._inject.sent  # type: ignore[union-attr]
    beacon = build_beacon(PACK, 0, OWN)
    assert sent[0] == build_radiotap() + stamp(beacon, 0, 1_000_000)
    assert sent[4095] == build_radiotap() + stamp(beacon, 4095, 5_095_000)
    assert sent[4096] == build_radiotap() + stamp(beacon, 0, 5_096_000)


def test_a_stamp_touches_nothing_else() -> None:
    beacon, action = build_beacon(PACK, 0, OWN), build_nan_action(PACK, 0, OWN)
    assert stamp(beacon, 0xABC, 0x1122334455667788) == (
        beacon[:22] + bytes.fromhex("c0ab 8877665544332211") + beacon[32:]
    )
    assert stamp(action, 1, 99) == action[:22] + b"\x10\x00" + action[24:]
    assert stamp(beacon, 0, -1)[24:32] == b"\xff" * 8


def test_every_action_frame_follows_a_synchronisation_beacon(opened: Callable[..., WifiTransport]) -> None:
    radio = opened(inject="w")
    frames = radio._inject.sent  # type: ignore[union-attr]
    for n in range(200):
        if n % 20 == 0:
            radio.broadcast("nan", MESSAGES, n * 0.05)
        radio.heard(n * 0.05)
    kinds = [frame[12] for frame in frames]
    # With one action frame a second, another beacon is due in between.
    assert kinds == [0x80, 0xD0, 0x80] * 10
    assert frames[0] == build_radiotap() + stamp(build_nan_sync_beacon(OWN), 0, 0)
    for n in range(200, 400):
        radio.heard(n * 0.05)
    later = len(frames)
    radio.heard(30.0)
    assert len(frames) == later


def test_a_full_queue_is_counted_and_told(opened: Callable[..., WifiTransport]) -> None:
    radio = opened(inject="w")
    radio._inject.takes = False  # type: ignore[union-attr]
    radio.broadcast("wifi", MESSAGES, 0.0)
    radio.broadcast("nan", MESSAGES, 0.0)
    health = radio.health(0.0)
    assert health.frames_sent == 0
    assert "2 frames could not be sent" in health.text


class FullSocket:
    """A raw socket of the kernel whose queue is full until it is told not to be."""

    def __init__(self) -> None:
        self.error: int | None = errno.ENOBUFS

    def send(self, data: bytes) -> int:
        if self.error is not None:
            raise OSError(self.error, os.strerror(self.error))
        return len(data)

    def close(self) -> None:
        pass


@pytest.fixture
def raw(monkeypatch: pytest.MonkeyPatch) -> FullSocket:
    raw = FullSocket()
    monkeypatch.setattr(PacketSocket, "_open", lambda _: raw)
    monkeypatch.setattr(packet_socket, "_examine", lambda *_: None)
    return raw


@pytest.mark.parametrize("error", [errno.ENOBUFS, errno.EAGAIN])
def test_a_queue_that_stays_full_sends_nothing_and_that_is_told(raw: FullSocket, error: int) -> None:
    radio, raw.error = WifiTransport(WifiRadio(inject="w"), OWN), error
    for n in range(5):  # 0.8 s
        radio.broadcast("wifi", MESSAGES, 10.0 + 0.2 * n)
    assert radio.health(10.8).can_send == {"wifi", "nan"}
    radio.broadcast("wifi", MESSAGES, 11.0)
    health = radio.health(11.0)
    assert (health.ok, health.can_send) == (False, frozenset())
    assert f"radio.inject: 'w': {os.strerror(error)}" in health.text
    # A new socket is tried once a second. The first frame that it refuses is trouble again.
    radio.heard(12.1)
    assert radio.health(12.1).can_send == {"wifi", "nan"}
    radio.broadcast("wifi", MESSAGES, 12.15)
    assert radio.health(12.15).can_send == frozenset()
    raw.error = None
    radio.heard(13.2)
    radio.broadcast("wifi", MESSAGES, 13.2)
    raw.error = error
    radio.broadcast("wifi", MESSAGES, 13.4)
    assert (radio.health(13.4).ok, radio.health(13.4).frames_sent) == (True, 1)


def test_an_interface_is_examined_once_a_second(raw: FullSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    radio, raw.error = WifiTransport(WifiRadio(inject="w"), OWN), None
    radio.broadcast("wifi", MESSAGES, 10.0)

    def taken_over(key: str, interface: str, channel: int) -> NoReturn:
        raise ConfigError(f"{key}: {interface!r} is tuned to channel 1, but radio.channel is {channel}")

    def no_descriptor(*_: object) -> NoReturn:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(packet_socket, "_examine", no_descriptor)
    radio.broadcast("wifi", MESSAGES, 11.0)
    assert radio.health(11.0).ok
    monkeypatch.setattr(packet_socket, "_examine", taken_over)
    radio.broadcast("wifi", MESSAGES, 12.0)
    health = radio.health(12.0)
    assert (health.ok, health.can_send, health.frames_sent) == (False, frozenset(), 2)
    assert "'w' is tuned to channel 1, but radio.channel is 6" in health.text


def test_the_card_is_to_follow_hostapd_to_another_channel(opened: Callable[..., WifiTransport]) -> None:
    radio = opened(hostapd="/h/wlan0", inject="w", monitor="m")
    radio._hostapd.status = ApStatus("ENABLED", BSSID, 149, 100)  # type: ignore[union-attr]
    radio.heard(1.0)
    assert (radio._inject.channel, radio._monitor.channel) == (149, 149)  # type: ignore[union-attr]


def test_hostapd_sends_the_beacons_and_tells_address_and_channel(
    opened: Callable[..., WifiTransport],
) -> None:
    radio = opened(hostapd="/h/wlan0", inject="w")
    radio.broadcast("wifi", MESSAGES, 0.0)
    radio.broadcast("nan", MESSAGES, 0.0)
    control, inject = radio._hostapd, radio._inject
    assert control.elements == [build_vendor_element(PACK, 0)]  # type: ignore[union-attr]
    assert inject.sent[1] == build_radiotap() + stamp(build_nan_action(PACK, 0, BSSID), 1, 0)  # type: ignore[union-attr]
    assert (radio.wifi_channel, inject.channel) == (11, 11)  # type: ignore[union-attr]
    assert radio.own_addresses == {BSSID}
    health = radio.health(0.0)
    assert health.ok
    assert health.frames_sent == 2
    assert health.missing == (
        "hostapd sends a beacon only every 1000 TU; set beacon_int=100 in its configuration",
    )
    radio.close()
    assert control.closed  # type: ignore[union-attr]
    assert inject.closed  # type: ignore[union-attr]


def test_injection_steps_in_while_hostapd_is_in_trouble(opened: Callable[..., WifiTransport]) -> None:
    radio = opened(hostapd="/h/wlan0", inject="w")
    radio._hostapd.trouble = "hostapd: gone"  # type: ignore[union-attr]
    radio.broadcast("wifi", MESSAGES, 0.0)
    assert radio._hostapd.elements == []  # type: ignore[union-attr]
    assert len(radio._inject.sent) == 1  # type: ignore[union-attr]
    assert radio.health(0.0).can_send == {"wifi", "nan"}
    assert not radio.health(0.0).ok
    radio._inject.trouble = "radio.inject: gone"  # type: ignore[union-attr]
    assert radio.health(0.0).can_send == frozenset()


def test_more_than_a_pack_goes_out_in_several_frames(opened: Callable[..., WifiTransport]) -> None:
    pages = tuple(Authentication(auth_type=1, page=page, data=bytes(23)) for page in range(1, 12))
    radio = opened(inject="w")
    radio.broadcast("wifi", pages, 0.0)
    assert len(radio._inject.sent) == 2  # type: ignore[union-attr]
    with pytest.raises(ValueError, match="11 messages"):
        opened(hostapd="/h/wlan0").broadcast("wifi", pages, 0.0)


def test_own_frames_are_not_heard_but_a_separate_radio_hears_them(
    opened: Callable[..., WifiTransport],
) -> None:
    own = BARE + build_beacon(PACK, 0, OWN)
    both, listener = opened(inject="w", monitor="m"), opened(monitor="m")
    both.broadcast("wifi", MESSAGES, 0.0)
    for radio in (both, listener):
        radio._monitor.air = [own, build_radiotap() + build_beacon(PACK, 0, OTHER)]  # type: ignore[union-attr]
    assert both.heard(0.0) == []
    assert [event.address for event in listener.heard(0.0)] == [OWN]
    assert both.health(0.0).frames_heard == 0
    assert (listener.capabilities, listener.wifi_channel, listener.own_addresses) == (
        frozenset(),
        None,
        frozenset(),
    )


@pytest.mark.parametrize("keys", [{"inject": "w"}, {"hostapd": "/h/wlan0"}])
def test_who_copies_the_own_address_is_heard(
    opened: Callable[..., WifiTransport], keys: dict[str, str]
) -> None:
    radio = opened(monitor="m", **keys)
    (own,) = radio.own_addresses
    radio.broadcast("wifi", MESSAGES, 0.0)
    stranger: tuple[Message, ...] = (SelfId(description_type=0, text="stranger"),)
    frames = [
        BARE + build(encode_pack(messages), 0, own)
        for messages in (MESSAGES, stranger)
        for build in (build_beacon, build_nan_action)
    ]
    radio._monitor.air = frames if "inject" in keys else frames[::2]  # type: ignore[union-attr]
    if "inject" in keys:
        radio.broadcast("nan", MESSAGES, 0.0)
    heard = radio.heard(0.0)
    assert [event.messages for event in heard] == [stranger] * (2 if "inject" in keys else 1)
    assert {event.address for event in heard} == {own}


@given(st.lists(st.binary(max_size=120), max_size=5), st.integers(0, 400), st.integers(0, 255))
def test_any_air_is_survived(noise: list[bytes], at: int, value: int) -> None:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(wifi_radio, "PacketSocket", FakeSocket)
        radio = WifiTransport(WifiRadio(monitor="m"), OWN)
    sound = bytearray(BARE + build_nan_action(PACK, 0, OTHER))
    sound[at % len(sound)] = value
    radio._monitor.air = [*noise, bytes(sound), bytes(sound[:at]), *(BARE + n for n in noise)]  # type: ignore[union-attr]
    radio.heard(0.0)
    radio.health(0.0)


def test_nothing_that_works_is_a_wrong_configuration(opened: Callable[..., WifiTransport]) -> None:
    with pytest.raises(ConfigError, match=r"radio\.inject: there is no.*; radio\.monitor: there is no"):
        opened(inject="none", monitor="none")
    with pytest.raises(ConfigError, match="needs hostapd, inject or monitor"):
        opened()


@pytest.mark.parametrize("name", ["nosuch0", "", "../lo", "a\0b", "x" * 300, "é"])
def test_an_interface_that_does_not_exist_names_those_that_do(name: str) -> None:
    with pytest.raises(ConfigError, match=r"there is no network interface .*allowed: .*lo"):
        check_monitor("radio.monitor", name, 6)


@pytest.mark.parametrize("name", ["if_nameindex", "socket"])
def test_a_system_without_descriptors_is_told_in_words(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def fail(*_: object) -> NoReturn:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(socket, name, fail)
    with pytest.raises(ConfigError, match=r"radio\.monitor: 'lo': cannot be examined: Too many open files"):
        check_monitor("radio.monitor", "lo", 6)


def test_an_interface_of_another_kind_is_told_apart(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="'lo' has link type 772"):
        check_monitor("radio.monitor", "lo", 6)
    (tmp_path / "wlan0" / "phy80211").mkdir(parents=True)
    monkeypatch.setattr(packet_socket, "_SYSFS", tmp_path)
    assert "`ip link set wlan0 down; iw dev wlan0 set type monitor; ip link set wlan0 up`" in (
        packet_socket._why_no_monitor("wlan0", 1)
    )
    assert packet_socket._why_no_monitor("eth0", 1) == "'eth0' is not a Wi-Fi interface"


@pytest.mark.parametrize(
    ("mhz", "channel"),
    [
        (2412, 1),
        (2437, 6),
        (2472, 13),
        (2484, 14),
        (5180, 36),
        (5745, 149),
        (5885, 177),
        (2438, None),
        (2407, None),
        (5000, None),
        (5955, None),
        (0, None),
    ],
)
def test_channels_by_frequency(mhz: int, channel: int | None) -> None:
    assert channel_of(mhz) == channel


@pytest.mark.parametrize(
    ("mantissa", "exponent", "channel"),
    [
        (2437, 6, 6),
        (243700000, 1, 6),
        (5745, 6, 149),
        (11, 0, 11),
        (0, 0, None),
        (-1, 0, None),
        (1, -3, None),
        (2147483647, 9, None),
        (1, 32767, None),
    ],
)
def test_what_the_driver_says_it_is_tuned_to(mantissa: int, exponent: int, channel: int | None) -> None:
    answer = b"wlan0".ljust(16, b"\0") + struct.pack("ih", mantissa, exponent)
    assert tuned_channel(answer.ljust(40, b"\0")) == channel
