"""State of the core (`companion.core`), as `companion status` shows it.

This module only reads the core, so a replay, which runs without it, reaches the same state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from companion.avoidance.alerts import Level
from companion.avoidance.law import ASIDE, Neighbour
from companion.core import Companion
from companion.events import Decision
from companion.events.sensed import is_sensed
from companion.geometry import Vec3
from companion.runtime.status.status_socket import MOST_TRACKS, TrackStatus

_HOVERS_MPS = 0.3
"""Below this speed a direction of flight has no meaning: Remote ID's speeds have steps of 0.25 m/s."""


def core_status(core: Companion, now_s: float, decision: Decision | None) -> dict[str, Any]:
    """The fields of `status_socket.Status` that come from the core.

    Args:
        decision: latest decision of the avoidance law while the companion controls the vehicle, otherwise
            None.
    """
    own, config = core.own, core.config
    position = own.position
    utc_offset_s = own.utc_offset_s
    tracks = [] if own.frame is None or position is None else _tracks(core, now_s, decision)
    fix = own.gnss_now(now_s)
    return {
        "utc_s": None if utc_offset_s is None else now_s + utc_offset_s,
        "state": core.state.value,
        "waits_for": core.idle_because(now_s),
        "unfit": own.unfit(now_s, config.vehicle.stale_after_s),
        "mode": None if own.mode is None else own.mode.value,
        "armed": own.armed,
        "landed": own.landed(now_s).value,
        "heartbeat_age_s": None if own.heartbeat is None else now_s - own.heartbeat_s,
        "position_age_s": None if position is None else own.age_s(now_s),
        "lat_deg": None if position is None else position.lat_deg,
        "lon_deg": None if position is None else position.lon_deg,
        "alt_msl_m": None if position is None else position.alt_msl_m,
        "velocity_ned_mps": own.velocity_ned_mps,
        "gnss_fix_type": None if fix is None else fix.fix_type,
        "sigma_m": own.sigma_m,
        "remote_id_trouble": core.broadcaster.trouble or core.broadcaster.lacking,
        "wanted_ned_mps": None if decision is None else decision.wanted_ned_mps,
        "chosen_ned_mps": None if decision is None else decision.chosen_ned_mps,
        "limits": () if decision is None else decision.limits,
        "path_late_s": 0.0 if core.plan.course.law is None else core.plan.course.late_s,
        "track_count": len(tracks),
        "tracks": tuple(sorted(tracks, key=lambda t: t.distance_m)[:MOST_TRACKS]),
    }


def _tracks(core: Companion, now_s: float, decision: Decision | None) -> list[TrackStatus]:
    own = core.own.position_ned_m(now_s)
    conflicts = set() if decision is None else {(t.adsb, t.track_id) for t in decision.tracks if t.conflict}
    levels = core.alerts.levels
    names = {
        track_id: (track.latest.transport, tuple(sorted(flag.value for flag in track.flags)))
        for track_id, track in core.traffic.tracks.items()
    }
    others = core.traffic.neighbours(now_s) + core.adsb.look(now_s, own[2])
    if core.sensed is not None:
        fused = core.sensed.fused
        others = [other for other in others if (other.adsb, other.track_id) not in fused]
        others += core.sensed.look(now_s, core.own)
    return [_track(other, own, levels, conflicts, names) for other in others]


def _track(
    other: Neighbour,
    own: Vec3,
    levels: Mapping[tuple[bool, str], Level],
    conflicts: set[tuple[bool, str]],
    names: Mapping[str, tuple[str, tuple[str, ...]]],
) -> TrackStatus:
    doubts: tuple[str, ...]
    key = (other.adsb, other.track_id)
    p, v, age = other.position_ned_m, other.velocity_ned_mps, other.age_s
    if is_sensed(other.track_id):
        transport, doubts = "sensed", ()
    else:
        transport, doubts = ("adsb", ()) if other.adsb else names[other.track_id.partition(ASIDE)[0]]
    north, east = p[0] + age * v[0] - own[0], p[1] + age * v[1] - own[1]
    hovers = math.hypot(v[0], v[1]) < _HOVERS_MPS
    return TrackStatus(
        track_id=other.track_id,
        transport=transport,
        distance_m=math.hypot(north, east),
        bearing_deg=math.degrees(math.atan2(east, north)) % 360.0,
        track_deg=None if hovers else math.degrees(math.atan2(v[1], v[0])) % 360.0,
        above_m=own[2] - (p[2] + age * v[2]) if other.vertical_known else None,
        speed_mps=math.hypot(v[0], v[1]),
        age_s=age,
        alert=levels.get(key, Level.NONE).name.lower(),
        conflict=key in conflicts,
        doubts=doubts,
    )
