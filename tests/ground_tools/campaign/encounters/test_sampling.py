"""The samples of each variable agree with the model's counts, and tracks agree with their rates.

Each comparison is a chi-square test at the level 0.0005 with fixed seeds. Samplers with deliberate faults
show that the tests can fail.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from ground_tools.campaign.encounters import sampling
from ground_tools.campaign.encounters.model import (
    CLASS,
    DYNAMIC,
    LAYER,
    NEEDED,
    OPTIONAL,
    SPEED,
    TURN,
    parse,
)
from tests.support.encounter_models import NAMES, ROTORCRAFT, TINY, model_of

LEVEL_Z = 3.29
"""One-sided normal quantile of the level 0.0005."""
LEAST_EXPECTED = 5.0
MODELS = ("tiny", *NAMES)


def chi_square_z(observed, expected):
    """Chi-square statistic of tables of counts, one row for each distribution, as a normal quantile (Wilson
    and Hilferty, 1931). Cells of less than `LEAST_EXPECTED` are pooled within their row."""
    statistic, freedom = 0.0, 0
    for seen, wanted in zip(observed, expected, strict=True):
        small = wanted < LEAST_EXPECTED
        cells = [*zip(seen[~small], wanted[~small], strict=True)]
        rest = seen[small].sum(), wanted[small].sum()
        if rest[1] >= LEAST_EXPECTED:
            cells.append(rest)
        elif rest[0] > 0 and rest[1] == 0.0:
            return math.inf  # a bin that was never observed
        elif cells and rest[1] > 0.0:
            cells[-1] = cells[-1][0] + rest[0], cells[-1][1] + rest[1]
        if len(cells) > 1:
            statistic += sum((a - b) ** 2 / b for a, b in cells)
            freedom += len(cells) - 1
    assert freedom > 0, "too few samples for a test"
    share = 2.0 / (9.0 * freedom)
    return float(((statistic / freedom) ** (1.0 / 3.0) - (1.0 - share)) / math.sqrt(share))


def table(variable, parents, bins):
    """Observed counts of a variable for each combination of its parents, and the expected ones.

    Args:
        parents: shape (samples, variables of the network): all bins.
        bins: shape (samples,): the drawn ones.
    """
    rows = np.zeros(len(bins), np.int64)
    for parent, stride in zip(variable.parents, variable.strides, strict=True):
        rows += stride * parents[:, parent]
    observed = np.zeros_like(variable.counts)
    np.add.at(observed, (rows, bins), 1.0)
    sums = variable.counts.sum(axis=1)
    some = sums > 0.0
    share = variable.counts[some] / sums[some][:, None]
    return observed[some], share * observed[some].sum(axis=1)[:, None]


def drawn_initial(model, count):
    rng = np.random.default_rng(1)
    return np.array([sampling.draw_initial(rng, model) for _ in range(count)])


def drawn_pairs(model, tracks, seconds=120):
    """Bins of the transition network of consecutive seconds: (samples, variables)."""
    rng, found = np.random.default_rng(2), []
    n = len(model.initial)
    later = [i for i, _ in sorted(model.next_order)]
    at_t = [j for _, j in sorted(model.next_order)]
    for _ in range(tracks):
        first = sampling.draw_initial(rng, model)
        start = [sampling.draw_value(rng, model, i, bin_) for i, bin_ in enumerate(first)]
        bins, _ = sampling.states(rng, model, first, start, seconds)
        pairs = np.zeros((seconds - 1, len(model.next)), np.int64)
        pairs[:, :n], pairs[:, later] = bins[:-1], bins[1:][:, at_t]
        found.append(pairs)
    assert n == min(later)
    return np.concatenate(found)


@pytest.mark.parametrize("name", MODELS)
def test_initial_variables_agree_with_the_counts(name):
    model = model_of(name)
    bins = drawn_initial(model, 20_000)
    for i, variable in enumerate(model.initial):
        z = chi_square_z(*table(variable, bins, bins[:, i]))
        assert z < LEVEL_Z, f"{variable.label} given its parents"
        share = variable.counts.sum(axis=0) / variable.counts.sum()
        if name != "tiny":  # the counts of the small model do not come from a common sample
            z = chi_square_z([np.bincount(bins[:, i], minlength=variable.bins)], [len(bins) * share])
            assert z < LEVEL_Z, variable.label


@pytest.mark.parametrize("name", NAMES)
def test_the_tests_cover_every_variable_of_a_published_file(name):
    """There are seven variables, or five without region and class; three of them are dynamic."""
    model = model_of(name)
    labels = [variable.label for variable in model.initial]
    assert set(labels) - set(OPTIONAL) == set(NEEDED)
    assert len(labels) in (5, 7)
    assert {labels[at_t] for _, at_t in model.next_order} == set(DYNAMIC)
    assert all(model.next[later] is not None for later, _ in model.next_order)


@pytest.mark.parametrize("name", MODELS)
def test_transitions_agree_with_the_counts(name):
    model = model_of(name)
    pairs = drawn_pairs(model, 400)
    for later, _ in model.next_order:
        variable = model.next[later]
        z = chi_square_z(*table(variable, pairs, pairs[:, later]))
        assert z < LEVEL_Z, variable.label


@pytest.mark.parametrize("name", ["tiny", ROTORCRAFT])
def test_a_sampler_that_takes_the_last_parent_as_the_fastest_fails_the_tests(name):
    model = model_of(name)

    def slow_first(variable, bins):
        sizes = [bins[p] for p in variable.parents]
        strides = tuple(math.prod(sizes[i + 1 :]) for i in range(len(sizes)))
        return dataclasses.replace(variable, strides=strides)

    bins = [v.bins for v in model.initial]
    wrong = dataclasses.replace(model, initial=tuple(slow_first(v, bins) for v in model.initial))
    if name != "tiny":  # in that model no initial variable has two parents
        try:
            found = drawn_initial(wrong, 20_000)
        except ValueError:
            pass  # it even draws a combination that was never observed
        else:
            zs = [
                chi_square_z(*table(v, found, found[:, i])) for i, v in enumerate(model.initial) if v.parents
            ]
            assert max(zs) > LEVEL_Z
    later_bins = [*bins, *(model.initial[j].bins for _, j in sorted(model.next_order))]
    strides = model.tables.strides.copy()
    for row, (later, _) in enumerate(model.next_order):
        swapped = slow_first(model.next[later], later_bins).strides
        strides[row, : len(swapped)] = swapped
    wrong = dataclasses.replace(model, tables=model.tables._replace(strides=strides))
    pairs = drawn_pairs(wrong, 400)
    zs = [chi_square_z(*table(model.next[i], pairs, pairs[:, i])) for i, _ in model.next_order]
    assert max(zs) > LEVEL_Z


@pytest.mark.parametrize("name", ["tiny", ROTORCRAFT])
def test_a_sampler_whose_counts_are_off_by_a_quarter_fails_the_tests(name):
    model = model_of(name)
    first = model.initial[model.at(SPEED)]
    counts = first.counts * np.linspace(0.75, 1.25, first.bins)
    wrong_one = dataclasses.replace(first, cumulative=np.cumsum(counts, axis=1).tolist())
    initial = tuple(wrong_one if v is first else v for v in model.initial)
    bins = drawn_initial(dataclasses.replace(model, initial=initial), 20_000)
    assert chi_square_z(*table(first, bins, bins[:, model.at(SPEED)])) > LEVEL_Z


@pytest.mark.parametrize("name", MODELS)
def test_values_are_uniform_within_their_bin_and_zero_in_the_bin_of_zero(name):
    model = model_of(name)
    rng = np.random.default_rng(3)
    for i, edges in enumerate(model.boundaries):
        label = model.initial[i].label
        if edges is None:
            assert label in OPTIONAL  # a region or a class is a number, not a range
            assert sampling.draw_value(rng, model, i, 2) == 3.0
            continue
        for bin_ in range(len(edges) - 1):
            found = np.array([sampling.draw_value(rng, model, i, bin_) for _ in range(2000)])
            if model.zero_bins[i] == bin_:
                assert not found.any()
                continue
            share = (found - edges[bin_]) / (edges[bin_ + 1] - edges[bin_])
            seen, _ = np.histogram(share, bins=10, range=(0.0, 1.0))
            assert seen.sum() == len(found)
            assert chi_square_z([seen], [np.full(10, 200.0)]) < LEVEL_Z, (label, bin_)


@pytest.mark.parametrize("name", MODELS)
def test_a_value_is_drawn_anew_within_its_bin_as_often_as_the_file_says(name):
    """The value always lies in the bin of its second."""
    model = model_of(name)
    rng = np.random.default_rng(4)
    tables = model.tables
    held, anew = np.zeros(len(tables.at_t)), np.zeros(len(tables.at_t))
    for _ in range(200):
        first = sampling.draw_initial(rng, model)
        start = [sampling.draw_value(rng, model, i, bin_) for i, bin_ in enumerate(first)]
        bins, values = sampling.states(rng, model, first, start, 120)
        for d, i in enumerate(tables.at_t):
            low, high = tables.edges[d, bins[:, i]], tables.edges[d, bins[:, i] + 1]
            zero = bins[:, i] == tables.zero_bin[d]
            assert ((low <= values[:, d]) & (values[:, d] <= high)).all()
            assert not values[zero, d].any()
            same = (bins[1:, i] == bins[:-1, i]) & ~zero[1:]
            held[d] += same.sum()
            anew[d] += (values[1:, d] != values[:-1, d])[same].sum()
    for d, i in enumerate(tables.at_t):
        rate = model.resample_rates[i]
        z = abs(anew[d] - rate * held[d]) / math.sqrt(held[d] * rate * (1.0 - rate))
        assert z < LEVEL_Z, (model.initial[i].label, anew[d] / held[d])


@pytest.mark.parametrize("name", MODELS)
def test_tracks_begin_in_the_lowest_layer_and_keep_their_limits(name):
    model = model_of(name)
    rng = np.random.default_rng(5)
    used = 0
    for _ in range(200):
        first = sampling.draw_lowest(rng, model)
        airspace = model.index(CLASS)
        assert first[model.at(LAYER)] == 0
        assert airspace is None or first[airspace] == 3
        course = sampling.draw_course(rng, model, 60)
        if course is not None:
            used += 1
            top = model.bounds(SPEED)[-1] * sampling.KNOT_MPS
            assert (course.speeds >= sampling.LEAST_SPEED_MPS).all()
            assert (course.speeds <= top).all()
            assert course.speeds[0] > abs(course.rates[0, 1])
    assert used > 60


def test_the_limits_of_the_small_model():
    model = model_of("tiny")
    found = sampling.limits(model, [0, 1, 1, 1, 1])
    assert found.least_mps == pytest.approx(sampling.LEAST_SPEED_MPS)  # the lowest bin begins at 0 kt
    assert found.most_mps == pytest.approx(120.0 * 1852.0 / 3600.0)
    assert found.climb_mps == pytest.approx(1000.0 * 0.3048 / 60.0)
    # In the upper layer the lowest speed was never observed.
    assert sampling.limits(model, [1, 1, 1, 1, 1]).least_mps == pytest.approx(40.0 * 1852.0 / 3600.0)


@pytest.mark.parametrize(
    ("name", "speeds", "turns"),
    [
        (ROTORCRAFT, (13, 38, 68), (0, 5, 8)),
        ("uncor_1200only_fwse_v1p2", (25, 40, 59), None),
        ("uncor_1200only_fwme_v1p2", (32, 49, 74), None),
        ("paraglider_v1", (3, 8, 13), (11, 17, 18)),
        ("glider_v1", (3, 33, 60), None),
    ],
)
def test_speeds_and_turns_agree_with_another_reader(name, speeds, turns):
    """The 5th, 50th and 95th percentile of 300 tracks that another reader drew. The tolerance of a percentile
    is three standard errors of 300 draws, half of the last digit, and a tenth for our own draws."""
    model = model_of(name)
    rng = np.random.default_rng(6)
    first = [sampling.draw_lowest(rng, model) for _ in range(3000)]
    at = model.at(SPEED)
    found = [sampling.draw_value(rng, model, at, bins[at]) * sampling.KNOT_MPS for bins in first]
    within(found, speeds)
    if turns is not None:
        greatest = []
        for bins in first[:600]:
            start = [sampling.draw_value(rng, model, i, bin_) for i, bin_ in enumerate(bins)]
            _, values = sampling.states(rng, model, bins, start, 180)
            d = model.tables.at_t.tolist().index(model.at(TURN))
            greatest.append(np.abs(values[:, d]).max())
        within(greatest, turns)


def within(found, wanted):
    for share, value in zip((0.05, 0.5, 0.95), wanted, strict=True):
        error = 3.0 * math.sqrt(share * (1.0 - share) / 300.0)
        low, high = np.quantile(found, [max(share - error, 0.0), min(share + error, 1.0)])
        assert low - 0.6 <= value <= high + 0.6, (share, low, high)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("1 8 1 3 4 3 4 2 4", "1 0 1 3 0 3 4 2 4", "nearly always climbs faster than it flies"),
        ("# N_initial\n30 10", "# N_initial\n0 40", "hardly ever draws its lowest altitude layer"),
        ("1 6 3 0 2 8", "0 0 0 0 2 8", "has no counts of v for bins of its parents"),
    ],
)
def test_a_model_that_cannot_be_drawn_from_is_named(before, after, said, monkeypatch):
    text = TINY.read_text()
    assert text.count(before) == 1
    text = text.replace(before, after).replace("0 40 80 120", "0 0.1 0.2 0.3")
    monkeypatch.setattr(sampling, "_MOST_TRIES", 50)
    model = parse(text, "tiny", "")

    def draw_many():
        for seed in range(200):
            sampling.draw_course(np.random.default_rng(seed), model, 10)

    with pytest.raises(ValueError, match=said):
        draw_many()


def test_a_steady_turn_is_a_circle():
    rate = math.radians(6.0)
    course = sampling.Course(np.full(61, 30.0), np.tile([0.0, 3.0, rate], (60, 1)))
    position, velocity = sampling.integrated(course, 0.1)
    assert position.shape == velocity.shape == (601, 3)
    level = math.sqrt(30.0**2 - 3.0**2)
    radius = level / rate
    np.testing.assert_allclose(np.hypot(position[:, 0], position[:, 1] - radius), radius, rtol=1e-4)
    np.testing.assert_allclose(position[-1], [0.0, 0.0, -180.0], atol=0.02)  # a full turn in 60 s
    np.testing.assert_allclose(np.hypot(velocity[:, 0], velocity[:, 1]), level)
    assert position[150, 1] > 0.0  # a positive turn rate turns to the right


def test_a_steady_acceleration():
    course = sampling.Course(10.0 + 0.5 * np.arange(11), np.tile([0.5, 0.0, 0.0], (10, 1)))
    position, velocity = sampling.integrated(course, 0.1)
    np.testing.assert_allclose(position[-1], [10.0 * 10.0 + 0.25 * 100.0, 0.0, 0.0])
    np.testing.assert_allclose(velocity[-1], [15.0, 0.0, 0.0])
    np.testing.assert_allclose(np.diff(position, axis=0) / 0.1, 0.5 * (velocity[1:] + velocity[:-1]))
