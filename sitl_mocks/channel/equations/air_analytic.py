"""The channel equations applied frame by frame: which receivers get each frame that is really sent, and when.

A frame is one event of the paper (an advertising event or a beacon). Its time relative to the receiver's scan
determines which of its packets fall into a scan window (section "Packet Reception Model"). The collision
products (section "Packet Collision Model"), with the rates at which the other aircraft really send, give the
probability of each. The delay of a frame is the time from its sending to the end of the packet that delivered
it. There is no sum over repetitions as in "Average Transmission Delay Model", because repetitions are
separate frames here.

As in those equations, packets collide independently, and the scan phase of each pair and mode is redrawn for
every GNSS period. Senders keep their real times: intervals are not made coprime to the scan cycle.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.remote_id.transports import BLE5, WIFI_BEACON
from sitl_mocks.channel.air import Decisions, Outcome, Transmission
from sitl_mocks.channel.air_links import AirLinks, mode_of
from sitl_mocks.channel.equations.collision import background_survival, shares_of
from sitl_mocks.channel.equations.reception import heard_packets, scan_of
from sitl_mocks.channel.parameters import MODES, WIFI_CHANNELS, ChannelParameters, Slots

_BLE5, _WIFI = MODES.index(BLE5), MODES.index(WIFI_BEACON)
_DRAWS = 3
"""Numbers drawn for each frame and receiver, used or not, so that draws do not depend on other outcomes."""
_EPSILON_S = 1e-6


@dataclass(slots=True)
class _Active:
    """Frames that one aircraft sent in one mode in the last GNSS period."""

    sent_s: deque[float] = field(default_factory=deque)
    path_loss_db: dict[str, float] = field(default_factory=dict)
    """Path loss of its last frame (dB), by receiver."""
    wifi_channel: int = 0


@dataclass(frozen=True, slots=True)
class _Interferer:
    sender: str
    mode: int
    rate: int
    path_loss_db: dict[str, float]
    wifi_channel: int


class AnalyticChannel:
    """A `Channel` that decides at once, by the equations.

    An interferer is counted with the frames that it sent in the preceding GNSS period, [t - T_GNSS, t), and
    only if it reaches the receiver.

    Args:
        parameters: parameters of the channel.
    """

    def __init__(self, parameters: ChannelParameters) -> None:
        slots = Slots(parameters)
        self._slots = slots
        self._period_s = slots.seconds(slots.gnss_period)
        self._links = AirLinks(parameters)
        self._decisions = Decisions()
        s = shares_of(parameters)
        # Shares of the GNSS period, by victim and interferer in the order of `MODES`.
        self._shares = [
            [s.ble4_by_ble4, s.ble4_by_ble5, 0.0],
            [s.pointer_by_ble4, s.pointer_by_ble5, 0.0],
            [0.0, s.wifi_by_ble5, s.wifi_by_wifi],
        ]
        self._auxiliary_shares = [[0.0] * 3, [0.0, s.auxiliary_by_ble5, s.auxiliary_by_wifi], [0.0] * 3]
        self._cycles = [scan_of(mode, parameters).cycle for mode in MODES]
        # By mode, Wi-Fi channel and phase: the packets of an event that fall into a window.
        self._heard = [
            [
                [heard_packets(mode, phase, parameters, wifi_channel=channel) for phase in range(cycle)]
                for channel in range(len(WIFI_CHANNELS))
            ]
            for mode, cycle in zip(MODES, self._cycles, strict=True)
        ]
        self._delays_s = [_delays_s(mode, parameters) for mode in range(len(MODES))]
        load = parameters.background
        quiet = background_survival(parameters, np.array([[load.ble4, load.ble5, load.wifi]]))
        self._first_quiet = [float(quiet.ble4[0]), float(quiet.pointer[0]), float(quiet.wifi[0])]
        self._auxiliary_quiet = float(quiet.auxiliary[0])
        self._phases: dict[tuple[str, str, int], int] = {}
        self._cycle = 0
        self._active: dict[tuple[str, int], _Active] = {}
        self._interferers: list[_Interferer] = []
        self._interferers_s = -math.inf

    def transmit(self, transmission: Transmission, rng: np.random.Generator) -> None:
        """See `Channel.transmit`."""
        now_s, sender = transmission.sent_s, transmission.sender
        mode = mode_of(transmission.transport)
        channel = self._links.wifi_channel(sender, transmission.transport, rng)
        loss_db = self._links.path_loss_db(sender, transmission.distance_m, rng)
        luck = rng.random((len(loss_db), _DRAWS)).tolist()
        self._measure_rates(now_s)
        for (receiver, loss), draws in zip(loss_db.items(), luck, strict=True):
            phase = self._phase(now_s, sender, receiver, mode, rng)
            delay_s = None
            if loss <= self._links.thresholds_db[mode]:
                heard = self._heard[mode][channel][phase]
                if heard:
                    first, auxiliary = self._survival(sender, receiver, mode, channel)
                    delay_s = self._received_s(mode, heard, first, auxiliary, draws)
            self._decisions.add(transmission, receiver, None if delay_s is None else now_s + delay_s)
        active = self._active.setdefault((sender, mode), _Active())
        active.sent_s.append(now_s)
        active.path_loss_db, active.wifi_channel = loss_db, channel

    def settle(self, now_s: float, rng: np.random.Generator) -> list[Outcome]:
        """See `Channel.settle`. Returns the outcomes of all frames sent, in the order of sending."""
        return self._decisions.pop_outcomes()

    def next_s(self) -> float | None:
        """See `Channel.next_s`."""
        return self._decisions.next_s()

    def _phase(self, now_s: float, sender: str, receiver: str, mode: int, rng: np.random.Generator) -> int:
        """Slot of the receiver's scan cycle in which an event sent now begins."""
        cycle = math.floor(now_s / self._period_s)
        if cycle != self._cycle:
            self._phases.clear()
            self._cycle = cycle
        pair = (sender, receiver, mode)
        if pair not in self._phases:
            self._phases[pair] = int(rng.integers(self._cycles[mode]))
        slot = self._slots.of((now_s - cycle * self._period_s) * 1000.0)
        return (self._phases[pair] + slot) % self._cycles[mode]

    def _measure_rates(self, now_s: float) -> None:
        """Count the frames that each aircraft sent in the period before now. All frames of one moment get the
        same result, in any order.
        """
        if now_s == self._interferers_s:
            return
        self._interferers_s = now_s
        self._interferers = []
        for (sender, mode), active in list(self._active.items()):
            while active.sent_s and active.sent_s[0] < now_s - self._period_s - _EPSILON_S:
                active.sent_s.popleft()
            if not active.sent_s:
                del self._active[sender, mode]
                continue
            self._interferers.append(
                _Interferer(sender, mode, len(active.sent_s), active.path_loss_db, active.wifi_channel)
            )

    def _survival(self, sender: str, receiver: str, mode: int, channel: int) -> tuple[float, float]:
        """Probability that one packet meets no other, and that of the auxiliary packet (eight products)."""
        first, auxiliary = self._first_quiet[mode], self._auxiliary_quiet if mode == _BLE5 else 1.0
        for other in self._interferers:
            loss = other.path_loss_db.get(receiver)
            if other.sender == sender or loss is None or loss > self._links.thresholds_db[other.mode]:
                continue
            if mode == other.mode == _WIFI and other.wifi_channel != channel:
                continue
            # 1 - x psi is a probability only while it is not negative. At very high rates it would be, so it
            # is limited to 0.
            first *= max(1.0 - self._shares[mode][other.mode] * other.rate, 0.0)
            auxiliary *= max(1.0 - self._auxiliary_shares[mode][other.mode] * other.rate, 0.0)
        return first, auxiliary

    def _received_s(
        self, mode: int, heard: Sequence[int], first: float, auxiliary: float, draws: Sequence[float]
    ) -> float | None:
        """Time from sending to the end of the packet that delivered the message. None if no packet did."""
        delays_s = self._delays_s[mode]
        if mode == _BLE5:
            pointers = 1.0 - (1.0 - first) ** len(heard)
            return delays_s[0] if draws[0] < pointers and draws[1] < auxiliary else None
        return next((delays_s[packet] for packet in heard if draws[packet] < first), None)


def _delays_s(mode: int, parameters: ChannelParameters) -> list[float]:
    """Time from the beginning of an event to the end of each packet that carries its message."""
    slots = Slots(parameters)
    if mode == _BLE5:
        ble5 = parameters.ble5
        parts_ms = (ble5.auxiliary_offset_ms, ble5.auxiliary_uncertainty_ms, ble5.auxiliary_ms)
        return [slots.seconds(sum(slots.of(part_ms) for part_ms in parts_ms))]
    scan = scan_of(MODES[mode], parameters)
    return [slots.seconds(offset + scan.duration) for offset in scan.packet_offsets]
