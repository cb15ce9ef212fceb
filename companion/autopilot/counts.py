"""Counters of a MAVLink link, for status lines and reports."""

from __future__ import annotations

from dataclasses import dataclass

from companion.autopilot.remote_id import RemoteIdCounts
from companion.autopilot.wire import WireCounts


@dataclass(slots=True, kw_only=True)
class LinkCounts(RemoteIdCounts):
    """What the link has received and done so far."""

    wire: WireCounts
    """Framing counters: messages, unknown, corrupt, skipped bytes."""
    taken: int = 0
    """Messages of our vehicle that were decoded."""
    unneeded: int = 0
    """Messages of our vehicle that are not needed: their checksum was verified, but they were not decoded."""
    foreign: int = 0
    """Messages of other systems and components, and answers addressed to them."""
    bad_values: int = 0
    """Messages with values that no correct vehicle sends."""
    no_position: int = 0
    """GLOBAL_POSITION_INT before the vehicle knew its position, and ADSB_VEHICLE without a position."""
    reboots: int = 0
    drops: int = 0
    """Gaps between heartbeats of more than `heard_vehicle.LOST_AFTER_S`."""
    stream_requests: int = 0
    parameter_requests: int = 0
    settings_requests: int = 0
    """Requests of ground stations for our own parameters."""
    settings_refused: int = 0
    """PARAM_SET requests with a value that is not allowed."""
    information_requests: int = 0
    """Requests of ground stations for messages and files about the companion."""
    information_refused: int = 0
    """Requests for information that were damaged or asked for something that does not exist."""
    mode_requests: int = 0
    setpoints: int = 0
    setpoints_dropped: int = 0
    """Setpoints that were not sent. There was no vehicle, it cannot be commanded, or the setpoint was
    replaced or too old before it was drained."""
    overflows: int = 0
    """How often the undrained send queue was discarded."""
    clock_reads: int = 0
    """Answers to our TIMESYNC that gave a reading of the vehicle's clock."""
    clock_answers: int = 0
    """Our answers to the vehicle's TIMESYNC."""
    sensed: int = 0
    """Attitudes and measurements of sensors aboard that were read."""
    sensed_dropped: int = 0
    """Attitudes and measurements that were not read, because too many came in one second."""
