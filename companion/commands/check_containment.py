"""Findings of `companion check` about the mission to be guarded, the containment and plug-ins."""

from __future__ import annotations

import math

from companion.authority.influence.containment import crewed_reach_m, extent
from companion.autopilot.advice import too_fast
from companion.autopilot.lists.mission import place_of
from companion.commands.preflight import Preflight
from companion.config import Config
from companion.errors import ConfigError
from companion.events import MissionDownloaded, MissionRefused, VehicleParameters
from companion.geometry import LocalFrame
from companion.laws import kind_of
from companion.runtime.plugins import judge_plugins


def judge_law(config: Config, found: Preflight) -> None:
    """Report whether the law of a plug-in works, if one is to fly."""
    try:
        lines = judge_plugins(config)
    except ConfigError as error:
        found.red("plug-in", str(error), "correct the plug-in, or name another one")
        return
    for line in lines:
        found.green("plug-in", line.removeprefix("plug-in: "))


def judge_containment(config: Config, found: Preflight) -> None:
    """Report how far and how long traffic without a signature can move the aircraft."""
    own = config.containment
    if config.flight.use == "watch" or not kind_of(config.avoidance.law).avoids:
        return
    side_m, above_m = crewed_reach_m(config)
    around = f"{own.side_m:g} m to the side, {own.below_m:g} m below and {own.above_m:g} m above the leg"
    found.green("containment", f"unproven traffic: {around}; {own.total_s:g} s, then {own.then}")
    around = f"{side_m:g} m to the side, {above_m:g} m above the leg, down to the floor"
    found.green("containment", f"crewed traffic: {around}; {own.crewed_total_s:g} s, then {own.crewed_then}")
    if config.limits.ceiling_height_m is None:
        most_m = max(own.above_m, above_m)
        text = f"limits.ceiling_height_m is not set: traffic can move the vehicle {most_m:g} m above its leg"
        found.yellow("containment", text, "set it to the greatest height that is allowed there")
    if not kind_of(config.avoidance.law).keeps_fence:
        text = f'avoidance.law = "{config.avoidance.law}" keeps only the heights of this volume'
        found.yellow("containment", text, 'set avoidance.law = "dmuca"')
    if side_m < config.avoidance.crewed_horizontal_m:
        text = f"crewed_side_m {side_m:g} m is less than the separation avoidance.crewed_horizontal_m"
        found.yellow("containment", text, "raise containment.crewed_side_m")
    if config.path is not None:
        places = [(w.lat_deg, w.lon_deg, w.alt_m) for w in config.path.waypoint]
        _volume(config, places, f"above {config.path.altitude}", found)


def _volume(config: Config, places: list[tuple[float, float, float]], datum: str, found: Preflight) -> None:
    """Report the volume around places: latitude, longitude (deg), altitude (m)."""
    frame = LocalFrame(places[0][0], places[0][1], 0.0)
    (south, north), (west, east) = extent([frame.to_ned(lat, lon, 0.0) for lat, lon, _ in places], config)
    heights = [alt for _, _, alt in places]
    low_m, high_m = min(heights) - config.containment.below_m, max(heights) + config.containment.above_m
    text = (
        f"the volume is {north - south:.0f} m from south to north, {east - west:.0f} m from west to east; "
        f"{low_m:.0f} to {high_m:.0f} m {datum}, within floor and ceiling"
    )
    found.green("containment", text)


def judge_mission(
    config: Config,
    told: VehicleParameters,
    mission: MissionDownloaded | MissionRefused | None,
    found: Preflight,
    home_alt_msl_m: float | None = None,
) -> None:
    """Check that the mission to be guarded can be read, and is not flown faster than our speed limit.

    Args:
        home_alt_msl_m: None: not known.
    """
    items = mission.items if isinstance(mission, MissionDownloaded) else ()
    if items:
        found.green("mission", f"{len(items)} items, read from the vehicle")
    elif isinstance(mission, MissionDownloaded):
        found.yellow("mission", "the vehicle has none", "upload the mission to be guarded, then check again")
    else:
        why = "the vehicle did not finish sending it" if mission is None else mission.reason
        found.yellow(
            "mission", f"not read: {why}", "check the link: a mission that cannot be read is not guarded"
        )
    fast = too_fast(config.limits, told, items)
    if fast is not None:
        do = "lower the mission's speed, or raise limits.max_speed_mps (and the vehicle's own limit)"
        found.yellow("mission", fast, do)
    home_m = math.nan if home_alt_msl_m is None else home_alt_msl_m
    places = [place_of(item, math.nan, home_m) for item in items]
    known = [place for place in places if place is not None and not math.isnan(place[2])]
    if known:
        _volume(config, known, "above home", found)
