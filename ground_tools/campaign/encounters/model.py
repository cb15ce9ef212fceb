"""Reads the parameter files of MIT Lincoln Laboratory's encounter models (em-model-manned-bayes).

A file describes a dynamic Bayesian network of one aircraft in two parts. The initial network draws the region
G, airspace class A, altitude layer L, airspeed v, acceleration, vertical rate and turn rate; the transition
network redraws the last three every second. Each part has its labels, its graph (row = parent), the number
of bins of each variable, and the counts with which they were observed. The format is that of `em_read.m` in
that repository (MIT Lincoln Laboratory, BSD 2-Clause; project report ATC-345).
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import Floats, Integers
from companion.errors import ConfigError

REGION, CLASS, LAYER, SPEED = "G", "A", "L", "v"
ACCELERATION, CLIMB, TURN = r"\dot v", r"\dot h", r"\dot \psi"
DYNAMIC: Final = (ACCELERATION, CLIMB, TURN)
NEEDED: Final = (LAYER, SPEED, *DYNAMIC)
OPTIONAL: Final = (REGION, CLASS)
SECTIONS: Final = (
    "labels_initial", "G_initial", "r_initial", "N_initial", "labels_transition", "G_transition",
    "r_transition", "N_transition", "boundaries", "resample_rates",
)  # fmt: skip
_LARGEST_FILE: Final = 16_000_000
"""Largest accepted file, bytes."""
_MOST_BINS: Final = 100
_MOST_COUNTS: Final = 2_000_000
"""Most numbers in a section `N_...`."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable of a network, given its parents. Bins are numbered from 0."""

    label: str
    bins: int
    parents: tuple[int, ...]
    """Indices of the parents among the network's variables, rising."""
    strides: tuple[int, ...]
    """The row of a combination of the parents' bins is `sum(stride * bin)`. The first parent's bin varies
    fastest."""
    counts: Floats
    """(combinations of the parents' bins, bins)."""
    cumulative: list[list[float]]
    """Cumulative sums of the rows of `counts`."""


class Tables(NamedTuple):
    """The transition network in the form that compiled code takes. Rows are the D dynamic variables in the
    order in which they are drawn."""

    later: Integers
    """(D,): index at t + 1 in the transition network."""
    at_t: Integers
    """(D,): index of the same variable at t."""
    bins: Integers
    """(D,)."""
    parents: Integers
    """(D, most parents): indices of the parents; -1 beyond the last one."""
    strides: Integers
    """(D, most parents): see `Variable.strides`."""
    first: Integers
    """(D,): where the variable's cumulative sums begin in `sums`."""
    sums: Floats
    """Cumulative sums of the counts of all dynamic variables, row by row."""
    edges: Floats
    """(D, most bins + 1): boundaries of the bins, in the file's units."""
    zero_bin: Integers
    """(D,): the bin that stands for exactly 0; -1: none."""
    rates: Floats
    """(D,): probability per second that a value is redrawn within its bin."""


@dataclass(frozen=True, slots=True)
class Model:
    """The encounter model of one file."""

    name: str
    """Name of the file, without its suffix."""
    digest: str
    """First digits of the SHA-256 of the file."""
    initial: tuple[Variable, ...]
    """Variables of the initial network."""
    order: tuple[int, ...]
    """Order in which they are drawn: parents first."""
    next: tuple[Variable | None, ...]
    """Variables of the transition network; None for the variables at t, which are given and not drawn."""
    next_order: tuple[tuple[int, int], ...]
    """Order in which the dynamic variables are drawn: index of each at t + 1, and of the same variable at
    t."""
    boundaries: tuple[tuple[float, ...] | None, ...]
    """Boundaries of the bins of each initial variable, in the file's units: kt, kt/s, ft/min, deg/s, and ft
    for layers. None: the number of the bin is the value."""
    zero_bins: tuple[int | None, ...]
    """The bin of each initial variable that stands for exactly 0; None: there is none."""
    resample_rates: tuple[float, ...]
    """Probability per second, for each initial variable, that its value is redrawn within its bin."""
    tables: Tables
    """The transition network in the form for compiled code."""

    def index(self, label: str) -> int | None:
        """Index of an initial variable; None if the model does not have it."""
        labels = [variable.label for variable in self.initial]
        return labels.index(label) if label in labels else None

    def at(self, label: str) -> int:
        """Index of an initial variable that every model has."""
        return [variable.label for variable in self.initial].index(label)

    def bounds(self, label: str) -> tuple[float, ...]:
        """Boundaries of the bins of an initial variable that has them."""
        found = self.boundaries[self.at(label)]
        assert found is not None, "checked when the file was read"
        return found


