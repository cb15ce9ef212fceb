"""All configured radios as one: each transport is sent by the first radio that can, and all radios listen."""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from companion.config import Config
from companion.errors import ConfigError
from companion.events import RadioState, RemoteIdHeard
from companion.radio.null.null_radio import NullTransport
from companion.radio.radio import Health, Radio, RadioContext
from companion.radio.registry import RadioConfig
from companion.remote_id.messages import Message
from companion.remote_id.transports import WIFI_BEACON
from companion.runtime import clock
from companion.runtime.links.kept_link import KeptLink
from companion.runtime.links.open_link import open_link
from companion.runtime.refusals import Refusing


class _RadioLink:
    """Adapts a `KeptLink` to drivers of radios, which read plain bytes."""

    def __init__(self, link: KeptLink) -> None:
        self.wait, self.send, self.close = link.wait, link.send, link.close
        self._link = link

    def receive(self, now_s: float) -> bytes:
        """Bytes that have arrived."""
        return self._link.receive(now_s).data


def open_radio(entry: RadioConfig, name: str) -> Radio:
    """Open one radio.

    Args:
        name: name of the aircraft; its radio address is derived from it.

    Raises:
        ConfigError: the radio cannot be opened. The text says what is missing.
    """
    opened: Radio = pkgutil.resolve_name(entry.driver)(entry, RadioContext(name, clock.now_s, _radio_link))
    return opened


def _radio_link(text: str) -> _RadioLink:
    # Losses of this link need no text of their own: the radio's state shows that it is silent.
    return _RadioLink(KeptLink(text, lambda text: None, partial(open_link, key="link")))


class Radios:
    """The configured radios.

    If there is more than one, texts name them by their index in the configuration (radio[0], ...), because
    two radios of the same kind cannot be told apart otherwise.

    Args:
        sending: False opens the radios and listens, but neither configures them nor sends.
        failed: receives the reason why a radio cannot be opened; that radio is then left out. If `failed` is
            None, the first radio that cannot be opened raises.

    Raises:
        ConfigError: a radio cannot be opened, and `failed` is None.
    """

    def __init__(
        self, config: Config, *, sending: bool = True, failed: Callable[[str], None] | None = None
    ) -> None:
        self._sending = sending
        self._alone = len(config.radio) < 2
        self._places: list[int] = []
        """Index in the configuration of each open radio."""
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
        self._refusing = [Refusing() for _ in self.radios]

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that at least one radio can send on."""
        return frozenset().union(*(radio.capabilities for radio in self.radios))

    @property
    def wifi_channel(self) -> int | None:
        """Channel of the first Wi-Fi radio; None if there is none."""
        return next((r.wifi_channel for r in self.radios if r.wifi_channel is not None), None)

    def configure(self, rates: Mapping[str, int]) -> list[str]:
        """Prepare each radio for the transports that it will send. Without `sending`, only probe whether that
        is possible.

        Args:
            rates: messages per second for each transport.

        Returns:
            What was set, or would be set, on each radio that repeats messages by itself.

        Raises:
            ConfigError: a radio cannot be prepared. If probing shows that beforehand, no radio is changed.
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
        """Frames that arrived since the last call, and the state of the radios if it changed."""
        events: list[RemoteIdHeard | RadioState] = []
        for radio in self.radios:
            events += radio.heard(now_s)
        state = self.state(now_s)
        if state != self._state:
            self._state = state
            events.append(state)
        return events

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """Send these messages once, with the first radio that can send on this transport now.

        Raises:
            ValueError: no radio has this transport, or the messages cannot be sent.
        """
        able = [n for n, radio in enumerate(self.radios) if transport in radio.capabilities]
        if not able:
            raise ValueError(f"no radio can send on {transport!r}")
        if self._sending:
            ready = [n for n in able if transport in self._health(n, now_s).can_send]
            number = (ready or able)[0]
            try:
                self.radios[number].broadcast(transport, messages, now_s)
            except ValueError:
                self._refusing[number].refused(transport, now_s)
                raise
            self._refusing[number].sent(transport)

    def _health(self, number: int, now_s: float) -> Health:
        """What a radio reports, except that a transport on which it refuses everything cannot send."""
        health, unable = self.radios[number].health(now_s), self._refusing[number].unable(now_s)
        if not unable:
            return health
        text = f"{health.text}; refuses all broadcasts on {', '.join(sorted(unable))}"
        return replace(health, ok=False, text=text, can_send=health.can_send - unable)

    def _healths(self, now_s: float) -> list[Health]:
        return [self._health(number, now_s) for number in range(len(self.radios))]

    def state(self, now_s: float) -> RadioState:
        """What the radios can do now."""
        healths = self._healths(now_s)
        senders: dict[str, int] = {}
        for number, health in enumerate(healths):
            for transport in health.can_send:
                senders.setdefault(transport, number)
        # Only the radio that really sends a transport can be heard or confirm it; a dry run sends nothing.
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
        """Whether another radio of ours would hear and recognise what this radio sends."""
        others = self.radios[:sender] + self.radios[sender + 1 :]
        return bool(self.radios[sender].own_addresses) and any(transport in radio.hears for radio in others)

    def health(self, now_s: float) -> Health:
        """State of all radios combined."""
        if not self.radios:
            return NullTransport().health(now_s)
        healths = self._healths(now_s)
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
        """State of each radio and what it lacks, one line each."""
        healths = self._healths(now_s)
        return [self._line(n, text) for n, h in enumerate(healths) for text in (h.text, *h.missing)]

    def close(self) -> None:
        """Stop sending and close all radios."""
        for radio in self.radios:
            radio.close()
