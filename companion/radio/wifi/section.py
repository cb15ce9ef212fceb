"""Configuration of a Wi-Fi card."""

from __future__ import annotations

from typing import Annotated, Self

import msgspec
from msgspec import Meta

from companion.errors import ConfigError
from companion.radio.section import RadioSection

Interface = Annotated[str, Meta(min_length=1, max_length=15)]
"""Name of a network interface; Linux allows at most 15 characters."""


class WifiRadio(RadioSection, frozen=True, tag="wifi"):
    """A Wi-Fi card."""

    driver = "companion.radio.wifi.wifi_radio:open_radio"
    hostapd: str | None = None
    """Control socket of a running hostapd, such as /var/run/hostapd/wlan0, through which beacons are sent."""
    inject: Interface | None = None
    """Monitor interface to inject beacons and NAN frames on."""
    monitor: Interface | None = None
    """Monitor interface to listen on."""
    channel: Annotated[int, Meta(ge=1, le=177)] = 6
    """Wi-Fi channel of the card; if hostapd reports a channel, that one is used."""

    @property
    def sends(self) -> bool:
        """Whether there is a sending part."""
        return self.hostapd is not None or self.inject is not None

    def check(self, name: str) -> None:
        """Check that there is a part, and that the name of hostapd's interface is possible."""
        if self.hostapd is self.inject is self.monitor is None:
            raise ConfigError(f"{name}: needs hostapd, inject or monitor")
        interface = (self.hostapd or "").rpartition("/")[2]
        if self.hostapd is not None and not 1 <= len(interface) <= 15:
            raise ConfigError(
                f"{name}.hostapd: {self.hostapd!r}: the path must end with the name of a network "
                f"interface, 1 to 15 characters; {interface!r} has {len(interface)}"
            )

    def uses(self) -> dict[str, str]:
        """The network interface of each part."""
        hostapd = self.hostapd and self.hostapd.rpartition("/")[2]
        parts = {"hostapd": hostapd, "inject": self.inject, "monitor": self.monitor}
        return {key: f"interface {name}" for key, name in parts.items() if name is not None}

    def listening(self) -> Self | None:
        """The monitor interface alone."""
        return None if self.monitor is None else msgspec.structs.replace(self, hostapd=None, inject=None)
