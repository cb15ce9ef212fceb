"""The initial layout of a recording: it opens on the encounter and plays it in a loop.

A viewer starts at the beginning of a time line, which may be minutes of straight flight. Therefore there are
two time lines: `time` covers the whole run, and `encounter` counts from the first conflict and contains only
what lies around it. The most important views are side by side, and the others are behind tabs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from companion.arrays import Floats
from ground_tools.inspect.read.flown import Separation
from ground_tools.inspect.viewer.drawing import ENCOUNTER, WHOLE
from ground_tools.inspect.viewer.scene import Scene

AUTHORITY, ALERT, MODE = "Authority", "Alert level", "Autopilot mode"
AIR, CHOICE = "On the air", "Chosen transports"
LANES = {AUTHORITY: "authority", ALERT: "alert", MODE: "mode", AIR: "protocol", CHOICE: "choice"}
"""Names of the lane views, and the first part of the entity paths that they show."""
AGE, RANGE = "Age of information (s)", "Distance to heard traffic (m)"
SPEED, LINK = "Speed (m/s)", "Link (lost/s; dBm)"
PLOT_SHARE, LANE_SHARE = 3, 4
"""Shares of the window's height, chosen so that the lanes of five aircraft fit."""
_EYE = (-0.75, -1.25, 1.5)
"""Eye position relative to the centre of the view, in radii of the view: east, north, up."""
_LASTING = ("flown", "path")
"""Entities of an aircraft of which all rows are drawn at any time."""


@dataclass(frozen=True, slots=True)
class Look:
    """The sphere that a view shows."""

    centre_ned_m: Floats
    """(3,)"""
    radius_m: float


def blueprint(
    scene: Scene, pairs: Sequence[Separation], look: Look | None, *, live: bool = False, placed: bool = True
) -> Any:
    """Return the views of a run. Views without data are left out.

    These are the separations if there are no pairs, the data of the avoidance law if there is no companion,
    and the space if there are no positions.

    Args:
        scene: The run.
        pairs: Pairs whose separation is shown.
        look: Where the view in space looks; None for rerun's own choice.
        live: Follow the newest time of a run that is still in progress.
        placed: True if the position of any aircraft is known.
    """
    import rerun.blueprint as rrb

    has_law = any(one.config is not None for one in scene.aircraft)
    near = (
        [_separation(rrb, scene, max(pair.required_m for pair in pairs), nearest_m(pairs), "/separation/**")]
        if pairs
        else []
    )
    plots = [
        _plot(rrb, scene, SPEED, "/speed/**"),
        _plot(rrb, scene, LINK, "/link/**", legend=len(scene.aircraft) == 1),
    ]
    lanes = {name: _lane(rrb, scene, name, f"/{lane}/**") for name, lane in LANES.items()}
    below: list[Any] = [lanes[MODE]]
    if has_law:
        near.append(_plot(rrb, scene, RANGE, "/range/**", legend=not pairs))
        plots.insert(0, _plot(rrb, scene, AGE, "/age/**"))
        air = rrb.Tabs(lanes[AIR], lanes[CHOICE], active_tab=0)
        below = [rrb.Tabs(lanes[AUTHORITY], lanes[MODE], active_tab=0), rrb.Horizontal(lanes[ALERT], air)]
    above: list[Any] = [rrb.Tabs(*near, active_tab=0)] if near else []
    above.append(rrb.Horizontal(*plots))
    rows = rrb.Vertical(*above, *below, row_shares=[PLOT_SHARE] * len(above) + [LANE_SHARE] * len(below))
    texts = _texts(rrb, [scene], "Events")
    if not placed:
        return _opened(rrb, [scene], rrb.Vertical(rows, texts, row_shares=[3, 1]), live=live)
    space = rrb.Tabs(_space(rrb, "In space", [scene], look), _map(rrb, [scene]), active_tab=0)
    left = rrb.Vertical(space, texts, row_shares=[5, 3])
    return _opened(rrb, [scene], rrb.Horizontal(left, rows, column_shares=[1, 1]), live=live)


def comparison(
    scenes: Mapping[str, Scene],
    looks: Sequence[Look | None],
    required_m: float | None,
    closest_m: float,
    zero: str,
) -> Any:
    """Return the views of several runs, both next to each other and overlaid.

    Args:
        scenes: The runs, by name.
        looks: Where the view of each run looks.
        required_m: Required separation; None without any pair.
        closest_m: Smallest separation of any pair; 0 without any.
        zero: Description of time 0.
    """
    import rerun.blueprint as rrb

    every = list(scenes.values())
    one = every[0]
    beside = [
        _space(rrb, name, [scene], look) for (name, scene), look in zip(scenes.items(), looks, strict=True)
    ]
    over = _space(rrb, "Overlaid", every, looks[0])
    closest = [_path(scene, "separation", "closest two") for scene in every]
    limits = [] if required_m is None else [_path(one, "separation", f"required {required_m:g} m")]
    space = rrb.Tabs(
        rrb.Vertical(*beside, name="Side by side"),
        over,
        _map(rrb, every),
        active_tab=0,
    )
    plots = rrb.Tabs(
        _separation(rrb, one, required_m, closest_m, *closest, *limits, name="Closest pair of each run"),
        *(
            _separation(
                rrb, scene, required_m, closest_m, f"{scene.root}/separation/**", name=f"Pairs: {name}"
            )
            for name, scene in scenes.items()
        ),
        _plot(rrb, one, AGE, *(f"{scene.root}/age/**" for scene in every)),
        _plot(rrb, one, SPEED, *(f"{scene.root}/speed/**" for scene in every)),
        _plot(rrb, one, LINK, *(f"{scene.root}/link/**" for scene in every)),
        active_tab=0,
    )
    lanes = rrb.Tabs(
        *(
            _lane(rrb, one, name, *(f"{scene.root}/{lane}/**" for scene in every))
            for name, lane in LANES.items()
        ),
        active_tab=0,
    )
    rest = rrb.Vertical(plots, lanes, _texts(rrb, every, f"Events; time 0 is {zero}"), row_shares=[4, 5, 4])
    return _opened(rrb, every, rrb.Horizontal(space, rest, column_shares=[1, 1]))


