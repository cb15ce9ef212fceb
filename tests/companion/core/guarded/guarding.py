"""What happens to a vehicle whose mission is guarded (the fixture `guarded`)."""

from __future__ import annotations

from companion.events import FlightMode, RcChannels, SetMode
from tests.companion.core.conftest import intruder


def meet(bench, ahead_m=60.0, seconds=2.0):
    """An aircraft approaches head-on and is received for a while."""
    for k in range(round(seconds)):
        bench.extra.append(intruder(bench, bench.north_m + ahead_m - 3.0 * k, 3.0))
        bench.step(20)


def taken(bench):
    meet(bench)
    bench.until(lambda: bench.core.in_control)
    return bench


def over(bench):
    """Run until the mission is given back."""
    bench.velocity_ned_mps = (0.0, 0.0, 0.0)
    bench.extra.append(RcChannels())
    for _ in range(800):
        if any(isinstance(c, SetMode) and c.mode is FlightMode.MISSION for c in bench.commands):
            return
        on_path(bench)
    raise AssertionError(bench.core.state)


def on_path(bench, steps=1):
    """The vehicle is on the path's point, wherever that is."""
    for _ in range(steps):
        point = bench.core.plan.course.point(bench.now_s)
        bench.north_m, bench.east_m = point[0], point[1]
        bench.step()


def modes(commands):
    return [c.mode for c in commands if isinstance(c, SetMode)]
