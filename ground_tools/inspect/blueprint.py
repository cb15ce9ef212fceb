"""How a recording opens: looking at the encounter, and playing it in a loop.

A viewer starts at the beginning of a time line, and nobody wants to watch minutes of straight flight. So
there are two: `time` is all of the run, and `encounter` counts from the first conflict and holds only what
lies around it. What is not needed at the first glance is behind a tab.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ground_tools.inspect.flown import Array, Separation
from ground_tools.inspect.scene import Scene
from ground_tools.inspect.writer import ENCOUNTER, WHOLE

LANES = {
    "Authority": "authority",
    "Alert level": "alert",
    "Autopilot mode": "mode",
    "On the air": "protocol",
    "Transports chosen, and by whom": "choice",
}
"""Names of views, and what they show."""
_EYE = (-0.9, -1.5, 1.25)
"""From what is looked at to the eye, in its radii: east, north, up."""
_LASTING = ("flown", "path")
"""Of an aircraft: drawn whole at any time."""


@dataclass(frozen=True, slots=True)
class Look:
    """What a view turns to."""

    centre_ned_m: Array
    """(3,)"""
    radius_m: float


def blueprint(
    scene: Scene, pairs: Sequence[Separation], look: Look | None, *, live: bool = False, placed: bool = True
) -> Any:
    """The views of a run. Those for which it has nothing are left out: separations without pairs, what a law
    saw without a companion, the space without positions.

    Args:
        live: at its newest time, which goes on.
        placed: somebody's position is known.
    """
    import rerun.blueprint as rrb

    plots = []
    if pairs:
        required = max(pair.required_m for pair in pairs)
        plots.append(_separation(rrb, scene, required, "/separation/**"))
    if any(one.config is not None for one in scene.aircraft):
        plots += [
            _plot(rrb, scene, "Distance to heard traffic (m)", "/range/**", legend=not pairs),
            _plot(rrb, scene, "Oldest information (s) of each pair", "/age/**"),
        ]
    plots += [
        _plot(rrb, scene, "Speed (m/s)", "/speed/**"),
        _plot(rrb, scene, "Link", "/link/**", legend=len(scene.aircraft) == 1),
    ]
    space = rrb.Tabs(_space(rrb, "In space", [scene], look), _map(rrb, [scene]), active_tab=0)
    return _opened(
        rrb,
        [scene],
        space if placed else None,
        rrb.Tabs(*plots, active_tab=0),
        rrb.Tabs(*(_lane(rrb, scene, name, f"/{lane}/**") for name, lane in LANES.items()), active_tab=0),
        live=live,
    )


def comparison(
    scenes: Mapping[str, Scene], looks: Sequence[Look | None], required_m: float | None, zero: str
) -> Any:
    """The views of several runs: beside each other, and one over the other.

    Args:
        scenes: by the run's name.
        looks: what to turn to in each.
        required_m: separation that was to be kept; None without any pair.
        zero: what time 0 is, in words.
    """
    import rerun.blueprint as rrb

    every = list(scenes.values())
    one = every[0]
    beside = [
        _space(rrb, name, [scene], look) for (name, scene), look in zip(scenes.items(), looks, strict=True)
    ]
    over = _space(rrb, "One over the other", every, looks[0])
    closest = [_path(scene, "separation", "closest two") for scene in every]
    limits = [] if required_m is None else [_path(one, "separation", f"required {required_m:g} m")]
    return _opened(
        rrb,
        every,
        rrb.Tabs(
            rrb.Vertical(*beside, name="Beside each other"),
            over,
            _map(rrb, every),
            active_tab=0,
        ),
        rrb.Tabs(
            _separation(rrb, one, required_m, *closest, *limits, name="Closest two of each run"),
            *(
                _separation(rrb, scene, required_m, f"{scene.root}/separation/**", name=f"Pairs: {name}")
                for name, scene in scenes.items()
            ),
            _plot(
                rrb, one, "Oldest information (s) of each pair", *(f"{scene.root}/age/**" for scene in every)
            ),
            _plot(rrb, one, "Speed (m/s)", *(f"{scene.root}/speed/**" for scene in every)),
            _plot(rrb, one, "Link", *(f"{scene.root}/link/**" for scene in every)),
            active_tab=0,
        ),
        rrb.Tabs(
            *(
                _lane(rrb, one, name, *(f"{scene.root}/{lane}/**" for scene in every))
                for name, lane in LANES.items()
            ),
            active_tab=0,
        ),
        f"Events; time 0 is {zero}",
    )


def _opened(
    rrb: Any,
    scenes: Sequence[Scene],
    space: Any,
    plots: Any,
    lanes: Any,
    events: str = "Events",
    *,
    live: bool = False,
) -> Any:
    """Space, where there is one, at the left, the rest beside it, playing the encounter."""
    rest = rrb.Vertical(
        plots,
        lanes,
        rrb.Tabs(
            _events(rrb, scenes, events),
            rrb.TextDocumentView(name="How to read this", origin=f"{scenes[0].root}/about"),
            active_tab=0,
        ),
        row_shares=[4, 5, 4],
    )
    return rrb.Blueprint(
        rest if space is None else rrb.Horizontal(space, rest, column_shares=[1, 1]),
        rrb.TimePanel(
            timeline=WHOLE if scenes[0].encounter is None else ENCOUNTER,
            state="collapsed",
            play_state="following" if live else "playing",
            loop_mode="off" if live else "all",
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
    )


def _space(rrb: Any, name: str, scenes: Sequence[Scene], look: Look | None) -> Any:
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
    """Rows of every time are drawn at once, not only the last one."""
    infinite = rrb.TimeRangeBoundary.infinite()
    ranges = rrb.VisibleTimeRanges(
        [rrb.VisibleTimeRange(line, start=infinite, end=infinite) for line in (WHOLE, ENCOUNTER)]
    )
    return dict.fromkeys(entities, ranges)


def _separation(
    rrb: Any, scene: Scene, required_m: float | None, *contents: str, name: str | None = None
) -> Any:
    if name is None:
        name = "Separation (m)" + (f"; limit {required_m:g} m" if required_m is not None else "")
    return rrb.TimeSeriesView(
        name=name,
        origin="/",
        contents=list(contents),
        axis_x=_axis(rrb, scene),
        axis_y=rrb.ScalarAxis(range=(0.0, 6.0 * (required_m or 10.0)), zoom_lock=False),
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
    one = scene.encounter
    if one is None:
        return None
    absolute = rrb.TimeRangeBoundary.absolute
    start, end = absolute(seconds=one.start_s - one.zero_s), absolute(seconds=one.end_s - one.zero_s)
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))


def _path(scene: Scene, *parts: str) -> str:
    from rerun import escape_entity_path_part as escape

    return "/".join([scene.root, *(escape(part) for part in parts)])
