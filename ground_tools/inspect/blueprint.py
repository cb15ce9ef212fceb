"""How a recording opens: looking at the crossing, and playing the time around it in a loop.

A viewer starts at the beginning of a time line, and nobody wants to watch minutes of straight flight. So
there are two: `time` is all of the run, and `encounter` counts from the closest approach and holds only what
lies around it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ground_tools.inspect.flown import Array, Flown, Separation, crossing

WHOLE = "time"
ENCOUNTER = "encounter"
BEFORE_S = 40.0
AFTER_S = 60.0
"""The time around the closest approach that is played and plotted."""
_MARGIN_S = 0.5
"""Left out of the plots at both ends, where everything outside is gathered."""
_EYE_M = (-55.0, -90.0, 75.0)
"""From the crossing to the eye: east, north, up."""


def blueprint(ways: Flown, pairs: Sequence[Separation]) -> Any:
    """The views of a recording; without pairs, whatever the viewer chooses to look at."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(
            _paths(rrb, ways, pairs),
            rrb.Vertical(
                _separation(rrb, pairs),
                rrb.StateTimelineView(name="Authority", origin="/authority", time_view=_axis(rrb, pairs)),
                _events(rrb),
                row_shares=[5, 4, 3],
            ),
            column_shares=[1, 1],
        ),
        _time_panel(rrb, pairs),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
    )


def _paths(rrb: Any, ways: Flown, pairs: Sequence[Separation]) -> Any:
    eye = None
    if pairs:
        north, east, down = (float(v) for v in crossing(ways, pairs))
        eye = rrb.EyeControls3D(
            position=(east + _EYE_M[0], north + _EYE_M[1], -down + _EYE_M[2]),
            look_target=(east, north, -down),
            eye_up=(0.0, 0.0, 1.0),
        )
    words = "Large: own. Pale: heard, small: predicted, in the hearer's colour"
    return rrb.Spatial3DView(
        name=f"Lines: flown ({ways.positions}). {words}",
        origin="/",
        contents=["/world/**", "/aircraft/**"],
        eye_controls=eye,
    )


def _separation(rrb: Any, pairs: Sequence[Separation]) -> Any:
    required = max((pair.required_m for pair in pairs), default=10.0)
    return rrb.TimeSeriesView(
        name=f"Separation (m) of the closest two, and of each pair; limit {required:g} m",
        origin="/separation",
        axis_x=_axis(rrb, pairs),
        axis_y=rrb.ScalarAxis(range=(0.0, 6.0 * required), zoom_lock=False),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def _events(rrb: Any) -> Any:
    columns = [
        rrb.encodings.TextLogColumn("EntityPath", visible=False),
        rrb.encodings.TextLogColumn("LogLevel"),
        rrb.encodings.TextLogColumn("Body"),
    ]
    return rrb.TextLogView(
        name="Events", origin="/events", columns=rrb.TextLogColumns(text_log_columns=columns)
    )


def encounter_time(time_s: Array, closest_s: float) -> Array:
    """Times from the closest approach; what lies farther from it than the encounter lasts is at its ends."""
    clipped: Array = np.clip(time_s - closest_s, -BEFORE_S, AFTER_S)
    return clipped


def _time_panel(rrb: Any, pairs: Sequence[Separation]) -> Any:
    return rrb.TimePanel(
        timeline=ENCOUNTER if pairs else WHOLE, state="collapsed", play_state="playing", loop_mode="all"
    )


def _axis(rrb: Any, pairs: Sequence[Separation]) -> Any:
    if not pairs:
        return None
    absolute = rrb.TimeRangeBoundary.absolute
    start, end = absolute(seconds=_MARGIN_S - BEFORE_S), absolute(seconds=AFTER_S - _MARGIN_S)
    return rrb.TimeAxis(view_range=rrb.TimeRange(start=start, end=end))
