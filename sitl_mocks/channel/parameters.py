"""Parameters of the radio channel: durations, powers and the growth of path loss with distance.

The defaults are the paper's table "Parameter settings for BLE 4, BLE 5, and Wi-Fi". Durations are in
milliseconds as there; `Slots` converts them to whole slots, rounded down (section "Packet Reception Model").
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal

import msgspec

from companion.errors import ConfigError
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON
from companion.toml_reader import decode_toml

MODES: Final = (BLE4, BLE5, WIFI_BEACON)
"""The paper's set of protocols, in the order that every array of this package uses."""
WIFI_CHANNELS: Final = (1, 6, 11)
SECONDARY_CHANNELS: Final = 37
"""BLE channels 0-36, on which auxiliary packets hop."""
OVERLAPPED_CHANNELS: Final = 9
"""Number of secondary BLE channels that one Wi-Fi channel covers, according to the paper."""

_DAY_MS = 86_400_000.0
_MAX_CYCLE_SLOTS = 1_000_000
"""Longest scan cycle. Bluetooth's longest cycle, three times 10.24 s, takes a quarter of it."""


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of all sections."""

    def _need(self, key: str, low: float, high: float, *, above: bool = False) -> None:
        """Raise ValueError unless `low` <= the key's value <= `high` (with `above`: `low` < value)."""
        value = getattr(self, key)
        # The negated comparison also refuses NaN.
        if not (low < value <= high if above else low <= value <= high):
            wanted = f"more than {low:g}, up to {high:g}" if above else f"{low:g} to {high:g}"
            raise ValueError(f"{key}: {value:g} is out of range; allowed: {wanted}")


class BleParameters(_Section, frozen=True, kw_only=True):
    """Parameters of BLE 4 and of the primary channels of BLE 5."""

    packet_ms: float = 0.376
    """A_P: one PDU (BLE 5: one pointer) on a primary channel."""
    gap_ms: float = 0.125
    """P_I: time from the end of one PDU to the start of the next one, on the next channel."""
    scan_interval_ms: float = 8.0
    """S_I: time that the receiver stays on one primary channel."""
    scan_window_ms: float = 2.0
    """S_W: time from the start of the scan interval during which the receiver listens."""
    random_delay_ms: float = 5.0
    """R_D: greatest pseudo-random delay of an advertising event. The equations do not use its length."""
    schedule: Literal["coprime", "random"] = "coprime"
    """How the equations model the timing of events relative to the receiver's scan. "coprime" is the paper's:
    an interval that shares no factor with the scan cycle and restarts at every GNSS sample. "random": each
    event has a phase of its own, which is the effect of the random delay.
    """
    transmit_power_dbm: float = 18.0
    sensitivity_dbm: float = -85.0
    max_rate: int = 10
    """Largest psi: messages in one GNSS period."""

    def __post_init__(self) -> None:
        self._need("packet_ms", 0.0, _DAY_MS, above=True)
        self._need("gap_ms", 0.0, _DAY_MS)
        self._need("scan_interval_ms", 0.0, _DAY_MS, above=True)
        self._need("scan_window_ms", 0.0, self.scan_interval_ms, above=True)
        self._need("packet_ms", 0.0, self.scan_window_ms, above=True)
        self._need("random_delay_ms", 0.0, _DAY_MS)
        self._need("transmit_power_dbm", -100.0, 100.0)
        self._need("sensitivity_dbm", -200.0, 0.0)
        self._need("max_rate", 1, 1000)


