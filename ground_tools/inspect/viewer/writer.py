"""Writes a run into a Rerun recording piece by piece, in columns (`send_columns`).

A `Writer` is given a `Scene`, and then steps of aircraft, flown paths and distances. It works for a finished
record as well as for a flight in progress, and needs memory for one piece only. The frame is drawn as x east,
y north, z up (m). rerun is imported on use, because its import takes seconds and it is an optional
dependency.

There are two time lines: `time` is that of the run, and `encounter` contains what a viewer shows first,
relative to the encounter's time 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from companion.arrays import Floats
from companion.avoidance.law import VERTICAL_SCALE, separation_m
from companion.event_record import Step
from companion.events import TrackView
from ground_tools.inspect.read.flown import Path, Separation, least_in_bins, least_of, unbroken
from ground_tools.inspect.viewer.drawing import Drawing, rerun
from ground_tools.inspect.viewer.palette import (
    ALERTS,
    AUTHORITY,
    LEVELS,
    LIMIT,
    PAIR,
    WANTED,
    faded,
    pale,
)
from ground_tools.inspect.viewer.pieces import Note, Piece, Places
from ground_tools.inspect.viewer.scene import Aircraft, Scene
from ground_tools.inspect.viewer.shapes import ARROW_S, enu, square
from ground_tools.inspect.viewer.step_columns import UNKNOWN, StepColumns

OLD_S = 5.0
"""Predictions from information of this age or older are drawn grey."""
DRAWN_S = 0.2
"""Distances are drawn as the minimum in each interval of this length."""
RANGE_S = 1.0
"""Distances to tracks, as the law saw them, are drawn as the minimum in each interval of this length."""
MARK_PX = 3.5, 2.5
"""Radius of markers on the screen: for warnings and worse, and for other events such as switches."""
AGE_S = 5.0
"""Ages of information are drawn as the maximum in each interval of this length, so that a loss stands out
from the usual saw-tooth shape."""

_LEGEND = f"""
In space, in each aircraft's colour:

- large point with a name: the aircraft at its own estimate of its position; around it its own conflict volume
- thick line: what it flew; thin pale line and small grey point: its timed path
- arrows, {ARROW_S:g} s long: grey the velocity it wanted, coloured the one its law chose
- pale points: another aircraft at the position that its received message gave
- small points: another aircraft as the law predicted it, greyer with age (grey from {OLD_S:g} s on)
- pale ellipsoid around a track: the volume that the law cleared, while that track is in its way
- line to a track: pale while in conflict; strong while that track bounds the chosen velocity
- square at the tip of a chosen arrow: the half-space of a bounding track, its tick on the allowed side
- points of constant size (small if nothing is wrong): events; hover over one to read it

Speed: thick flown, pale chosen, grey wanted. Distance to heard traffic: as the law saw it, the minimum in
each {RANGE_S:g} s. Ages: the maximum in each {AGE_S:g} s. Link: frames missing in each second from each
component (system/component), by their sequence numbers; what a radio reports about itself, in its own units.

