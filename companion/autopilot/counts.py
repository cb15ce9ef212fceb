"""What a MAVLink link counts, for status lines and reports."""

from __future__ import annotations

from dataclasses import dataclass

from companion.autopilot.remote_id import RemoteIdCounts
from companion.autopilot.wire import WireCounts


@dataclass(slots=True, kw_only=True)
class LinkCounts(RemoteIdCounts):
    """What the link has met and done so far."""

    wire: WireCounts
    """Framing: messages, unknown, corrupt, skipped bytes."""
    taken: int = 0
    """Messages of our vehicle that were decoded."""
    unneeded: int = 0
    """Messages of our vehicle that nothing here needs: checked, not decoded."""
    foreign: int = 0
    """Messages of other systems and components, or answers meant for them."""
    bad_values: int = 0
    """Messages with values that no honest vehicle sends."""
    no_position: int = 0
    """GLOBAL_POSITION_INT before the vehicle knew where it is, ADSB_VEHICLE without a position."""
    acks_accepted: int = 0
    acks_refused: int = 0
    reboots: int = 0
    drops: int = 0
    """Gaps between heartbeats of more than `heard_vehicle.LOST_AFTER_S`."""
    stream_requests: int = 0
    parameter_requests: int = 0
    settings_requests: int = 0
    """Requests of ground stations for parameters of our own."""
    settings_refused: int = 0
    """PARAM_SET with a value that is not allowed."""
    information_requests: int = 0
    """Requests of ground stations for messages and files about us."""
    information_refused: int = 0
    """Of them, damaged ones, and those for what there is not."""
    mode_requests: int = 0
    setpoints: int = 0
    setpoints_dropped: int = 0
    """Setpoints not sent: no vehicle, one that cannot be commanded, or replaced before they were drained."""
    overflows: int = 0
    """Times the undrained queue was thrown away."""
    clock_reads: int = 0
    """Answers to our TIMESYNC that tell something."""
    clock_answers: int = 0
    """Answers of ours to the vehicle's TIMESYNC."""