@dataclass(frozen=True, slots=True)
class _Section:
    line: int
    """Number of the line with the section's header."""
    rows: list[tuple[int, str]]
    """Lines of the section that are not empty, with their numbers."""


def read(path: Path) -> Model:
    """Read a parameter file.

    Raises:
        ConfigError: the file cannot be read, or its content is not allowed; the message names the line.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_LARGEST_FILE + 1)
        text = raw.decode("ascii")
    except OSError as error:
        raise ConfigError(f"--model: {path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"--model: {path}: byte {error.start}: not allowed; allowed: ASCII text") from error
    if len(raw) > _LARGEST_FILE:
        raise ConfigError(f"--model: {path}: too large; allowed: up to {_LARGEST_FILE:,} bytes")
    try:
        return parse(text, path.stem, hashlib.sha256(raw).hexdigest()[:12])
    except ValueError as error:
        raise ConfigError(f"--model: {path}: {error}") from error


def parse(text: str, name: str, digest: str) -> Model:
    """The model in the text of a parameter file.

    Args:
        name, digest: stored in the model.

    Raises:
        ValueError: the text is not allowed; the message names the line and what is allowed.
    """
    sections = _sections(text)
    labels = _labels(sections["labels_initial"])
    _check_labels(sections["labels_initial"], labels)
    n = len(labels)
    graph = _graph(sections["G_initial"], n)
    bins = _bins(sections["r_initial"], n)
    order = _sorted(sections["G_initial"], graph)
    initial = _variables(sections["N_initial"], labels, graph, bins, range(n))

    later = _labels(sections["labels_transition"])
    pairs = _check_transition_labels(sections["labels_transition"], labels, later)
    later_graph = _graph(sections["G_transition"], len(later))
    later_bins = _bins(sections["r_transition"], len(later))
    expected = (*bins, *(bins[i] for _, i in pairs))
    if later_bins != expected:
        raise ValueError(
            f"line {sections['r_transition'].rows[0][0]}: numbers of bins {later_bins}; "
            f"allowed: those of r_initial, then of the dynamic variables: {expected}"
        )
    later_order = _sorted(sections["G_transition"], later_graph)
    drawn = _variables(sections["N_transition"], later, later_graph, later_bins, range(n, len(later)))
    at_t = dict(pairs)
    next_order = tuple((i, at_t[i]) for i in later_order if i in at_t)
    edges = _boundaries(sections["boundaries"], labels, bins)
    rates = _rates(sections["resample_rates"], n)
    return Model(
        name=name,
        digest=digest,
        initial=tuple(v for v in initial if v is not None),
        order=order,
        next=drawn,
        next_order=next_order,
        boundaries=edges,
        zero_bins=tuple(map(_zero_bin, edges)),
        resample_rates=rates,
        tables=_tables(drawn, next_order, edges, rates),
    )


def _tables(
    drawn: Sequence[Variable | None],
    order: Sequence[tuple[int, int]],
    edges: Sequence[tuple[float, ...] | None],
    rates: Sequence[float],
) -> Tables:
    some = [(variable, at_t) for i, at_t in order if (variable := drawn[i]) is not None]
    most = max(len(variable.parents) for variable, _ in some)
    widest = max(variable.bins for variable, _ in some)
    sums = [np.cumsum(variable.counts, axis=1).ravel() for variable, _ in some]
    zero = [_zero_bin(edges[at_t]) for _, at_t in some]
    ends = [edges[at_t] or () for _, at_t in some]
    return Tables(
        later=np.array([i for i, _ in order]),
        at_t=np.array([at_t for _, at_t in order]),
        bins=np.array([variable.bins for variable, _ in some]),
        parents=np.array([[*v.parents, *[-1] * (most - len(v.parents))] for v, _ in some], np.int64),
        strides=np.array([[*v.strides, *[0] * (most - len(v.parents))] for v, _ in some], np.int64),
        first=np.cumsum([0, *map(len, sums[:-1])]),
        sums=np.concatenate(sums),
        edges=np.array([[*row, *[math.nan] * (widest + 1 - len(row))] for row in ends]),
        zero_bin=np.array([-1 if bin_ is None else bin_ for bin_ in zero]),
        rates=np.array([rates[at_t] for _, at_t in order]),
    )


def _sections(text: str) -> dict[str, _Section]:
    found: dict[str, _Section] = {}
    last: _Section | None = None
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip()
        if stripped.startswith("#"):
            title = stripped[1:].strip()
            if title not in SECTIONS:
                raise ValueError(
                    f"line {number}: section {title[:40]!r} is not known; allowed: {', '.join(SECTIONS)}"
                )
            if title in found:
                raise ValueError(
                    f"line {number}: section {title} is there twice, first in line {found[title].line}"
                )
            last = found[title] = _Section(number, [])
        elif stripped:
            if last is None:
                raise ValueError(f"line {number}: text before the first section; allowed: # {SECTIONS[0]}")
            last.rows.append((number, stripped))
    for title in SECTIONS:
        if title not in found:
            raise ValueError(f"there is no section {title}; allowed: a file with {', '.join(SECTIONS)}")
        if not found[title].rows:
            raise ValueError(f"line {found[title].line}: section {title} is empty")
    return found


def _only_row(section: _Section) -> tuple[int, str]:
    if len(section.rows) > 1:
        raise ValueError(f"line {section.rows[1][0]}: one line too many; allowed: one line in this section")
    return section.rows[0]


def _labels(section: _Section) -> tuple[str, ...]:
    _, row = _only_row(section)
    return tuple(label.strip().strip('"') for label in row.split(","))


def _check_labels(section: _Section, labels: Sequence[str]) -> None:
    if sorted(labels) not in (sorted(NEEDED), sorted([*OPTIONAL, *NEEDED])):
        raise ValueError(
            f"line {section.rows[0][0]}: variables {', '.join(labels)[:200]}; "
            f"allowed: {', '.join(NEEDED)}, with or without {' and '.join(OPTIONAL)}, each once"
        )


def _check_transition_labels(
    section: _Section, labels: Sequence[str], later: Sequence[str]
) -> tuple[tuple[int, int], ...]:
    """Pairs of indices of the dynamic variables: at t + 1 and at t."""
    dynamic = [label for label in labels if label in DYNAMIC]
    wanted = [f"{label}(t)" if label in DYNAMIC else label for label in labels]
    wanted += [f"{label}(t+1)" for label in dynamic]
    if list(later) != wanted:
        raise ValueError(
            f"line {section.rows[0][0]}: variables {', '.join(later)[:200]}; allowed: {', '.join(wanted)}"
        )
    return tuple((len(labels) + k, labels.index(label)) for k, label in enumerate(dynamic))


def _numbers(line: int, row: str, count: int, what: str) -> list[float]:
    """The numbers of a line.

    Raises:
        ValueError: there are not `count` numbers, or one is not finite.
    """
    words = row.split()
    if len(words) != count:
        raise ValueError(f"line {line}: {len(words):,} numbers; allowed: {count:,} ({what})")
    found = list(map(_number, words))
    for at, number in enumerate(found):
        if not math.isfinite(number):
            raise ValueError(
                f"line {line}: number {at + 1} is {words[at][:20]!r}; allowed: finite numbers ({what})"
            )
    return found


def _number(word: str) -> float:
    """The number that a word represents; NaN if it is not a number."""
    try:
        return float(word)
    except ValueError:
        return math.nan


def _graph(section: _Section, n: int) -> Floats:
    """(n, n): 1 where the row's variable is a parent of the column's."""
    if len(section.rows) != n:
        raise ValueError(
            f"line {section.line}: {len(section.rows)} lines; allowed: {n}, one for each variable"
        )
    rows = []
    for line, row in section.rows:
        numbers = _numbers(line, row, n, "one for each variable")
        if not set(numbers) <= {0.0, 1.0}:
            raise ValueError(f"line {line}: allowed: 0 and 1")
        rows.append(numbers)
    return np.array(rows)


def _sorted(section: _Section, graph: Floats) -> tuple[int, ...]:
    """All variables of a graph, parents first and otherwise in the order of the file."""
    order: list[int] = []
    while len(order) < len(graph):
        ready = [
            i for i in range(len(graph)) if i not in order and set(np.flatnonzero(graph[:, i])) <= set(order)
        ]
        if not ready:
            raise ValueError(f"line {section.line}: the graph has a circle; allowed: a graph without one")
        order.append(ready[0])
    return tuple(order)


def _bins(section: _Section, n: int) -> tuple[int, ...]:
    line, row = _only_row(section)
    numbers = _numbers(line, row, n, "one for each variable")
    if not all(number == int(number) and 1 <= number <= _MOST_BINS for number in numbers):
        raise ValueError(f"line {line}: allowed: whole numbers of bins from 1 to {_MOST_BINS}")
    return tuple(int(number) for number in numbers)


def _variables(
    section: _Section, labels: Sequence[str], graph: Floats, bins: Sequence[int], drawn: range
) -> tuple[Variable | None, ...]:
    """The variables of a network; None for those that are not `drawn`, because they have no counts."""
    line, row = _only_row(section)
    parents = [tuple(np.flatnonzero(graph[:, i]).tolist()) for i in range(len(labels))]
    sizes = {i: (math.prod(bins[p] for p in parents[i]), bins[i]) for i in drawn}
    total = sum(rows * columns for rows, columns in sizes.values())
    if total > _MOST_COUNTS:
        raise ValueError(f"line {section.line}: {total:,} counts; allowed: at most {_MOST_COUNTS:,}")
    numbers = np.array(_numbers(line, row, total, "counts, by the graph and the numbers of bins"))
    if (numbers < 0.0).any():
        at = int(np.argmax(numbers < 0.0))
        raise ValueError(f"line {line}: number {at + 1} is {numbers[at]:g}; allowed: counts from 0")
    found: list[Variable | None] = []
    begin = 0
    for i, label in enumerate(labels):
        if i not in sizes:
            found.append(None)
            continue
        rows, columns = sizes[i]
        counts = numbers[begin : begin + rows * columns].reshape(rows, columns)
        begin += rows * columns
        if not counts.any():
            raise ValueError(f"line {line}: no counts of {label}; allowed: at least one above 0")
        strides = tuple(itertools.accumulate((bins[p] for p in parents[i][:-1]), initial=1, func=int.__mul__))
        found.append(
            Variable(
                label=label,
                bins=bins[i],
                parents=parents[i],
                strides=strides if parents[i] else (),
                counts=counts,
                cumulative=np.cumsum(counts, axis=1).tolist(),
            )
        )
    return tuple(found)


def _boundaries(
    section: _Section, labels: Sequence[str], bins: Sequence[int]
) -> tuple[tuple[float, ...] | None, ...]:
    if len(section.rows) != len(labels):
        raise ValueError(
            f"line {section.line}: {len(section.rows)} lines; allowed: {len(labels)}, one for each variable"
        )
    found: list[tuple[float, ...] | None] = []
    for (line, row), label, count in zip(section.rows, labels, bins, strict=True):
        if row == "*":
            if label in NEEDED:
                raise ValueError(f"line {line}: * for {label}; allowed: the boundaries of its bins")
            found.append(None)
            continue
        numbers = _numbers(line, row, count + 1, f"boundaries of {count} bins of {label}")
        if not all(a < b for a, b in itertools.pairwise(numbers)):
            raise ValueError(f"line {line}: allowed: rising boundaries")
        if label in (LAYER, SPEED) and numbers[0] < 0.0:
            raise ValueError(f"line {line}: allowed: boundaries of {label} from 0")
        found.append(tuple(numbers))
    return tuple(found)


def _zero_bin(edges: tuple[float, ...] | None) -> int | None:
    """The bin with 0 strictly inside, as in `extract_zero_bins` of em_read.m."""
    if edges is None:
        return None
    return next((i for i, (a, b) in enumerate(itertools.pairwise(edges)) if a < 0.0 < b), None)


def _rates(section: _Section, n: int) -> tuple[float, ...]:
    line, row = _only_row(section)
    numbers = _numbers(line, row, n, "one for each variable")
    if not all(0.0 <= number <= 1.0 for number in numbers):
        raise ValueError(f"line {line}: allowed: rates from 0 to 1")
    return tuple(numbers)
