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
        return "signing", f"{text}: {disbelief}", "docs/flying.md explains how to set a key"
    serial, others = config.link.startswith("serial:"), link.trouble.left_out
    sender = "the wires (TX to RX)" if serial else "what sends to this address"
    if not link.received_bytes and not others:
        return "vehicle", f"{text}; no data was received", f"check the autopilot's power and {sender}"
    if not link.received_bytes:
        return "vehicle", f"{text}; {others} datagrams were received, but no MAVLink", f"check {sender}"
    wire = protocol.counts.wire
    # In noise an occasional frame has a correct checksum, but far more have a wrong one.
    if wire.messages > wire.corrupt:
        text += f"; {wire.messages} MAVLink frames were received, but no autopilot HEARTBEAT"
        do = "check what else sends on this link"
        if config.system_id:
            text += f" from system {config.system_id}"
            do = "set vehicle.system_id to the autopilot's system id, or " + do
        if others:
            text += f"; {others} datagrams of another sender were ignored"
            do += "; let only one program send to this port"
        return "vehicle", text, do
    do = "check what sends to this address"
    if serial:
        do = "check both baud rates, that the autopilot's port is set to MAVLink, and the wires and ground"
    return "vehicle", f"{text}; {link.received_bytes} bytes were received, but no MAVLink", do
