"""Configuration of a Bluetooth controller."""

from __future__ import annotations

from typing import Self

import msgspec

from companion.address_forms import check_form, used_by
from companion.errors import ConfigError
from companion.radio.section import RadioSection

_CHANNEL_FORMS = ("user:NUMBER", "uart:DEVICE:BAUD", "tcp:HOST:PORT")


class HciRadio(RadioSection, frozen=True, tag="hci"):
    """A Bluetooth controller; no other software may use it."""

    driver = "companion.radio.hci.hci_radio:open_radio"
    channel: str
    """user:NUMBER (Linux hciN), uart:DEVICE:BAUD or tcp:HOST:PORT."""
    send: bool = True
    listen: bool = True

    @property
    def sends(self) -> bool:
        """The key `send`."""
        return self.send

    def check(self, name: str) -> None:
        """Check the form of the channel, and that the radio does anything."""
        check_form(self.channel, _CHANNEL_FORMS, f"{name}.channel")
        if not (self.send or self.listen):
            raise ConfigError(f"{name}: send and listen are both false; at least one must be true")

    def uses(self) -> dict[str, str]:
        """The controller. A TCP server, as of virtual controllers, may give each connection its own."""
        kind, _, number = self.channel.partition(":")
        if kind == "tcp":
            return {}
        used = used_by(self.channel) if kind == "uart" else f"hci{int(number)}"
        return {} if used is None else {"channel": used}

    def listening(self) -> Self | None:
        """The radio without its sending part."""
        return msgspec.structs.replace(self, send=False) if self.listen else None
