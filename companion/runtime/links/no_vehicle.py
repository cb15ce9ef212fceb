"""Explains why no vehicle was found, from what was received instead."""

from __future__ import annotations

from companion.autopilot.link import AutopilotLink
from companion.config import VehicleConfig
from companion.runtime.links.kept_link import KeptLink


def no_vehicle(
    config: VehicleConfig, link: KeptLink, protocol: AutopilotLink, now_s: float
) -> tuple[str, str, str]:
    """Explain why no vehicle was found within `wait_s`. Returns subject, finding and what to do about it."""
    text = f"{config.link}: no vehicle within {config.wait_s:g} s"
    disbelief = protocol.disbelief(now_s)
    if disbelief is not None:
        return "signing", f"{text}: {disbelief}", "docs/flying.md says how a key is set"
    serial, others = config.link.startswith("serial:"), link.trouble.left_out
    sender = "the wires (TX to RX)" if serial else "who sends to this address"
    if not link.received_bytes and not others:
        return "vehicle", f"{text}, not a byte", f"see to the autopilot's power, and to {sender}"
    if not link.received_bytes:
        return "vehicle", f"{text}; {others} datagrams came, and no MAVLink in them", f"see to {sender}"
    wire = protocol.counts.wire
    # In noise an occasional frame has a correct checksum, but far more have a wrong one.
    if wire.messages > wire.corrupt:
        text += f"; MAVLink came ({wire.messages} frames), but no autopilot's HEARTBEAT"
        do = "see to what else speaks on this link"
        if config.system_id:
            text += f" of system {config.system_id}"
            do = "set vehicle.system_id to the autopilot's own number, or " + do
        if others:
            text += f"; {others} datagrams of another sender were left out"
            do += "; have one sender for this port"
        return "vehicle", text, do
    do = "see to what sends to this address"
    if serial:
        do = "see to the baud rate on both sides, to MAVLink on the autopilot's port, and to ground and wires"
    return "vehicle", f"{text}; {link.received_bytes} bytes came, and no MAVLink in them", do
