"""All radios of the configuration as one: each transport is sent by the first that can, all listen."""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import partial

from companion.config import (
    ArduRemoteIdRadio,
    Config,
    EtherRadio,
    HciRadio,
    NullRadio,
    RadioConfig,
    WifiRadio,
)
from companion.errors import ConfigError
from companion.events import RadioState, RemoteIdHeard
from companion.radio.arduremoteid import ArduRemoteIdTransport
from companion.radio.ether import EtherTransport
from companion.radio.frames_io import radio_address
from companion.radio.hci import HciTransport
from companion.radio.null import NullTransport
from companion.radio.transport import WIFI_BEACON, Health, Transport
from companion.radio.wifi import WifiTransport
from companion.remote_id.messages import Message
from companion.runtime.kept_link import KeptLink
from companion.runtime.links import open_link


def open_radio(entry: RadioConfig, uas_id: str) -> Transport:
    """One radio, open.

    Raises:
        ConfigError: it cannot be opened; says what is missing.
    """
    address = radio_address(uas_id)
    match entry:
        case NullRadio():
            return NullTransport()
        case EtherRadio():
            return EtherTransport(entry.address, uas_id, address)
        case WifiRadio():
            return WifiTransport(entry, address)
        case HciRadio():
            return HciTransport(entry.channel, address, send=entry.send, listen=entry.listen)
        case ArduRemoteIdRadio():
            # What is lost and found again shows in the radio's own state: the module falls silent.
            link = KeptLink(entry.link, lambda text: None, partial(open_link, key="link"))
            return ArduRemoteIdTransport(link, entry.system_id, time.monotonic, entry.link)


class Radios:
    """The configured radios.

    Args:
        sending: False opens and hears, but neither configures nor sends.

    Raises:
        ConfigError: one cannot be opened.
    """

    def __init__(self, config: Config, *, sending: bool = True) -> None:
        self._sending = sending
        self._state: RadioState | None = None
        self.radios: list[Transport] = []
        try:
            for number, entry in enumerate(config.radio):
                try:
                    self.radios.append(open_radio(entry, config.identity.uas_id))
                except ConfigError as error:
                    raise ConfigError(f"radio[{number}]: {error}") from error
        except ConfigError:
            self.close()
            raise

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that any radio can send on."""
        return frozenset().union(*(radio.capabilities for radio in self.radios))

    @property
    def wifi_channel(self) -> int | None:
        """Channel of the first Wi-Fi radio."""
        return next((r.wifi_channel for r in self.radios if r.wifi_channel is not None), None)

    def configure(self, rates: Mapping[str, int]) -> None:
        """Prepare each radio for the transports that it is to send. Raises ConfigError."""
        if not self._sending:
            return
        left = dict(rates)
        for radio in self.radios:
            mine = {t: left.pop(t) for t in sorted(radio.capabilities & left.keys())}
            radio.configure(mine)

    def events(self, now_s: float) -> list[RemoteIdHeard | RadioState]:
        """What arrived since the last call, and the radios' state where it changed."""
        events: list[RemoteIdHeard | RadioState] = []
        for radio in self.radios:
            events += radio.heard(now_s)
        state = self.state(now_s)
        if state != self._state:
            self._state = state
            events.append(state)
        return events

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once, by the first radio that can now.

        Raises:
            ValueError: no radio has this transport, or messages that cannot be sent.
        """
        able = [radio for radio in self.radios if transport in radio.capabilities]
        if not able:
            raise ValueError(f"no radio sends on {transport!r}")
        if self._sending:
            ready = [radio for radio in able if transport in radio.health(now_s).can_send]
            (ready or able)[0].broadcast(transport, messages, now_s)

    def state(self, now_s: float) -> RadioState:
        """What the radios can do now."""
        healths = [radio.health(now_s) for radio in self.radios]
        senders: dict[str, int] = {}
        for number, health in enumerate(healths):
            for transport in health.can_send:
                senders.setdefault(transport, number)
        # Only who really sends a transport can be heard or confirm it; a dry run sends nothing.
        monitored, confirmed = set(), set()
        for transport, sender in senders.items() if self._sending else ():
            word = healths[sender].confirmed
            if word is not None or self._is_heard(transport, sender):
                monitored.add(transport)
            if word is not None and transport in word:
                confirmed.add(transport)
        beacons = senders.get(WIFI_BEACON)
        return RadioState(
            can_send=tuple(sorted(senders)),
            monitored=tuple(sorted(monitored)),
            confirmed=tuple(sorted(confirmed)),
            own_addresses=tuple(sorted(frozenset().union(*(radio.own_addresses for radio in self.radios)))),
            wifi_channel=self.wifi_channel if beacons is None else self.radios[beacons].wifi_channel,
            text="; ".join(health.text for health in healths if not health.ok),
        )

    def _is_heard(self, transport: str, sender: int) -> bool:
        """Whether another radio of ours would hear, and know, what this one sends."""
        others = self.radios[:sender] + self.radios[sender + 1 :]
        return bool(self.radios[sender].own_addresses) and any(transport in radio.hears for radio in others)

    def health(self, now_s: float) -> Health:
        """All radios' states as one."""
        healths = [radio.health(now_s) for radio in self.radios]
        if not healths:
            healths = [NullTransport().health(now_s)]
        return Health(
            ok=all(health.ok for health in healths),
            text="; ".join(health.text for health in healths),
            frames_sent=sum(health.frames_sent for health in healths),
            frames_heard=sum(health.frames_heard for health in healths),
            bad_frames=sum(health.bad_frames for health in healths),
            can_send=frozenset().union(*(health.can_send for health in healths)),
            missing=tuple(text for health in healths for text in health.missing),
        )

    def close(self) -> None:
        """Go off the air."""
        for radio in self.radios:
            radio.close()