class Ble5Parameters(BleParameters, frozen=True, kw_only=True):
    """BLE 5 Long Range: pointers on the primary channels, the message in an auxiliary packet."""

    packet_ms: float = 1.152
    sensitivity_dbm: float = -97.0
    auxiliary_offset_ms: float = 5.0
    """A_Offset: time from the beginning of an event to its auxiliary packet."""
    auxiliary_ms: float = 3.328
    """T_AUX: duration of the auxiliary packet."""
    auxiliary_uncertainty_ms: float = 0.0
    """O_U: greatest extra delay of the auxiliary packet."""
    pointers: Literal["event", "interval"] = "event"
    """Which auxiliary packet a received pointer announces in the equations. "event": that of its own event.
    "interval": that in whose interval (T_GNSS / psi, counted from the GNSS sample) the pointer falls, which
    is the paper's I_xi to the letter. Events are a little longer or shorter than these intervals.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._need("auxiliary_ms", 0.0, _DAY_MS, above=True)
        self._need("auxiliary_uncertainty_ms", 0.0, _DAY_MS)
        # The auxiliary packet follows the third pointer, because one radio sends both.
        self._need("auxiliary_offset_ms", 3.0 * self.packet_ms + 2.0 * self.gap_ms, _DAY_MS)


class WifiParameters(_Section, frozen=True, kw_only=True):
    """Parameters of Wi-Fi beacons."""

    beacon_ms: float = 0.632
    """B_D: duration of a beacon."""
    scan_ms: float = 6.0
    """T_S: listening time on one channel."""
    switch_ms: float = 1.0
    """C_T: deaf time while switching from one channel to the next."""
    access: Literal["independent", "carrier_sense"] = "independent"
    """How the equations model the start of beacons. "independent" is the paper's: beacons ignore other
    transmissions, and their interval restarts at every GNSS sample. "carrier_sense": stations that hear each
    other take turns, and intervals run on (see `carrier_sense`). This affects only `Analytic`.
    `AnalyticChannel`, which decides frame by frame, always assumes independent beacons, and the packet-level
    simulator has its own assumptions.
    """
    transmit_power_dbm: float = 18.0
    sensitivity_dbm: float = -105.0
    max_rate: int = 10

    def __post_init__(self) -> None:
        self._need("scan_ms", 0.0, _DAY_MS, above=True)
        self._need("beacon_ms", 0.0, self.scan_ms, above=True)
        self._need("switch_ms", 0.0, _DAY_MS)
        self._need("transmit_power_dbm", -100.0, 100.0)
        self._need("sensitivity_dbm", -200.0, 0.0)
        self._need("max_rate", 1, 1000)


class PropagationParameters(_Section, frozen=True, kw_only=True):
    """Log-distance path loss with log-normal shadowing."""

    loss_at_1m_db: float = 52.55
    """Path loss at 1 m, calibrated because the paper does not give it. It yields ranges of 253, 941 and 2,263
    m, where the paper states 250, 1,000 and 2,000 m, and reproduces the published delays within 5 %.
    """
    exponent: float = 2.1
    shadowing_sigma_db: float = 0.0
    """The paper states a variance of 6 dB (sigma 2.449 dB), but its published delays are reproduced without
    shadowing.
    """

    def __post_init__(self) -> None:
        self._need("loss_at_1m_db", 0.0, 200.0)
        self._need("exponent", 1.0, 10.0)
        self._need("shadowing_sigma_db", 0.0, 30.0)


class BackgroundLoad(_Section, frozen=True, kw_only=True):
    """Share of time that foreign transmissions occupy a transport's channel at a receiver.

    A packet that overlaps one of them is lost. Foreign transmissions and the gaps between them have
    exponential lengths.
    """

    ble4: float = 0.0
    ble5: float = 0.0
    """Applies to primary and secondary channels."""
    wifi: float = 0.0
    burst_ms: float = 2.0
    """Mean length of a foreign transmission."""

    def __post_init__(self) -> None:
        for key in MODES:
            self._need(key, 0.0, 0.999)
        self._need("burst_ms", 0.0, _DAY_MS, above=True)


class ChannelParameters(_Section, frozen=True, kw_only=True):
    """All parameters that the two channel models share."""

    slot_ms: float = 0.125
    """Delta: length of a slot."""
    gnss_period_ms: float = 1000.0
    """T_GNSS: time between GNSS samples."""
    phases: Literal["redrawn", "same"] = "redrawn"
    """Scan phases of the GNSS periods after the first one, in the equations with the schedule "coprime".
    "redrawn": random. "same": that of the first one, which is the paper's sum to the letter. A phase at which
    nothing can be received then counts as a delay of 0, the value of an empty sum.
    """
    wifi_channels: Literal["shared", "random"] = "shared"
    """"shared": beacons of all aircraft use one channel, which fits the published delays. "random": each
    aircraft's channel is drawn from 1, 6, 11, as the paper's table states.
    """
    bluetooth_half_duplex: bool = False
    """Whether the equations assume that a Bluetooth radio does not receive while it sends (see
    `half_duplex`). In the paper it does receive. This affects only `Analytic`, like `wifi.access`.
    """
    ble4: BleParameters = BleParameters()
    ble5: Ble5Parameters = Ble5Parameters()
    wifi: WifiParameters = WifiParameters()
    propagation: PropagationParameters = PropagationParameters()
    background: BackgroundLoad = BackgroundLoad()

    def __post_init__(self) -> None:
        self._need("slot_ms", 0.0, _DAY_MS, above=True)
        self._need("gnss_period_ms", 0.0, _DAY_MS, above=True)
        shortest = {
            "ble4.packet_ms": self.ble4.packet_ms,
            "ble5.packet_ms": self.ble5.packet_ms,
            "wifi.beacon_ms": self.wifi.beacon_ms,
        }
        for key, value in shortest.items():
            if value < self.slot_ms:
                raise ValueError(f"{key}: {value:g} is less than one slot (slot_ms is {self.slot_ms:g})")
        cycles = {
            "ble4.scan_interval_ms": self.ble4.scan_interval_ms,
            "ble5.scan_interval_ms": self.ble5.scan_interval_ms,
            "wifi.scan_ms and switch_ms": self.wifi.scan_ms + self.wifi.switch_ms,
        }
        longest_ms = _MAX_CYCLE_SLOTS * self.slot_ms / 3.0
        for key, value in cycles.items():
            if value > longest_ms:
                raise ValueError(
                    f"{key}: {value:g} is too long; allowed: up to {longest_ms:g}, so that three times it is "
                    f"at most {_MAX_CYCLE_SLOTS:,} slots (slot_ms is {self.slot_ms:g})"
                )
        self._need_room()

    def _need_room(self) -> None:
        """An event must end before the next one begins, and a collision factor 1 - x must stay above 0."""
        ble4, ble5, wifi = self.ble4, self.ble5, self.wifi
        both = ble4.packet_ms + ble5.packet_ms
        secondary = OVERLAPPED_CHANNELS / SECONDARY_CHANNELS * (ble5.auxiliary_ms + wifi.beacon_ms)
        event4 = 3.0 * ble4.packet_ms + 2.0 * ble4.gap_ms
        event5 = ble5.auxiliary_offset_ms + ble5.auxiliary_uncertainty_ms + ble5.auxiliary_ms
        for mode, rate, longest in (
            ("ble4", ble4.max_rate, max(event4, both)),
            ("ble5", ble5.max_rate, max(event5, both, secondary)),
            ("wifi", wifi.max_rate, max(2.0 * wifi.beacon_ms, secondary)),
        ):
            if rate * longest >= self.gnss_period_ms:
                raise ValueError(
                    f"{mode}.max_rate: {rate} is too high; allowed: less than "
                    f"{self.gnss_period_ms / longest:.4g}, because "
                    f"each event occupies up to {longest:g} ms of gnss_period_ms"
                )


@dataclass(frozen=True)
class Slots:
    """Durations in whole slots, X_d = floor(X / Delta)."""

    parameters: ChannelParameters

    def of(self, duration_ms: float) -> int:
        """Number of whole slots in a duration."""
        # The small offset keeps rounding from making 0.3 / 0.1 less than 3.
        return math.floor(duration_ms / self.parameters.slot_ms + 1e-9)

    @cached_property
    def gnss_period(self) -> int:
        """T_GNSS in slots."""
        return self.of(self.parameters.gnss_period_ms)

    def seconds(self, slots: float) -> float:
        """Length of a number of slots (s)."""
        return slots * self.parameters.slot_ms / 1000.0


def load(path: Path) -> ChannelParameters:
    """Read a parameter file.

    Raises:
        ConfigError: the message names the file, the key, its value and the allowed values.
    """
    return decode_toml(path, ChannelParameters)


def max_rates(parameters: ChannelParameters) -> tuple[int, int, int]:
    """Largest psi of each mode, in the order of `MODES`."""
    return parameters.ble4.max_rate, parameters.ble5.max_rate, parameters.wifi.max_rate


def check_rate(mode: str, rate: int, parameters: ChannelParameters) -> None:
    """Refuse a message rate that the parameters do not allow.

    Raises:
        ConfigError: the rate is less than 1 or more than the mode's `max_rate`.
    """
    largest = max_rates(parameters)[MODES.index(mode)]
    if not 1 <= rate <= largest:
        raise ConfigError(f"{mode}: rate {rate} is out of range; allowed: 1 to {largest}")
