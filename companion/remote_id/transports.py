"""Names of the transports that Remote ID goes out on, as configurations and records write them."""

from __future__ import annotations

from typing import Final

BLE4: Final = "ble4"
"""Bluetooth 4 legacy advertising, one message a frame."""
BLE5: Final = "ble5"
"""Bluetooth 5 Long Range advertising (coded PHY), a pack of messages a frame."""
WIFI_BEACON: Final = "wifi"
"""A vendor-specific element in Wi-Fi beacons."""
WIFI_NAN: Final = "nan"
"""Wi-Fi Neighbor Awareness Networking service discovery frames."""

MAX_RATE: Final = 10
"""Most Locations a second that are sent on one transport (psi_max of the paper)."""
