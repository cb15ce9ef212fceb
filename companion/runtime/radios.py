"""All radios of the configuration as one: each transport is sent by the first that can, all listen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from companion.radio.arduremoteid.module_radio import ArduRemoteIdTransport
from companion.radio.ether.ether_radio import EtherTransport
from companion.radio.frames_io import radio_address
from companion.radio.hci.hci_radio import HciTransport
from companion.radio.null import NullTransport
from companion.radio.radio import Health, Radio
from companion.radio.wifi.wifi_radio import WifiTransport
from companion.remote_id.messages import Message
from companion.remote_id.transports import WIFI_BEACON
from companion.runtime import clock
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.open_link import open_link


class _ModuleLink:
    """A kept link as the driver of a module wants it: bytes alone."""

    def __init__(self, link: KeptLink) -> None:
        self.wait, self.send, self.close = link.wait, link.send, link.close
        self._link = link

    def receive(self, now_s: float) -> bytes:
        """What has arrived."""
        return self._link.receive(now_s).data


def open_radio(entry: RadioConfig, name: str) -> Radio:
    """One radio, open.

    Args:
        name: of the aircraft; its radio address follows from it.

    Raises:
        ConfigError: it cannot be opened; says what is missing.
    """
    address = radio_address(name)
    match entry:
        case NullRadio():
            return NullTransport()
        case EtherRadio():
            return EtherTransport(entry.address, name, address)
        case WifiRadio():
            return WifiTransport(entry, address)
        case HciRadio():
            return HciTransport(entry.channel, address, send=entry.send, listen=entry.listen)
        case ArduRemoteIdRadio():
            # What is lost and found again shows in the radio's own state: the module falls silent.
            link = KeptLink(entry.link, lambda text: None, partial(open_link, key="link"))
            return ArduRemoteIdTransport(_ModuleLink(link), entry.system_id, clock.now_s, entry.link)


class Radios:
    """The configured radios.

    In texts they go by their place in the configuration (radio[0], ...) where there is more than one: two of
    a kind cannot be told apart otherwise.

    Args:
        sending: False opens and hears, but neither configures nor sends.
        failed: takes why a radio cannot be opened; it is left out then. Without this the first one ends all.

    Raises:
        ConfigError: one cannot be opened.
    """

    def __init__(
        self, config: Config, *, sending: bool = True, failed: Callable[[str], None] | None = None
    ) -> None:
        self._sending = sending
        self._alone = len(config.radio) < 2
        self._places: list[int] = []
        """In the configuration, of each that is open."""
        self._state: RadioState | None = None
        self.radios: list[Radio] = []
        try:
            for number, entry in enumerate(config.radio):
                try:
                    self.radios.append(open_radio(entry, config.identity.name))
                except ConfigError as error:
                    text = f"radio[{number}]: {error}"
                    if failed is None:
                        raise ConfigError(text) from error
                    failed(text)
                else:
                    self._places.append(number)
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

    def configure(self, rates: Mapping[str, int]) -> list[str]:
        """Prepare each radio for the transports that it is to send; without `sending` only ask whether it
        could be.

        Returns:
            What was, or would be, set on each that repeats by itself.

        Raises:
            ConfigError: one cannot be; nothing is changed on any of them where that shows beforehand.
        """
        left = dict(rates)
        parts = [{t: left.pop(t) for t in sorted(r.capabilities & left.keys())} for r in self.radios]
        words = self._configure(parts, probe=True)
        return self._configure(parts, probe=False) if self._sending else words

    def _configure(self, parts: list[dict[str, int]], *, probe: bool) -> list[str]:
        words = []
        for number, (radio, mine) in enumerate(zip(self.radios, parts, strict=True)):
            try:
                texts = radio.configure(mine, probe=probe)
            except ConfigError as error:
                raise ConfigError(f"radio[{self._places[number]}]: {error}") from error
            words += [self._line(number, text) for text in texts]
        return words

    def _named(self, number: int, text: str) -> str:
        return text if self._alone else f"radio[{self._places[number]}]: {text}"

    def _line(self, number: int, text: str) -> str:
        return f"radio: {text}" if self._alone else self._named(number, text)

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
            text="; ".join(self._named(n, health.text) for n, health in enumerate(healths) if not health.ok),
        )

    def _is_heard(self, transport: str, sender: int) -> bool:
        """Whether another radio of ours would hear, and know, what this one sends."""
        others = self.radios[:sender] + self.radios[sender + 1 :]
        return bool(self.radios[sender].own_addresses) and any(transport in radio.hears for radio in others)

    def health(self, now_s: float) -> Health:
        """All radios' states as one."""
        if not self.radios:
            return NullTransport().health(now_s)
        healths = [radio.health(now_s) for radio in self.radios]
        return Health(
            ok=all(health.ok for health in healths),
            text="; ".join(self._named(n, health.text) for n, health in enumerate(healths)),
            frames_sent=sum(health.frames_sent for health in healths),
            frames_heard=sum(health.frames_heard for health in healths),
            bad_frames=sum(health.bad_frames for health in healths),
            can_send=frozenset().union(*(health.can_send for health in healths)),
            missing=tuple(
                self._named(n, text) for n, health in enumerate(healths) for text in health.missing
            ),
        )

    def lines(self, now_s: float) -> list[str]:
        """Each radio's state and what it lacks, a line each."""
        healths = [radio.health(now_s) for radio in self.radios]
        return [self._line(n, text) for n, h in enumerate(healths) for text in (h.text, *h.missing)]

    def close(self) -> None:
        """Go off the air."""
        for radio in self.radios:
            radio.close()
