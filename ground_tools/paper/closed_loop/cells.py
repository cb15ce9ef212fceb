"""Stored results of the closed loop: a file for each condition and method, with a line for each encounter.

With this layout a method can be added later, and an interrupted run can be continued.
"""

from __future__ import annotations

import hashlib
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import msgspec

from companion.atmc.plugin_policy import plugin_policy
from ground_tools.common import sources
from ground_tools.common.kept_lines import Kept
from ground_tools.common.plugin_state import state_of
from ground_tools.paper.closed_loop.flights import FILE, METHODS, Flight, Row, region_of
from sitl_mocks.channel.parameters import ChannelParameters


def cell(folder: Path, flight: Flight, crowd: int) -> Kept[Row]:
    """The stored results of one condition and method, its rows by encounter.

    Args:
        folder: an existing folder.
        flight: any flight of the cell. All flights of a cell must be the same except for their seeds.
        crowd: number of encounters side by side that share one radio environment.

    Raises:
        ConfigError: the file was made with other settings, or cannot be read.
    """
    path = folder / f"{flight.condition}-{flight.method}.jsonl"
    return Kept(path, _made_with(flight, crowd), Row, attrgetter("encounter"), _software())


@cache
def _software() -> str:
    """Digest of the code that flies."""
    return sources.digest(["ground_tools.paper.closed_loop.flights"])


def _made_with(flight: Flight, crowd: int) -> dict[str, Any]:
    """The settings, apart from the software, on which the results of a cell depend."""
    method = METHODS[flight.method]
    return {
        "condition": flight.condition,
        "method": flight.method,
        "region": region_of(flight).name,
        "channel": _digest(msgspec.json.encode(_of_packets(flight.channel))),
        "crowd": crowd,
        "policy": _policy(flight) if method.policy == FILE else None,
    }


def _of_packets(channel: ChannelParameters) -> dict[str, Any]:
    """The parameters without those that only the equations use."""
    content: dict[str, Any] = msgspec.to_builtins(channel)
    del content["phases"], content["ble5"]["pointers"]
    return content


def _policy(flight: Flight) -> str | None:
    """The state of the policy that a flight uses: of its file, or of its plug-in."""
    plugged = plugin_policy(flight.plugin)
    if plugged is not None:
        return state_of(plugged.plugin)
    return None if flight.policy is None else _digest(flight.policy)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
