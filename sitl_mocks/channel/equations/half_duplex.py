"""Losses of a Bluetooth radio that does not receive while it sends, for the equations.

In the paper a receiver also receives while it sends. With `ChannelParameters.bluetooth_half_duplex` a packet
is lost when it overlaps one that its receiver sends on BLE 4 or BLE 5, which share a radio. The receiver's
own events fall at random times relative to those of others. With rate psi and a share s of the GNSS period in
which one own event would cover a packet, the packet survives with probability 1 - s psi. A pointer and its
auxiliary packet are covered together more often than two independent packets. The s of both is that of their
union, averaged over the three pointers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from companion.arrays import Floats
from sitl_mocks.channel.parameters import BleParameters, ChannelParameters

Pair = tuple[float, float]
_Spans = Sequence[tuple[float, float]]
_LEAST = 1e-12


@dataclass(frozen=True, slots=True)
class DeafShares:
    """Share of the GNSS period in which one event of the receiver covers a packet. Each pair holds the shares
    for own events on BLE 4 and on BLE 5.
    """

    ble4: Pair
    """Share for the PDU of BLE 4."""
    pointer: Pair
    both: Pair
    """Share for a pointer, its auxiliary packet, or both."""


@lru_cache(maxsize=64)
def deaf_shares_of(parameters: ChannelParameters) -> DeafShares:
    """Compute the shares from the durations."""
    ble4, ble5 = _advertisements(parameters.ble4), _advertisements(parameters.ble5)
    begin = parameters.ble5.auxiliary_offset_ms
    auxiliary = (begin, begin + parameters.ble5.auxiliary_ms)
    own = (ble4, [*ble5, auxiliary])

    def share(*victims: _Spans) -> Pair:
        means = [sum(_covered_ms(v, spans) for v in victims) / len(victims) for spans in own]
        return means[0] / parameters.gnss_period_ms, means[1] / parameters.gnss_period_ms

    return DeafShares(
        ble4=share(ble4[:1]),
        pointer=share(ble5[:1]),
        both=share(*([pointer, auxiliary] for pointer in ble5)),
    )


def log_hearing(parameters: ChannelParameters, rates: NDArray[np.integer]) -> tuple[Floats, Floats, Floats]:
    """Log probability that packets do not overlap the receiver's own packets.

    The three arrays are for BLE 4's PDU, a pointer, and the auxiliary packet of a received pointer, each of
    shape (receivers,).

    Args:
        rates: shape (receivers, 3), messages in a GNSS period, in the order of `MODES`.
    """
    s = deaf_shares_of(parameters)

    def log_product(share: Pair) -> Floats:
        return np.asarray(np.log(np.maximum(1.0 - rates[:, :2] * np.array(share), _LEAST)).sum(1), float)

    pointer = log_product(s.pointer)
    return log_product(s.ble4), pointer, np.minimum(log_product(s.both) - pointer, 0.0)


def _advertisements(ble: BleParameters) -> list[tuple[float, float]]:
    """Begin and end of the three packets on the primary channels (ms), from the beginning of the event."""
    step = ble.packet_ms + ble.gap_ms
    return [(k * step, k * step + ble.packet_ms) for k in range(3)]


def _covered_ms(victims: _Spans, own: _Spans) -> float:
    """Total length of the offsets at which any of the own packets overlaps any of the victims (ms)."""
    offsets = sorted((v[0] - o[1], v[1] - o[0]) for v in victims for o in own)
    total, reached = 0.0, -np.inf
    for low, high in offsets:
        total += max(0.0, high - max(low, reached))
        reached = max(reached, high)
    return float(total)
