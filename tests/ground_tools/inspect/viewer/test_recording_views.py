"""The views with which a recording opens, and their content."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.config import Config, IdentityConfig
from ground_tools.inspect.read.flown import flown, placed, separations
from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import recording
from ground_tools.inspect.viewer.blueprint import _axis, _separation, blueprint, nearest_m
from ground_tools.inspect.viewer.scene import Aircraft, Encounter, Scene
from tests.support import needs

pytestmark = needs.rerun


def views(container: Any) -> list[str]:
    """Names of the views in a blueprint, in order."""
    if type(container).__name__ not in ("Horizontal", "Vertical", "Tabs"):
        return [str(container.name)]
    return [name for part in container.contents for name in views(part)]


def test_only_views_with_something_to_show_are_there(built: Path) -> None:
    run = read_run(built)
    pair = separations(flown(run).paths)
    with_law = Aircraft("a", (1, 2, 3), config=Config(identity=IdentityConfig(uas_id="a")))
    scenes = Scene((0.0, 0.0, 0.0), (with_law,)), Scene((0.0, 0.0, 0.0), (Aircraft("a", (1, 2, 3)),))
    space = ["In space", "Map (tiles come from the network)"]
    texts = ["Events", "How to read this"]
    seen = ["Distance to heard traffic (m)", "Age of information (s)"]
    plots = ["Speed (m/s)", "Link (lost/s; dBm)"]
    lanes = ["Authority", "Autopilot mode", "Alert level", "On the air", "Chosen transports"]
    limit = f"Separation (m); limit {pair[0].required_m:g} m"
    assert views(blueprint(scenes[0], pair, None).root_container) == [
        *(*space, *texts, limit),
        *(*seen, *plots, *lanes),
    ]
    alone = blueprint(scenes[0], (), None, live=True)
    assert views(alone.root_container) == [*space, *texts, *seen, *plots, *lanes]
    foreign = blueprint(scenes[1], (), None)
    assert views(foreign.root_container) == [*space, *texts, *plots, "Autopilot mode"]
    bench = blueprint(scenes[1], (), None, placed=False)
    assert views(bench.root_container) == [*plots, "Autopilot mode", *texts]


def test_the_initial_view_contains_all_positions(tmp_path: Path, built: Path, made: SimpleNamespace) -> None:
    """With one aircraft: its whole path. With several: their positions from the beginning of the encounter
    on."""
    made.write_events(tmp_path, "a", made.steps(made.northbound, made.eastbound(20.0)))
    ways = placed(read_run(tmp_path))
    look = recording._look(ways, (), None)
    assert look is not None
    away = np.linalg.norm(ways.paths[0].position_ned_m - look.centre_ned_m, axis=1)
    assert away.max() <= look.radius_m + 1e-6 < 1.01 * away.max()

    ways = placed(read_run(built))
    pairs = tuple(separations(ways.paths))
    encounter = Encounter(5.0, 30.0, 50.0, "the first conflict")
    look = recording._look(ways, pairs, encounter)
    assert look is not None
    begin = [[np.interp(5.0, path.time_s, axis) for axis in path.position_ned_m.T] for path in ways.paths]
    assert max(np.linalg.norm(np.array(begin) - look.centre_ned_m, axis=1)) <= look.radius_m + 1e-6


@pytest.mark.parametrize(
    ("encounter", "seconds"),
    [
        (None, (25, 60)),
        (Encounter(20.0, 30.0, 50.0, ""), (-5, 20)),
        (Encounter(30.0, 40.0, 80.0, ""), (-10, 20)),
    ],
)
def test_plots_show_the_encounter_within_the_run(
    encounter: Encounter | None, seconds: tuple[int, int]
) -> None:
    import rerun.blueprint as rrb

    axis = _axis(rrb, Scene((0.0, 0.0, 0.0), (), encounter, span_s=(25.0, 60.0)))
    ((shown,),) = [axis.view_range.as_arrow_array().to_pylist()]
    assert (shown["start"], shown["end"]) == tuple(1_000_000_000 * value for value in seconds)
    assert _axis(rrb, Scene((0.0, 0.0, 0.0), ())) is None


def test_a_plot_reaches_to_pairs_that_stay_far_apart(built: Path) -> None:
    """With a limit of 10 m, the plot reaches to 60 m or to 1.5 times the closest distance."""
    import rerun.blueprint as rrb

    bare = Scene((0.0, 0.0, 0.0), ())
    for closest_m, top in ((14.0, 60.0), (200.0, 300.0)):
        axis = _separation(rrb, bare, 10.0, closest_m, "/separation/**").properties["ScalarAxis"]
        assert axis.range.as_arrow_array().to_pylist() == [[0.0, top]]
    pairs = separations(flown(read_run(built)).paths)
    assert nearest_m(pairs) == pytest.approx(20.0 / math.sqrt(2.0), abs=0.01)
    assert nearest_m(()) == 0.0