def _opened(rrb: Any, scenes: Sequence[Scene], views: Any, *, live: bool = False) -> Any:
    """Return a blueprint that plays the encounter or, without one, the whole run."""
    return rrb.Blueprint(
        views,
        rrb.TimePanel(
            timeline=WHOLE if scenes[0].encounter is None else ENCOUNTER,
            state="collapsed",
            play_state="following" if live else "playing",
            loop_mode="off" if live else "all",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
    )


def _texts(rrb: Any, scenes: Sequence[Scene], name: str) -> Any:
    about = rrb.TextDocumentView(name="How to read this", origin=f"{scenes[0].root}/about")
    return rrb.Tabs(_events(rrb, scenes, name), about, active_tab=0)


def _space(rrb: Any, name: str, scenes: Sequence[Scene], look: Look | None) -> Any:
    from rerun import Ellipsoids3D

    eye = None
    if look is not None:
        north, east, down = (float(v) for v in look.centre_ned_m)
        away = [look.radius_m * share for share in _EYE]
        eye = rrb.EyeControls3D(
            position=(east + away[0], north + away[1], -down + away[2]),
            look_target=(east, north, -down),
            eye_up=(0.0, 0.0, 1.0),
        )
    lasting = [
        *(
            _path(scene, "aircraft", one.name, part)
            for scene in scenes
            for one in scene.aircraft
            for part in _LASTING
        ),
        *(
            _path(scene, "markers", name)
            for scene in scenes
            for name in ("closest", *(one.name for one in scene.aircraft))
        ),
    ]
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=[f"{scene.root}/{part}/**" for scene in scenes for part in ("aircraft", "markers")],
        eye_controls=eye,
        # A filled volume would hide the arrows in it.
        defaults=[Ellipsoids3D.from_fields(fill_mode="MajorWireframe")],
        overrides=_at_all_times(rrb, lasting),
    )


def _map(rrb: Any, scenes: Sequence[Scene]) -> Any:
    whole = [_path(scene, "map", one.name, "flown") for scene in scenes for one in scene.aircraft]
    return rrb.MapView(
        name="Map (tiles come from the network)",
        origin="/",
        contents=[f"{scene.root}/map/**" for scene in scenes],
        overrides=_at_all_times(rrb, whole),
    )


def _at_all_times(rrb: Any, entities: Sequence[str]) -> dict[str, Any]:
    """Draw the rows of all times of these entities at once, not only the latest one."""
    infinite = rrb.TimeRangeBoundary.infinite()
    ranges = rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(line, start=infinite, end=infinite) for line in (WHOLE, ENCOUNTER)]
    )
    return dict.fromkeys(entities, ranges)


def nearest_m(pairs: Sequence[Separation]) -> float:
    """Return the smallest separation of any pair; 0 without any."""
    return min((pair.minimum_m for pair in pairs if pair.minimum_m is not None), default=0.0)


def _separation(
    rrb: Any,
    scene: Scene,
    required_m: float | None,
    closest_m: float,
    *contents: str,
    name: str | None = None,
) -> Any:
    if name is None:
        name = "Separation (m)" + (f"; limit {required_m:g} m" if required_m is not None else "")
    return rrb.TimeSeriesView(
        name=name,
        origin="/",
        contents=list(contents),
        axis_x=_axis(rrb, scene),
        axis_y=rrb.ScalarAxis(range=(0.0, max(6.0 * (required_m or 10.0), 1.5 * closest_m)), zoom_lock=False),
        plot_legend=rrb.PlotLegend(visible=len(contents) > 1),
    )


def _plot(rrb: Any, scene: Scene, name: str, *contents: str, legend: bool = False) -> Any:
    return rrb.TimeSeriesView(
        name=name,
        origin="/",
        contents=list(contents),
        axis_x=_axis(rrb, scene),
        plot_legend=rrb.PlotLegend(visible=legend),
    )


def _lane(rrb: Any, scene: Scene, name: str, *contents: str) -> Any:
    return rrb.StateTimelineView(name=name, origin="/", contents=list(contents), time_view=_axis(rrb, scene))


def _events(rrb: Any, scenes: Sequence[Scene], name: str) -> Any:
    columns = [
        rrb.encodings.TextLogColumn("EntityPath", visible=False),
        rrb.encodings.TextLogColumn("LogLevel"),
        rrb.encodings.TextLogColumn("Body"),
    ]
    return rrb.TextLogView(
        name=name,
        origin="/",
        contents=[f"{scene.root}/events/**" for scene in scenes],
        columns=rrb.TextLogColumns(text_log_columns=columns),
    )


def _axis(rrb: Any, scene: Scene) -> Any:
    """Return the time range that plots and lanes show first: the encounter, or else the whole run; None for a
    live run."""
    one = scene.encounter
    span = scene.span_s
    if one is not None:
        least, most = span or (one.start_s, one.end_s)
        span = max(one.start_s, least) - one.zero_s, min(one.end_s, most) - one.zero_s
    if span is None:
        return None
    start, end = (rrb.TimeRangeBoundary.absolute(seconds=time) for time in span)
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))


def _path(scene: Scene, *parts: str) -> str:
    from rerun import escape_entity_path_part as escape

    return "/".join([scene.root, *(escape(part) for part in parts)])
