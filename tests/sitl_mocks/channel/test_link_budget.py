"""Ranges as the paper states them, symmetric links, and the search for neighbours."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from sitl_mocks.channel.link_budget import (
    Links,
    all_links,
    draw_positions,
    near_links,
    path_loss_db,
    ranges_m,
    reached,
    thresholds_db,
)
from sitl_mocks.channel.parameters import ChannelParameters

PAPER = ChannelParameters()
SHADOWED = msgspec.structs.replace(
    PAPER, propagation=msgspec.structs.replace(PAPER.propagation, shadowing_sigma_db=6.0**0.5)
)


def test_ranges_of_the_paper():
    # Stated: up to 250, 1,000 and 2,000 m.
    assert ranges_m(PAPER) == pytest.approx([252.6, 941.5, 2263.4], abs=0.1)


def test_reach_ends_at_the_range():
    for mode, limit in enumerate(ranges_m(PAPER)):
        positions = np.array([[0.0, 0.0, 0.0], [limit - 0.01, 0.0, 0.0], [0.0, limit + 0.01, 0.0]])
        links = all_links(positions, PAPER.propagation)
        heard = reached(links, PAPER)[:, mode]
        pairs = dict(
            zip(zip(links.transmitter.tolist(), links.receiver.tolist(), strict=True), heard, strict=True)
        )
        assert pairs[0, 1]
        assert pairs[1, 0]
        assert not pairs[0, 2]


def test_a_loss_of_just_the_threshold_is_heard():
    limits = thresholds_db(PAPER)
    assert limits.tolist() == [103.0, 115.0, 123.0]
    links = Links(2, np.zeros(3, np.intp), np.ones(3, np.intp), limits)
    assert np.array_equal(reached(links, PAPER), np.tri(3).T.astype(bool))


def test_loss_grows_by_21_db_a_decade_and_stays_finite_at_no_distance():
    loss = path_loss_db(np.array([0.0, 1.0, 10.0, 100.0]), PAPER.propagation)
    assert loss[1:] == pytest.approx([52.55, 73.55, 94.55])
    assert np.isfinite(loss[0])


def test_links_are_symmetric_also_under_shadowing():
    rng = np.random.default_rng(1)
    links = all_links(draw_positions(3, 6, 500.0, rng), SHADOWED.propagation, rng)
    assert len(links.transmitter) == 3 * 6 * 5
    loss = {(a, b): x for a, b, x in zip(links.transmitter, links.receiver, links.path_loss_db, strict=True)}
    assert len(loss) == 90
    assert all(loss[a, b] == loss[b, a] for a, b in loss)
    assert all(a // 6 == b // 6 for a, b in loss)  # nobody hears another environment


def test_shadowing_has_the_deviation_that_is_asked():
    rng = np.random.default_rng(2)
    positions = draw_positions(2000, 5, 1000.0, rng)
    plain = all_links(positions, PAPER.propagation).path_loss_db
    shadow = all_links(positions, SHADOWED.propagation, rng).path_loss_db - plain
    drawn = shadow[: len(shadow) // 2]
    n = len(drawn)
    assert abs(drawn.mean()) < 4.0 * 6.0**0.5 / n**0.5
    assert abs(drawn.std() - 6.0**0.5) < 4.0 * 6.0**0.5 / (2 * n) ** 0.5


def test_shadowing_without_a_generator_is_refused():
    with pytest.raises(ValueError, match="shadowing needs a random generator"):
        all_links(np.zeros((2, 3)), SHADOWED.propagation)


@pytest.mark.parametrize("shape", [(4,), (4, 2), (2, 4, 2), (2, 2, 4, 3)])
def test_positions_of_another_shape_are_refused(shape):
    with pytest.raises(ValueError, match="positions have shape"):
        all_links(np.zeros(shape), PAPER.propagation)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_positions_that_are_nowhere_are_refused(bad):
    positions = np.zeros((2, 3, 3))
    positions[1, 2, 0] = bad
    with pytest.raises(ValueError, match="a position is not finite"):
        all_links(positions, PAPER.propagation)
    pytest.importorskip("scipy")
    with pytest.raises(ValueError, match="must be finite"):
        near_links(positions[1], PAPER)


def test_the_search_finds_every_link_that_carries():
    pytest.importorskip("scipy")
    positions = draw_positions(1, 300, 12_000.0, np.random.default_rng(3))[0]
    every, near = all_links(positions, PAPER.propagation), near_links(positions, PAPER)
    carries = reached(every, PAPER).any(axis=1)

    def rows(links, mask):
        found = zip(
            links.transmitter[mask], links.receiver[mask], links.path_loss_db[mask].round(9), strict=True
        )
        return sorted((int(a), int(b), float(x)) for a, b, x in found)

    assert 0 < carries.sum() < len(carries) / 4
    assert rows(near, np.ones(len(near.transmitter), bool)) == rows(every, carries)


def test_the_search_looks_further_where_there_is_shadowing():
    pytest.importorskip("scipy")
    positions = draw_positions(1, 300, 12_000.0, np.random.default_rng(3))[0]
    distance_m = np.linalg.norm(positions[:, None] - positions[None], axis=2)[np.triu_indices(300, k=1)]
    furthest_m = ranges_m(PAPER).max() * 10.0 ** (4.0 * 6.0**0.5 / 21.0)
    near = near_links(positions, SHADOWED, np.random.default_rng(4))
    assert len(near.transmitter) == 2 * (distance_m <= furthest_m).sum()
    assert (distance_m > furthest_m).sum() > 0
    carries = reached(near, SHADOWED).any(axis=1)
    apart_m = np.linalg.norm(positions[near.transmitter] - positions[near.receiver], axis=1)
    assert apart_m[carries].max() > 1.2 * ranges_m(PAPER).max()


def test_positions_fill_the_box():
    drawn = draw_positions(200, 50, 100.0, np.random.default_rng(4)).reshape(-1, 3)
    assert (drawn.min(axis=0) >= [0.0, 0.0, 30.0]).all()
    assert (drawn.max(axis=0) <= [100.0, 100.0, 120.0]).all()
    assert drawn.mean(axis=0) == pytest.approx([50.0, 50.0, 75.0], abs=2.0)