Time line `encounter` shows the time around the first conflict, `time` the whole run: switch below.
"""


class Writer:
    """Writes one scene into a stream."""

    def __init__(self, stream: Any, scene: Scene) -> None:
        self._rr = rerun()
        self._draw = Drawing(stream, scene)
        self._scene = scene
        self._aircraft = {one.name: one for one in scene.aircraft}
        self._columns = {one.name: StepColumns(one, scene.origin) for one in scene.aircraft}
        self._last_ned_m: dict[str, Floats] = {}
        stream.log("/", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        about = self._rr.TextDocument(_LEGEND, media_type="text/markdown")
        stream.log(self._draw.entity("about"), about, static=True)

    def settle(self, now_s: float = math.inf) -> None:
        """Send the rows that are held back, and remove stale last rows (see `Drawing.settle`)."""
        self._draw.settle(now_s)

    def say(self, time_s: float, text: str) -> None:
        """Write a line of text about the whole run."""
        self.notes("run", [Note(time_s, "INFO", text)])

    def steps(self, name: str, steps: Iterable[Step]) -> None:
        """Write the next steps of one aircraft. All must be in one piece of the time line (`Scene.piece`)."""
        one, piece = self._aircraft[name], self._columns[name].piece_of(steps)
        self._own(one, piece)
        self._decisions(one, piece)
        self._tracks(one, piece)
        self._half_spaces(one, piece)
        for address, places in piece.heard.items():
            self._heard(one, address, places)
        for lane, states in piece.states.items():
            self._lane(lane, name, states)
        self.notes(name, piece.notes)
        self._markers(one, piece)

    def tell(self, name: str, note: Note, where_ned_m: Floats) -> None:
        """Write a note about an aircraft with a marker at its place, for events not found in single steps."""
        self.notes(name, [note])
        self.mark(name, [note], where_ned_m.reshape(1, 3))

    def flown(self, path: Path, latitudes: Floats, longest_s: float) -> None:
        """Write the next part of the path that an aircraft flew.

        Args:
            path: Samples of one piece of the time line, plus the first sample after it.
            latitudes: (n, 2) lat_deg, lon_deg of its samples.
            longest_s: No line is drawn between two samples that are farther apart in time.
        """
        rr, rgb = self._rr, self._aircraft[path.name].rgb
        when = path.time_s[:1]
        spans = unbroken(path.time_s, longest_s)
        strip = rr.LineStrips3D.columns(strips=[enu(path.position_ned_m[span]) for span in spans])
        entity = self._draw.entity("aircraft", path.name, "flown")
        self._draw.style(entity, rr.LineStrips3D.from_fields(colors=[rgb], radii=[-1.5]))
        self._draw.send(entity, when, strip.partition([len(spans)]), clip=True)
        entity = self._draw.entity("map", path.name, "flown")
        self._draw.style(entity, rr.GeoLineStrings.from_fields(colors=[rgb], radii=[-2.0]))
        strip = rr.GeoLineStrings.columns(line_strings=[latitudes[span] for span in spans])
        self._draw.send(entity, when, strip.partition([len(spans)]), clip=True)

    def distances(self, pairs: Sequence[Separation], required_m: float) -> None:
        """Write the next part of every pair's distance, and of the smallest distance of any pair."""
        if not pairs:
            return
        for pair in pairs:
            known = ~np.isnan(pair.distance_m)
            time, least = least_in_bins(pair.time_s[known], pair.distance_m[known], DRAWN_S)
            self._draw.line(("separation", f"{pair.first} - {pair.second}"), time, least, PAIR, 1.0)
        time, least = least_in_bins(*least_of(pairs), DRAWN_S)
        rgb = self._scene.aircraft[0].rgb
        self._draw.line(("separation", "closest two"), time, least, rgb, 3.0)
        if len(time):
            limit = np.full(2, required_m)
            self._draw.line(("separation", f"required {required_m:g} m"), time[[0, -1]], limit, LIMIT, 3.0)

    def closest(self, pair: Separation, where_ned_m: Floats) -> None:
        """Mark where and when a pair came closest."""
        if pair.minimum_m is None or pair.minimum_time_s is None:
            return
        lost = pair.minimum_m < pair.required_m
        words = f"{pair.first} - {pair.second} closest: {pair.minimum_m:.1f} m"
        words += f", {pair.required_m:g} m were to be kept" if lost else f" ({pair.required_m:g} m kept)"
        note = Note(pair.minimum_time_s, "CRITICAL" if lost else "INFO", words, marked=True)
        self.notes("pairs", [note])
        self.mark("closest", [note], where_ned_m.reshape(1, 3))

    def link(self, name: str, what: str, time_s: Floats, values: Floats) -> None:
        """Write a line of one figure of a link's quality."""
        self._draw.line(("link", f"{name} {what}"), time_s, values, self._aircraft[name].rgb, 1.5)

    def _own(self, one: Aircraft, piece: Piece) -> None:
        rr, rgb = self._rr, one.rgb
        time, place = piece.own_s, piece.own_ned_m
        if not len(time):
            time, place = piece.decided_s, piece.decided_ned_m
        if not len(time):
            return
        self._last_ned_m[one.name] = place[-1]
        self._draw.points(("aircraft", one.name, "own"), time, place, rgb, 1.2, one.name, named=True)
        entity = self._draw.entity("aircraft", one.name, "volume")
        radius = one.avoidance.conflict_radius_m
        size = (radius, radius, radius / VERTICAL_SCALE)
        self._draw.style(entity, rr.Ellipsoids3D.from_fields(colors=[rgb], line_radii=[-0.5]))
        sizes = np.tile(np.array(size, np.float32), (len(time), 1))
        columns = rr.Ellipsoids3D.columns(centers=enu(place), half_sizes=sizes)
        self._draw.send_until_stale(entity, "Ellipsoids3D", time, columns)
        if len(piece.own_s):
            entity = self._draw.entity("map", one.name, "own")
            self._draw.style(entity, rr.GeoPoints.from_fields(colors=[rgb], radii=[-6.0]))
            self._draw.send(entity, time, rr.GeoPoints.columns(positions=piece.own_geodetic[:, :2]))
            self._draw.line(("speed", one.name, "flown"), time, piece.speed_mps, rgb, 2.5)

    def _decisions(self, one: Aircraft, piece: Piece) -> None:
        time, rgb = piece.decided_s, one.rgb
        if not len(time):
            # Without decisions of a law there may still be velocity setpoints.
            self._draw.line(
                ("speed", one.name, "chosen"), piece.setpoint_s, piece.setpoint_mps, pale(rgb), 1.5
            )
            return
        for what, velocity, shade in (
            ("wanted", piece.wanted_ned_mps, WANTED),
            ("chosen", piece.chosen_ned_mps, rgb),
        ):
            self._draw.arrows((one.name, what), time, piece.decided_ned_m, velocity, shade)
            colour = pale(rgb) if what == "chosen" else WANTED
            self._draw.line(("speed", one.name, what), time, np.linalg.norm(velocity, axis=1), colour, 1.0)
        if not len(piece.path_s):
            return
        rr = self._rr
        self._draw.points(
            ("aircraft", one.name, "path point"), piece.path_s, piece.path_ned_m, WANTED, 0.6, ""
        )
        entity = self._draw.entity("aircraft", one.name, "path")
        self._draw.style(entity, rr.LineStrips3D.from_fields(colors=[pale(rgb)], radii=[-0.6]))
        strip = rr.LineStrips3D.columns(strips=[enu(piece.path_ned_m)])
        self._draw.send(entity, piece.path_s[:1], strip, clip=True)

    def _tracks(self, one: Aircraft, piece: Piece) -> None:
        """Write the tracks' positions as the law predicted them, their ages, and the volumes of those in the
        way."""
        seen = [track for tracks in piece.seen for track in tracks]
        if not len(piece.decided_s):
            return
        rr, rgb = self._rr, one.rgb
        entity = self._draw.entity("aircraft", one.name, "predicted")
        self._draw.style(entity, rr.Points3D.from_fields(radii=[0.7], show_labels=False))
        columns = rr.Points3D.columns(
            positions=enu(piece.seen_ned_m),
            colors=[faded(rgb, track.age_s / OLD_S) for track in seen],
            labels=[f"{t.track_id} as {one.name} predicts it, {t.age_s:.1f} s old" for t in seen],
        )
        lengths = np.array([len(tracks) for tracks in piece.seen])
        if seen:
            self._draw.send_until_stale(entity, "Points3D", piece.decided_s, columns, lengths)
        self._in_the_way(one, piece)
        times, own = (np.repeat(rows, lengths, axis=0) for rows in (piece.decided_s, piece.decided_ned_m))
        away = np.linalg.norm(piece.seen_ned_m - own, axis=1)
        rows: dict[str, list[tuple[float, float, float]]] = {}
        for time, track, distance in zip(times, seen, away, strict=True):
            rows.setdefault(track.track_id, []).append((time, track.age_s, distance))
        for track_id, found in rows.items():
            when, ages, distances = np.array(found).T
            name = f"{track_id} at {one.name}"
            at, least = least_in_bins(when, distances, RANGE_S)
            self._draw.line(("range", name), at, least, rgb, 1.5)
            at, less = least_in_bins(when, -ages, AGE_S)
            self._draw.line(("age", name), at, -less, rgb, 1.0)

    def _in_the_way(self, one: Aircraft, piece: Piece) -> None:
        """Write the volumes of tracks in conflict or with an active half-space, and lines to them."""
        rr = self._rr
        flags = np.array([t.conflict or t.active for tracks in piece.seen for t in tracks], dtype=bool)
        entity = self._draw.entity("aircraft", one.name, "in the way")
        if not flags.any() and not self._draw.has(entity):
            return
        lengths = np.array([sum(t.conflict or t.active for t in tracks) for tracks in piece.seen])
        found = [t for tracks in piece.seen for t in tracks if t.conflict or t.active]
        places = enu(piece.seen_ned_m[flags])
        self._draw.style(entity, rr.Ellipsoids3D.from_fields(line_radii=[-0.4], show_labels=False))
        columns = rr.Ellipsoids3D.columns(
            centers=places,
            half_sizes=np.array([_half_size(one, track) for track in found], np.float32).reshape(-1, 3),
            colors=[pale(one.rgb)] * len(found),
            labels=[_in_words(one, track) for track in found],
        )
        self._draw.send_until_stale(entity, "Ellipsoids3D", piece.decided_s, columns, lengths)
        own = np.repeat(enu(piece.decided_ned_m), lengths, axis=0)
        lines = self._draw.entity("aircraft", one.name, "sight")
        self._draw.style(lines, rr.LineStrips3D.from_fields(radii=[-0.8]))
        columns = rr.LineStrips3D.columns(
            strips=np.stack([own, places], axis=1),
            colors=[LIMIT if track.active else pale(LIMIT) for track in found],
        )
        self._draw.send_until_stale(lines, "LineStrips3D", piece.decided_s, columns, lengths)

    def _half_spaces(self, one: Aircraft, piece: Piece) -> None:
        """Write, for each track that bounds the velocity, a square on its plane near the chosen velocity."""
        if not piece.bounds:
            return
        rr = self._rr
        entity = self._draw.entity("aircraft", one.name, "half-spaces")
        self._draw.style(entity, rr.LineStrips3D.from_fields(radii=[-1.2], show_labels=False))
        shapes = [
            (square(bound.position_ned_m, bound.velocity_ned_mps, space), f"{space.cause} bounds {one.name}")
            for bound in piece.bounds
            for space in bound.half_spaces
        ]
        columns = rr.LineStrips3D.columns(
            strips=[enu(shape) for shape, _ in shapes],
            colors=[LIMIT] * len(shapes),
            labels=[label for _, label in shapes],
        )
        times = np.array([bound.time_s for bound in piece.bounds])
        lengths = np.array([len(bound.half_spaces) for bound in piece.bounds])
        self._draw.send_until_stale(entity, "LineStrips3D", times, columns, lengths)

    def _heard(self, one: Aircraft, address: str, places: Places) -> None:
        parts = ("aircraft", one.name, "heard", address)
        self._draw.points(parts, places.time_s, places.position_ned_m, pale(one.rgb), 0.9, places.label)
        known = ~np.isnan(places.rssi_dbm)
        self.link(one.name, f"hears {address} (dBm)", places.time_s[known], places.rssi_dbm[known])

    def _lane(self, lane: str, name: str, states: list[tuple[float, str]]) -> None:
        rr = self._rr
        entity = self._draw.entity(lane, name)
        shades = {"authority": AUTHORITY, "alert": ALERTS}.get(lane)
        if shades is not None:
            config = rr.StateConfiguration(values=list(shades), colors=list(shades.values()))
            self._draw.style(entity, config)
        columns = rr.StateChange.columns(state=[state or UNKNOWN for _, state in states])
        self._draw.send(entity, np.array([time for time, _ in states]), columns, clip=True)

    def notes(self, name: str, notes: Sequence[Note]) -> None:
        """Write lines of text about one aircraft, in order. All must be in one piece of the time line."""
        if notes:
            who = [self._scene.name] if self._scene.name else []
            if name in self._aircraft:
                who.append(name)
            columns = self._rr.TextLog.columns(
                text=[": ".join([" ".join(who), note.text] if who else [note.text]) for note in notes],
                level=[note.level for note in notes],
            )
            self._draw.send(
                self._draw.entity("events", name), np.array([note.time_s for note in notes]), columns
            )

    def _markers(self, one: Aircraft, piece: Piece) -> None:
        marked = [note for note in piece.notes if note.marked]
        last = self._last_ned_m.get(one.name)
        if not marked or last is None:
            return
        times = np.array([note.time_s for note in marked])
        path_s, path = piece.own_s, piece.own_ned_m
        if not len(path_s):
            path_s, path = np.zeros(1), last.reshape(1, 3)
        where = np.column_stack([np.interp(times, path_s, axis) for axis in path.T])
        self.mark(one.name, marked, where)

    def mark(self, name: str, notes: Sequence[Note], where_ned_m: Floats) -> None:
        """Mark the places (n, 3) of the notes, in order. All must be in one piece of the time line."""
        rr = self._rr
        entity = self._draw.entity("markers", name)
        self._draw.style(entity, rr.Points3D.from_fields(show_labels=False))
        columns = rr.Points3D.columns(
            positions=enu(where_ned_m),
            colors=[LEVELS[note.level] for note in notes],
            radii=[-MARK_PX[note.level == "INFO"] for note in notes],
            labels=[note.text for note in notes],
        )
        self._draw.send(entity, np.array([note.time_s for note in notes]), columns)


def _half_size(one: Aircraft, track: TrackView) -> tuple[float, float, float]:
    """Return the half axes of the volume that the law kept clear."""
    crewed = track.adsb and track.radius_m >= separation_m(one.avoidance, True)[0]
    tall = separation_m(one.avoidance, crewed)[1]
    return (track.radius_m, track.radius_m, track.height_m or track.radius_m / tall)


def _in_words(one: Aircraft, track: TrackView) -> str:
    return (
        f"{one.name} clears {track.track_id}: {track.closest_m:.0f} m in {track.time_to_closest_s:.0f} s, "
        f"heard {track.age_s:.1f} s ago"
    )
