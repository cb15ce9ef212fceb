"""Remote ID on Wi-Fi with a Linux card: beacons by hostapd, injected frames, reception in monitor mode.

- hostapd puts the element into the beacons of its access point and repeats them by itself (`hostapd`).
- Injection sends every broadcast once, as an 802.11 frame of our own: `wifi` beacons if hostapd does not send
  them, and `nan` action frames together with the required synchronisation beacon.
- The monitor interface receives both. The card's reports of its own transmissions do not count as received.
  Frames with radiotap TX flags are therefore dropped, as are frames from our own addresses that hold recently
  sent content. Any other frame from our addresses comes from a device that copied the address. To receive our
  own transmissions with a second card, configure that card as a separate radio.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Mapping
from typing import Final, TypeVar

from companion.errors import ConfigError, PeerDataError
from companion.events import RemoteIdHeard
from companion.radio.frames_io import FrameReceiver, FrameSender
from companion.radio.radio import Health, RadioContext
from companion.radio.wifi.hostapd import HostapdControl
from companion.radio.wifi.packet_socket import PacketSocket, channel_of
from companion.radio.wifi.section import WifiRadio
from companion.remote_id.captures.radiotap import build_radiotap, parse_radiotap
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import Counters, build_nan_sync_beacon, build_vendor_element
from companion.remote_id.messages import Message
from companion.remote_id.transports import WIFI_BEACON, WIFI_NAN

SYNC_PERIOD_S: Final = 512 * 1024e-6
"""NAN period: the longest time between two synchronisation beacons, 512 TU."""
_NAN_IN_USE_S: Final = 3.0
"""Synchronisation continues for this long after the last NAN broadcast."""
_RATE_2_4_GHZ: Final = 2
"""1 Mb/s in units of 500 kb/s, the rate with the longest range."""
_RATE_5_GHZ: Final = 12
"""6 Mb/s, the lowest rate on 5 GHz."""
_SLOW_BEACONS_TU: Final = 195
"""0.2 s. A longer beacon interval cannot reach 5 beacons per second."""
_BEACON: Final = 0x80
_SOURCE_AT, _SEQUENCE_AT, _TSF_AT = 10, 22, 24
_REMEMBERED: Final = 32
"""Number of sent frames remembered; more than are sent while a received frame waits to be read."""

_Part = TypeVar("_Part", HostapdControl, PacketSocket)


class WifiTransport:
    """A `Radio` that uses one Wi-Fi card.

    Args:
        config: Its parts. `health` reports each part that cannot be opened.
        address: Source address for injection. If hostapd reports its BSSID, that is used instead.

    Raises:
        ConfigError: no part can be opened. The text says why for each.
    """

    def __init__(self, config: WifiRadio, address: str) -> None:
        self._config = config
        self._missing: list[str] = []
        channel = config.channel
        self._hostapd = self._try(config.hostapd, HostapdControl)
        if self._hostapd is not None:
            channel = self._hostapd.status.channel or channel
            address = self._hostapd.status.bssid or address
        self._inject = self._try(
            config.inject, lambda name: PacketSocket("radio.inject", name, channel, listen=False)
        )
        self._monitor = self._try(
            config.monitor, lambda name: PacketSocket("radio.monitor", name, channel, listen=True)
        )
        if self._hostapd is None and self._inject is None and self._monitor is None:
            raise ConfigError("; ".join(self._missing) or "radio: needs hostapd, inject or monitor")
        self._sender = FrameSender(address)
        self._counters = Counters()
        self._receiver = FrameReceiver()
        self._radiotap = build_radiotap(_RATE_2_4_GHZ if channel <= 14 else _RATE_5_GHZ)
        self._lately: deque[bytes] = deque(maxlen=_REMEMBERED)
        """Content of sent frames, starting after the header fields that drivers fill in themselves."""
        self._sequence = 0
        self._nan_s: float | None = None
        self._sync_s: float | None = None
        self._injected = 0
        self._unsent = 0
        self._bad_fcs = 0
        self._torn = 0
        self._heard_channel: int | None = None

    def _try(self, name: str | None, opener: Callable[[str], _Part]) -> _Part | None:
        if name is None:
            return None
        try:
            return opener(name)
        except ConfigError as error:
            self._missing.append(str(error))
            return None

    @property
    def capabilities(self) -> frozenset[str]:
        """Beacons with hostapd; beacons and NAN with injection."""
        if self._inject is not None:
            return frozenset((WIFI_BEACON, WIFI_NAN))
        return frozenset((WIFI_BEACON,)) if self._hostapd is not None else frozenset()

    @property
    def hears(self) -> frozenset[str]:
        """Beacons and NAN while the monitor interface works and is on the right channel."""
        if self._monitor is None or self._monitor.trouble is not None or self._off_channel() is not None:
            return frozenset()
        return frozenset((WIFI_BEACON, WIFI_NAN))

    @property
    def own_addresses(self) -> frozenset[str]:
        """hostapd's BSSID, and the source address of injected frames."""
        addresses = {self._sender.address} if self._inject is not None else set()
        if self._hostapd is not None and self._hostapd.status.bssid is not None:
            addresses.add(self._hostapd.status.bssid)
        return frozenset(addresses)

    @property
    def wifi_channel(self) -> int | None:
        """Channel that hostapd reports, else the configured one.

        An injecting card must be tuned to that channel, if its driver reports it.
        """
        if not self.capabilities:
            return None
        told = None if self._hostapd is None else self._hostapd.status.channel
        return told or self._config.channel

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """Check the transports. Raises ConfigError for a transport outside `capabilities`."""
        wrong = sorted(rates.keys() - self.capabilities)
        if wrong:
            raise ConfigError(f"radio: this Wi-Fi radio cannot send {', '.join(wrong)}{self._because()}")
        return ()

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once: in hostapd's beacon, or as one injected frame (per 9 messages).

        Raises:
            ValueError: a transport outside `capabilities`, or messages that cannot be sent.
        """
        if transport not in self.capabilities:
            raise ValueError(f"this Wi-Fi radio cannot send {transport!r}{self._because()}")
        self._tick(now_s)
        hostapd = self._hostapd
        if transport == WIFI_BEACON and hostapd is not None and (self._inject is None or not hostapd.trouble):
            if messages:
                pack = encode_pack(messages)
                element = build_vendor_element(pack, self._counters.next(WIFI_BEACON, pack))
                hostapd.set_element(element, now_s)
                self._lately.append(element)
            return
        frames = self._sender.frames(transport, messages)
        if transport == WIFI_NAN and frames:
            # Receivers listen right after a synchronisation beacon, so the frames follow one of their own.
            self._nan_s, self._sync_s = now_s, None
            self._synchronise(now_s)
        for frame in frames:
            self._lately.append(frame[_TSF_AT + 8 :])
            if self._put(frame, now_s):
                self._injected += 1
            else:
                self._unsent += 1

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """Return what arrived since the last call. Bad frames are counted, never raised."""
        self._tick(now_s)
        self._synchronise(now_s)
        if self._monitor is None or self._monitor.trouble is not None:
            return []
        own = self.own_addresses
        events = [self._take(data, own) for data in self._monitor.receive()]
        return [event for event in events if event is not None]

    def health(self, now_s: float) -> Health:
        """Report ok while every configured part works."""
        parts = self._parts()
        notes = [trouble if trouble else text for text, trouble in parts]
        if self._unsent:
            notes.append(f"{self._unsent} frames could not be sent")
        if self._monitor is not None and self._monitor.dropped:
            notes.append(f"{self._monitor.dropped} received frames lost because they came too fast")
        if self._receiver.last_error:
            notes.append(f"last bad frame: {self._receiver.last_error}")
        return Health(
            ok=not self._missing and not any(trouble for _, trouble in parts),
            text="Wi-Fi: " + "; ".join(self._missing + notes),
            frames_sent=self._injected + (self._hostapd.updates if self._hostapd else 0),
            frames_heard=self._receiver.heard,
            bad_frames=self._receiver.bad + self._bad_fcs + self._torn,
            can_send=self._can_send(),
            missing=tuple(self._missing) + self._slow_beacons(),
        )

    def close(self) -> None:
        """Stop sending and release the card."""
        for part in (self._hostapd, self._inject, self._monitor):
            if part is not None:
                part.close()

    def _parts(self) -> list[tuple[str, str | None]]:
        """Return a description of each open part, and its trouble."""
        parts = []
        if self._hostapd is not None:
            text = f"beacons by hostapd {self._hostapd.path}"
            parts.append((text, self._hostapd.trouble and f"{text}: {self._hostapd.trouble}"))
        if self._inject is not None:
            parts.append((f"injects on {self._inject.interface}", self._inject.trouble))
        if self._monitor is not None:
            parts.append(
                (f"listens on {self._monitor.interface}", self._monitor.trouble or self._off_channel())
            )
        return parts

    @property
    def _channel(self) -> int:
        """Channel that the card must be tuned to."""
        return self.wifi_channel or self._config.channel

    def _off_channel(self) -> str | None:
        if self._monitor is None or self._heard_channel in (None, self._channel):
            return None
        return f"{self._monitor.interface} listens on channel {self._heard_channel}, not on {self._channel}"

    def _slow_beacons(self) -> tuple[str, ...]:
        interval_tu = None if self._hostapd is None else self._hostapd.status.beacon_interval_tu
        if interval_tu is None or interval_tu <= _SLOW_BEACONS_TU:
            return ()
        return (
            f"hostapd sends a beacon only every {interval_tu} TU; set beacon_int=100 in its configuration",
        )

    def _can_send(self) -> frozenset[str]:
        if self._inject is not None and self._inject.trouble is None:
            return frozenset((WIFI_BEACON, WIFI_NAN))
        if self._hostapd is not None and self._hostapd.trouble is None:
            return frozenset((WIFI_BEACON,))
        return frozenset()

    def _because(self) -> str:
        return "".join(f"; {text}" for text in self._missing)

    def _tick(self, now_s: float) -> None:
        if self._hostapd is not None:
            self._hostapd.poll(now_s)
        for part in (self._inject, self._monitor):
            if part is not None:
                part.keep_open(now_s, self._channel)

    def _synchronise(self, now_s: float) -> None:
        """Send the NAN synchronisation beacon if it is due and NAN is in use."""
        if self._nan_s is None or now_s - self._nan_s > _NAN_IN_USE_S:
            self._sync_s = None
            return
        due_s = now_s if self._sync_s is None else self._sync_s + SYNC_PERIOD_S
        if now_s < due_s:
            return
        self._sync_s = due_s if now_s - due_s < SYNC_PERIOD_S else now_s
        self._put(build_nan_sync_beacon(self._sender.address), now_s)

    def _put(self, frame: bytes, now_s: float) -> bool:
        """Inject a frame with a sequence number. Most drivers overwrite the number, some leave it to us."""
        if self._inject is None or self._inject.trouble is not None:
            return False
        sent = self._inject.send(self._radiotap + stamp(frame, self._sequence, round(now_s * 1e6)), now_s)
        self._sequence = (self._sequence + 1) & 0xFFF
        return sent

    def _take(self, data: bytes, own: frozenset[str]) -> RemoteIdHeard | None:
        try:
            captured = parse_radiotap(data)
        except PeerDataError:
            self._torn += 1
            return None
        if captured.transmitted or not captured.frame:
            return None
        if captured.bad_fcs:
            self._bad_fcs += 1
            return None
        if captured.channel_mhz is not None:
            self._heard_channel = channel_of(captured.channel_mhz)
        source = captured.frame[_SOURCE_AT : _SOURCE_AT + 6].hex(":")
        if source in own and any(sent in captured.frame for sent in self._lately):
            return None
        return self._receiver.receive_wifi(captured.frame, captured.rssi_dbm)


def stamp(frame: bytes, sequence: int, tsf_us: int) -> bytes:
    """Return a management frame with its sequence number and, in a beacon, timestamp (IEEE 802.11, 9.3.3).

    Args:
        sequence: Sequence number, 0-4095.
        tsf_us: Clock of the sender; taken modulo 2**64.
    """
    head = frame[:_SEQUENCE_AT] + struct.pack("<H", sequence << 4)
    if frame[0] != _BEACON:
        return head + frame[_TSF_AT:]
    return head + struct.pack("<Q", tsf_us % (1 << 64)) + frame[_TSF_AT + 8 :]


def open_radio(section: WifiRadio, context: RadioContext) -> WifiTransport:
    """Open the card that a configuration names.

    Raises:
        ConfigError: no part of it can be opened. The text says why for each.
    """
    return WifiTransport(section, context.address)
