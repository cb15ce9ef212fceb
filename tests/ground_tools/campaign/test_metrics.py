"""The measures of a flight, compared with the same measures recomputed from recorded positions and
decisions."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest

from companion.avoidance import kernels as k
from ground_tools.campaign import cells as campaign
from ground_tools.campaign import outcome, vehicles
from ground_tools.campaign.cells import Cell, Row

AVOIDED = Cell(generator="crossing", aircraft=5, delay_s=(1.0, 2.0), intruders=0.2, intruder="liar")
CELLS = [AVOIDED, campaign.baseline(AVOIDED), Cell(generator="crossing", aircraft=3, law="paper")]
SEEDS = range(1, 6)


def least_distance(trace, i, j):
    gap = trace[:, j] - trace[:, i]
    step = np.diff(gap, axis=0)
    share = -(gap[:-1] * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12)
    return np.linalg.norm(gap[:-1] + np.clip(share, 0.0, 1.0)[:, None] * step, axis=1).min()


def recovery(look, i):
    """Recovery time, s; None: not back at the end."""
    conflicts = look.log.time_s[look.log.conflict[:, i] != 0.0, i]
    if not len(conflicts):
        return 0.0
    begins = look.world.start_s + look.world.step_s * np.arange(len(look.trace))
    point = np.column_stack(
        [np.interp(begins + look.world.step_s, look.times[i], axis) for axis in look.points[i].T]
    )
    near = np.linalg.norm(look.trace[:, i] - point, axis=1) <= 5.0
    back = begins[near & (begins > conflicts[-1] - 1e-6)]
    return back[0] - conflicts[-1] if len(back) else None


@pytest.mark.parametrize("cell", CELLS, ids=["avoided", "unavoided", "paper"])
def test_pairs_and_recovery_are_those_of_the_flight(cell):
    lost, alerts, times = 0, 0, []
    for seed in SEEDS:
        look = campaign.look(cell, seed)
        begin = np.array([[p[0] for p in look.points]])
        trace = np.concatenate([begin, look.trace])
        pairs = [(j, i) for i in range(cell.aircraft) for j in range(i)]
        assert pairs[:4] == [(0, 1), (0, 2), (1, 2), (0, 3)][: len(pairs)]
        near = tuple(n for n, pair in enumerate(pairs) if least_distance(trace, *pair) < 10.0)
        conflict = look.log.views[:, :, :, k.Seen._fields.index("conflict")] == 1.0
        conflict[:, look.kinds != vehicles.AVOIDS] = False
        ever = conflict.any(axis=0)
        assert look.row.lost == near
        assert look.row.alerts == tuple(n for n, (j, i) in enumerate(pairs) if ever[i, j] or ever[j, i])
        found = [recovery(look, i) for i in np.flatnonzero(look.kinds == vehicles.AVOIDS)]
        longest = None if None in found else max(found)
        assert look.row.recovery_s == (None if longest is None else pytest.approx(longest, abs=1e-3))
        assert bool(look.row.lost) == (look.row.severity > 0.0)
        assert msgspec.json.decode(msgspec.json.encode(look.row), type=Row) == look.row
        lost, alerts, times = lost + len(near), alerts + len(look.row.alerts), [*times, longest]
    assert alerts > 0
    if cell is CELLS[0]:
        assert lost > 0  # a liar is not avoided at its true position
        assert any(t is not None and t > 1.0 for t in times)
    if cell is CELLS[2]:
        assert None in times  # it stays behind its timed point


def test_every_pair_has_its_number():
    """Four aircraft meet in one place, and each pair loses separation in some flight."""
    cell = Cell(generator="circle", aircraft=4, law="none")
    rows = campaign.fly(cell, range(1, 20))
    assert set(itertools.chain(*(row.lost for row in rows))) == set(range(6))


@pytest.mark.parametrize("broken", [math.nan, math.inf])
def test_aircraft_whose_positions_are_no_numbers_count_as_lost(broken):
    before = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    position = before.copy()
    position[1, 2] = broken
    assert outcome.least_distance2(before, before, 0, 1) == pytest.approx(100.0**2)
    assert outcome.least_distance2(position, before, 0, 1) == 0.0
