"""Names of the transports that carry Remote ID, as used in configurations and records."""

from __future__ import annotations

from typing import Final

BLE4: Final = "ble4"
"""Bluetooth 4 legacy advertising, one message per frame."""
BLE5: Final = "ble5"
"""Bluetooth 5 Long Range advertising (coded PHY), one pack of messages per frame."""
WIFI_BEACON: Final = "wifi"
"""Vendor-specific element in Wi-Fi beacons."""
WIFI_NAN: Final = "nan"
"""Wi-Fi Neighbor Awareness Networking service discovery frames."""

MAX_RATE: Final = 10
"""Highest rate of Locations per second on one transport (psi_max of the paper)."""
