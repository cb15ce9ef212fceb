"""The radio medium of an attacked flight: real frames, their signal strengths, and their times of reception.

The received power follows the channel model's log-distance law. The shadowing has a part that belongs to the
link and a part that belongs to the frame. A frame below the transport's sensitivity is not heard. Frames of
honest aircraft are also lost and delayed at random, as in the other campaigns. Frames of an attacker are not,
which favours the attack.
"""

from __future__ import annotations

import heapq
import math
import zlib
from functools import lru_cache
from typing import Final

import msgspec
import numpy as np

from companion.events import RemoteIdHeard
from companion.geometry import Vec3
from companion.radio.frames_io import FrameReceiver
from companion.remote_id.transports import BLE4, BLE5, WIFI_BEACON, WIFI_NAN
from sitl_mocks.channel.parameters import ChannelParameters

PARAMETERS: Final = ChannelParameters()
POWER_DBM: Final = PARAMETERS.wifi.transmit_power_dbm
SENDERS_SIGMA_DB: Final = 4.0
"""Standard deviation of an honest sender's unknown transmit power."""
LINK_SIGMA_DB, FRAME_SIGMA_DB = 4.0, 4.5
"""Standard deviations of the shadowing of a link and of a frame; together 6 dB."""
DELAY_S: Final = (0.0, 1.0)
LOSS: Final = 0.1
_SENSITIVITY_DBM: Final = {
    BLE4: PARAMETERS.ble4.sensitivity_dbm,
    BLE5: PARAMETERS.ble5.sensitivity_dbm,
    WIFI_BEACON: PARAMETERS.wifi.sensitivity_dbm,
    WIFI_NAN: PARAMETERS.wifi.sensitivity_dbm,
}
_LOSS_AT_1M_DB: Final = PARAMETERS.propagation.loss_at_1m_db
_TEN_EXPONENT: Final = 10.0 * PARAMETERS.propagation.exponent


def path_loss_db(distance_m: float) -> float:
    """Path loss of the channel model without shadowing."""
    return _LOSS_AT_1M_DB + _TEN_EXPONENT * math.log10(max(distance_m, 0.1))


class _Link:
    """Shadowing, loss and delay from one sender to one receiver, drawn independently of all other links."""

    def __init__(self, seed: int, sender: str, receiver: str) -> None:
        self.rng = np.random.default_rng([seed, zlib.crc32(sender.encode()), zlib.crc32(receiver.encode())])
        self.shadow_db = float(self.rng.normal(0.0, LINK_SIGMA_DB))


class Air:
    """Carries frames to receivers.

    Args:
        signal: whether receivers report the signal strength.
    """

    def __init__(self, seed: int, *, signal: bool) -> None:
        self._seed = seed
        self._signal = signal
        self._links: dict[tuple[str, str], _Link] = {}
        self._queues: dict[str, list[tuple[float, int, RemoteIdHeard]]] = {}
        self._number = 0
        self._read = lru_cache(64)(FrameReceiver().receive)

    def join(self, receiver: str) -> None:
        """Let a receiver hear what is sent from now on."""
        self._queues[receiver] = []

    def send(
        self,
        now_s: float,
        sender: str,
        place: Vec3,
        receivers: dict[str, Vec3],
        transport: str,
        address: str,
        frame: bytes,
        power_dbm: float,
        *,
        honest: bool,
    ) -> None:
        """Send one frame to all receivers but the sender.

        Args:
            place, receivers: NED positions (m).
        """
        for receiver, there in receivers.items():
            if receiver == sender:
                continue
            link = self._links.get((sender, receiver))
            if link is None:
                link = self._links[sender, receiver] = _Link(self._seed, sender, receiver)
            shadow = link.shadow_db + FRAME_SIGMA_DB * float(link.rng.standard_normal())
            arrival_s = now_s
            if honest:
                lost, late = link.rng.random(2).tolist()
                arrival_s += DELAY_S[0] + (DELAY_S[1] - DELAY_S[0]) * late
                if lost < LOSS:
                    continue
            received_dbm = power_dbm - path_loss_db(math.dist(place, there)) - shadow
            if received_dbm < _SENSITIVITY_DBM[transport]:
                continue
            heard = self._read(transport, address, frame)
            if heard is None:
                continue
            if self._signal:
                heard = msgspec.structs.replace(heard, rssi_dbm=float(round(received_dbm)))
            self._number += 1
            heapq.heappush(self._queues[receiver], (arrival_s, self._number, heard))

    def heard(self, receiver: str, now_s: float) -> list[RemoteIdHeard]:
        """Frames that have arrived at a receiver since the last call, in the order of arrival."""
        queue, found = self._queues[receiver], []
        while queue and queue[0][0] <= now_s:
            found.append(heapq.heappop(queue)[2])
        return found
