"""The least that the region's law requires of the broadcast: which transports go on the air, and how often.

A policy (or a configuration) asks for transports with a rate each. What goes on the air is that, plus what
the region's law requires beyond it, as far as the radios can send it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from companion.remote_id.region import Region

MARGIN = 0.8
"""Share of the longest legal period that is used. A message that is due only at the limit would be late once
delays add up."""


@dataclass(frozen=True, slots=True)
class Decided:
    """Decision on what goes on the air."""

    rates: dict[str, int]
    """Requested Locations a second, by transport. The periods of `longest_period_s` apply as well."""
    legal: bool
    reason: str
    """Why this differs from what was asked, or is not legal; empty otherwise."""


def keep_floor(asked: Mapping[str, int], region: Region, can_send: frozenset[str]) -> Decided:
    """Return the smallest legal set of transports that contains what was asked, as far as the radios can send
    it.

    If no legal set can be sent, the part of one that can be sent is used together with what was asked: being
    seen by some is better than by none. The decision is marked as not legal.
    """
    able = {transport: rate for transport, rate in asked.items() if transport in can_send}
    missing = sorted(asked.keys() - able.keys())
    reason = f"radio cannot send on {', '.join(missing)}" if missing else ""
    if not region.transport_sets:
        return Decided(able, True, reason)
    lowest = min(asked.values(), default=1)
    sets = [frozenset(names) for names in region.transport_sets]
    legal = [names for names in sets if names <= can_send]
    if legal:
        chosen = min(legal, key=lambda names: (len(names - able.keys()), -len(names & able.keys())))
        added = sorted(chosen - able.keys())
        if added:
            text = f"region {region.name} asks for {', '.join(added)}"
            reason = f"{reason}; {text}" if reason else text
        return Decided(able | dict.fromkeys(added, lowest), True, reason)
    partial = max(sets, key=lambda names: len(names & can_send)) & can_send
    wanted = " or ".join("+".join(names) for names in region.transport_sets)
    have = ", ".join(sorted(can_send)) or "nothing"
    rates = able | dict.fromkeys(sorted(partial - able.keys()), lowest)
    return Decided(rates, False, f"region {region.name} asks for {wanted}; the radio can send on {have}")


def longest_period_s(region: Region, transport: str, wifi_channel: int | None) -> float | None:
    """Longest legal time between two Locations on a transport; None if the region sets no limit."""
    elsewhere = region.beacon_period_elsewhere_s
    if transport == "wifi" and elsewhere is not None and wifi_channel not in (None, *region.beacon_channels):
        return elsewhere
    return region.location_period_s


def whole_rates(rates: Mapping[str, int], region: Region, wifi_channel: int | None) -> dict[str, int]:
    """Whole messages a second that keep the legal periods with their margin, for a radio that repeats by
    itself."""
    found = {}
    for transport, rate in rates.items():
        period_s = longest_period_s(region, transport, wifi_channel)
        found[transport] = rate if period_s is None else max(rate, math.ceil(1.0 / (MARGIN * period_s)))
    return found


def too_slow(
    rates: Mapping[str, int], region: Region, wifi_channel: int | None, loop_hz: float
) -> str | None:
    """Why a loop of this rate cannot keep the legal periods with their margin, in words; None when it can."""
    for transport in sorted(rates):
        period_s = longest_period_s(region, transport, wifi_channel)
        if period_s is not None and loop_hz * MARGIN * period_s < 1.0:
            where = f" on channel {wifi_channel}" if transport == "wifi" else ""
            return (
                f"region {region.name} asks for {transport}{where} every {period_s:g} s: "
                f"flight.setpoint_rate_hz {loop_hz:g} is too slow; at least {1.0 / (MARGIN * period_s):g}"
            )
    return None
