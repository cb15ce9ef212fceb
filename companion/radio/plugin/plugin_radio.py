"""Opens the radio of a plug-in, and guards it so that nothing it raises or returns ends the flight.

A plug-in of `dmuca.radios` is a function of a table of options (`[radio.options]` of the configuration) and a
`radio.RadioContext` that returns a `radio.Radio`. It raises `companion.errors.ConfigError` for what the user
must correct. It runs in the loop of the flight, so none of its methods but `configure` may take time.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from itertools import islice
from typing import Any, TypeVar

from companion import plugins
from companion.errors import ConfigError
from companion.events import RemoteIdHeard
from companion.plugins import Plugin
from companion.radio.frames_io import TRANSPORTS
from companion.radio.plugin.section import PluginRadio
from companion.radio.radio import Health, Radio, RadioContext
from companion.remote_id import codec
from companion.remote_id.messages import Message

MOST_HEARD = 500
"""Most frames that are taken from it in one step of the loop."""
MOST_MESSAGES = codec.PACK_MAX_MESSAGES
"""Most messages of one frame."""
FORGIVEN_S = 5.0
"""A transport whose broadcast failed is tried again after this time. As long as it counts as unable to send,
nothing is broadcast on it, so that no success could show that it works again."""
_TEXT = 200
"""Most characters of its texts."""
_ADDRESS = 40

T = TypeVar("T")


class GuardedRadio:
    """A `Radio` that passes on what a plug-in's radio does, as far as it keeps the contract.

    A message that it hears is encoded and decoded again, so that it holds only what can be on the air.
    """

    def __init__(self, radio: Radio, plugin: Plugin) -> None:
        self.made = radio
        """The radio that the plug-in made."""
        self._plugin = plugin
        self.trouble: str | None = None
        """What it did wrong last, in words; None if nothing."""
        self._failed_s: dict[str, float] = {}
        """When the last broadcast failed, for each transport whose last one did."""
        self._refusing_s: dict[str, float] = {}
        """Since when each transport refuses all messages, for those that do."""
        self.left_out = 0
        """Frames that it returned and that break the contract."""

    @property
    def capabilities(self) -> frozenset[str]:
        """Transports that it says it can send on."""
        return self._ask(lambda: _transports(self.made.capabilities), frozenset())

    @property
    def hears(self) -> frozenset[str]:
        """Transports that it says it receives."""
        return self._ask(lambda: _transports(self.made.hears), frozenset())

    @property
    def own_addresses(self) -> frozenset[str]:
        """Addresses that it says it sends from."""
        return self._ask(lambda: frozenset(map(_address, self.made.own_addresses)), frozenset())

    @property
    def wifi_channel(self) -> int | None:
        """Channel of its Wi-Fi frames."""
        return self._ask(lambda: _number(self.made.wifi_channel), None)

    def configure(self, rates: Mapping[str, int], *, probe: bool = False) -> tuple[str, ...]:
        """See `Radio.configure`."""
        try:
            words = self.made.configure(dict(rates), probe=probe)
            return tuple(_text(word) for word in words)
        except (ConfigError, KeyboardInterrupt):
            raise
        except BaseException as error:
            raise ConfigError(f"{self._plugin} cannot be prepared: {plugins.cause(error)}") from error

    def broadcast(self, transport: str, messages: tuple[Message, ...], now_s: float) -> None:
        """See `Radio.broadcast`.

        A plug-in that refuses everything for `FORGIVEN_S` has failed: it may raise ValueError because its
        file is closed.
        """
        try:
            self.made.broadcast(transport, messages, now_s)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            if isinstance(error, ValueError):
                since_s = self._refusing_s.setdefault(transport, now_s)
                if now_s - since_s < FORGIVEN_S:
                    raise ValueError(plugins.cause(error)) from error
            self._failed_s[transport] = now_s
            self._note(error)
        else:
            self._failed_s.pop(transport, None)
            self._refusing_s.pop(transport, None)

    def heard(self, now_s: float) -> list[RemoteIdHeard]:
        """See `Radio.heard`. Frames that break the contract are counted and left out."""
        found: list[RemoteIdHeard] = []
        nothing: list[Any] = []
        for event in self._ask(lambda: list(islice(self.made.heard(now_s), MOST_HEARD)), nothing):
            try:
                found.append(_checked(event))
            except Exception:  # whatever a plug-in may put into a message
                self.left_out += 1
        return found

    def health(self, now_s: float) -> Health:
        """The state that it reports; not ok once it broke the contract."""
        told = self._ask(lambda: _health(self.made.health(now_s)), None)
        if told is None:
            return Health(False, f"{self._plugin}: {self.trouble}", 0, 0, self.left_out)
        failed = {t for t, failed_s in self._failed_s.items() if now_s - failed_s < FORGIVEN_S}
        trouble = "" if self.trouble is None else f"; {self.trouble}"
        return Health(
            ok=told.ok and self.trouble is None,
            text=told.text + trouble,
            frames_sent=told.frames_sent,
            frames_heard=told.frames_heard,
            bad_frames=told.bad_frames + self.left_out,
            # What it cannot send would count as on the air, because `Radios` never asks it to send that.
            can_send=(told.can_send & self.capabilities) - failed,
            confirmed=told.confirmed,
            missing=told.missing,
        )

    def close(self) -> None:
        """See `Radio.close`."""
        self._ask(self.made.close, None)

    def _ask(self, question: Callable[[], T], otherwise: T) -> T:
        try:
            return question()
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also asyncio's CancelledError, which is no Exception
            self._note(error)
            return otherwise

    def _note(self, error: BaseException) -> None:
        self.trouble = f"the plug-in failed: {plugins.cause(error)}"


def open_radio(section: PluginRadio, context: RadioContext) -> GuardedRadio:
    """Open the radio of a plug-in.

    Raises:
        ConfigError: it cannot be loaded or opened.
    """
    try:
        plugin = plugins.load(plugins.RADIOS, section.name)
    except ConfigError as error:
        raise ConfigError(f"radio.name: {error}") from error
    try:
        return GuardedRadio(plugin.loaded(copy.deepcopy(section.options), context), plugin)
    except ConfigError as error:
        raise ConfigError(f"radio.options: {error}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ConfigError(f"radio {plugin} cannot be opened: {plugins.cause(error)}") from error


def _checked(event: Any) -> RemoteIdHeard:
    """A heard frame, rebuilt so that it holds only what can be on the air.

    Raises:
        Exception: the event breaks the contract of `RemoteIdHeard`.
    """
    if not isinstance(event, RemoteIdHeard) or not 0 < len(event.messages) <= MOST_MESSAGES:
        raise ValueError("not one frame with messages")
    (transport,) = _transports((event.transport,))
    rssi, counter = event.rssi_dbm, _number(event.counter)
    if counter is not None and not 0 <= counter <= 255:
        raise ValueError(f"counter {counter}")
    return RemoteIdHeard(
        transport=transport,
        address=_address(event.address),
        messages=tuple(_on_air(message) for message in event.messages),
        rssi_dbm=float(rssi) if rssi is not None and math.isfinite(rssi) else None,
        counter=counter,
    )


def _on_air(message: Message) -> Message:
    decoded = codec.decode(codec.encode(message))
    if type(decoded) is not type(message):
        raise ValueError("not a message")
    return decoded


def _health(told: Any) -> Health:
    """The state that a plug-in reports. Raises an exception if it is none."""
    sent, heard, bad = (_number(n) or 0 for n in (told.frames_sent, told.frames_heard, told.bad_frames))
    return Health(
        ok=bool(told.ok),
        text=_text(told.text),
        frames_sent=sent,
        frames_heard=heard,
        bad_frames=bad,
        can_send=_transports(told.can_send),
        confirmed=None if told.confirmed is None else _transports(told.confirmed),
        missing=tuple(map(_text, told.missing)),
    )


def _transports(names: Any) -> frozenset[str]:
    found = frozenset(names)
    if not found <= TRANSPORTS:
        raise ValueError(f"transports {sorted(map(str, found - TRANSPORTS))} are unknown")
    return found


def _address(text: Any) -> str:
    if not isinstance(text, str) or len(text) > _ADDRESS:
        raise ValueError(f"address {text!r:.60}")
    return text


def _number(value: Any) -> int | None:
    if value is not None and (not isinstance(value, int) or abs(value) >= 1 << 53):
        raise ValueError(f"{value!r:.60} is no number")
    return value


def _text(text: Any) -> str:
    if not isinstance(text, str):
        raise TypeError(f"{text!r:.60} is no text")
    return "".join(c if c.isprintable() else " " for c in text[:_TEXT])
