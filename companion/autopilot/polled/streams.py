"""Requests the telemetry that the companion needs until it comes.

A fresh ArduPilot link carries only heartbeats, and rates are forgotten at a reboot; PX4 streams without a
request. So each message is requested once, its rate is monitored, and it is requested again when the rate
falls short. The requests become rarer each time, so that a vehicle that refuses is not flooded.

ADSB_VEHICLE comes only while there is traffic, so its absence means nothing. It is requested three times, in
case requests are lost, and no more once it comes. ArduPilot sends one aircraft per interval and begins its
list (25 long by default, ADSB_LIST_MAX) anew once a second; Copter sends it only on request (MAVn_ADSB is 0).
PX4 sends each report as it comes, without a request.

PX4 refuses to send HEARTBEAT at another rate than once a second. It sends CURRENT_MODE (since 1.15) twice a
second at most, and as soon as the mode changes, but never closer to the last one than the requested interval.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.wire import CURRENT_MODE
from companion.events import Firmware

STREAM_RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_RC_CHANNELS: 5.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE: 25.0,
    CURRENT_MODE: 20.0,
}
"""Requested rates. HEARTBEAT and STATUSTEXT come without a request."""

SENSED_RATES_HZ: dict[int, float] = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 20.0,
    mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: 10.0,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: 10.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
}
"""Additional rates that are requested if a sensor of obstacles is read (`companion.autopilot.sensors`)."""

FIRMWARE_OF = {
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: Firmware.ARDUPILOT,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: Firmware.PX4,
    mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: Firmware.PX4,
    mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR: Firmware.ARDUPILOT,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Firmware.ARDUPILOT,
    CURRENT_MODE: Firmware.PX4,
}
"""Messages that only one firmware sends, or that are needed from one only. A firmware answers each request
for a message that it does not know with a text."""

COMES_HZ = {CURRENT_MODE: 2.0}
"""Rate at which a message comes while nothing changes, if that is not the requested rate."""

SPORADIC = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_OBSTACLE_DISTANCE,
        mavlink.MAVLINK_MSG_ID_DISTANCE_SENSOR,
    }
)
"""Messages that come only when there is something to report. Their rate is an upper bound."""
SPORADIC_REQUESTS = 3

ENOUGH = 0.5
"""Share of the rate below which a stream is requested again."""
FIRST_CHECK_S = 2.0
LONGEST_CHECK_S = 30.0


@dataclass(slots=True)
class _Stream:
    rate_hz: float
    comes_hz: float
    sporadic: bool
    received: int = 0
    since_s: float = 0.0
    check_s: float = 0.0
    wait_s: float = FIRST_CHECK_S
    requests: int = 0


class Streams:
    """Counts arriving messages and decides what to request.

    Args:
        sensed: whether to also request `SENSED_RATES_HZ`, for the measurements of sensors aboard.
    """

    def __init__(self, *, sensed: bool = False) -> None:
        rates = STREAM_RATES_HZ | SENSED_RATES_HZ if sensed else STREAM_RATES_HZ
        self._streams = {
            message_id: _Stream(rate, COMES_HZ.get(message_id, rate), message_id in SPORADIC)
            for message_id, rate in rates.items()
        }
        self._firmware: Firmware | None = None

    def restart(self, now_s: float, firmware: Firmware) -> None:
        """The vehicle is new or has forgotten its rates: request everything that it can send at once."""
        self._firmware = firmware
        for stream in self._streams.values():
            stream.received, stream.since_s, stream.check_s = 0, now_s, now_s
            stream.wait_s, stream.requests = FIRST_CHECK_S, 0

    def received(self, message_id: int) -> None:
        """Count one message of those that are requested; others are ignored."""
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.received += 1

    def due(self, now_s: float) -> list[tuple[int, int]]:
        """Message ids to request now, each with its interval (microseconds)."""
        return [
            (message_id, round(1e6 / stream.rate_hz))
            for message_id, stream in self._streams.items()
            if now_s >= stream.check_s
            and FIRMWARE_OF.get(message_id, self._firmware) is self._firmware
            and self._short(stream, now_s)
        ]

    @staticmethod
    def _short(stream: _Stream, now_s: float) -> bool:
        """Evaluate the stream's window and begin a new one. Returns True when the stream must be requested
        (again)."""
        asked = stream.requests > 0
        if stream.sporadic:
            if stream.received:
                stream.requests = SPORADIC_REQUESTS
            short = stream.requests < SPORADIC_REQUESTS
        else:
            short = not asked or stream.received < stream.comes_hz * (now_s - stream.since_s) * ENOUGH
        if not short:
            stream.wait_s = FIRST_CHECK_S
        elif asked:
            stream.wait_s = min(stream.wait_s * 2, LONGEST_CHECK_S)
        stream.requests += short
        stream.received, stream.since_s, stream.check_s = 0, now_s, now_s + stream.wait_s
        return short
