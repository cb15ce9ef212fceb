"""Why no vehicle was found: told from what came instead."""

from __future__ import annotations

from companion.autopilot.link import AutopilotLink
from companion.config import VehicleConfig
from companion.runtime.kept_link import KeptLink


def no_vehicle(
    config: VehicleConfig, link: KeptLink, protocol: AutopilotLink, now_s: float
) -> tuple[str, str, str]:
    """After `wait_s` without one: what it is about, what is the case, and what to do about it."""
    text = f"{config.link}: no vehicle within {config.wait_s:g} s"
    disbelief = protocol.disbelief(now_s)
    if disbelief is not None:
        return "signing", f"{text}: {disbelief}", "docs/flying.md says how a key is set"
    if not link.received_bytes:
        do = "see to the autopilot's power, to the wires (TX to RX), or to who sends to this address"
        return "vehicle", f"{text}, not a byte", do
    wire = protocol.counts.wire
    # Of noise, a frame now and then has a right checksum; far more have a wrong one.
    if wire.messages > wire.corrupt:
        return (
            "vehicle",
            f"{text}; MAVLink came ({wire.messages} frames), but no autopilot's HEARTBEAT",
            "see to vehicle.system_id, and to what else speaks on this link",
        )
    if config.link.startswith("serial:"):
        do = "see to the baud rate on both sides, to MAVLink on the autopilot's port, and to ground and wires"
    else:
        do = "see to what sends to this address"
    return "vehicle", f"{text}; {link.received_bytes} bytes came, and no MAVLink in them", do
