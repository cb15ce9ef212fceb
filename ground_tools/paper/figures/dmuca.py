"""Figures "UAV trajectories and conflict avoidance performance using the DMUCA framework" and "Impact of
transmission delays on UAV collision avoidance performance", with the paper's law and with ours.

The paper shows one flight for each delay and does not give the paths. Its statements are therefore checked
for many flights.
"""

from __future__ import annotations

from collections import Counter
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats, Integers
from ground_tools.campaign.cells import LAWS, SEPARATION_M, Law
from ground_tools.campaign.outcome import COLLISION_M
from ground_tools.common.intervals import wilson
from ground_tools.paper.figures.dmuca_flights import (
    BOX_M,
    CASES,
    DELAYS_S,
    IN,
    PAIRS,
    SPEED_MPS,
    Case,
    Table,
    conflicts_in_the_box,
    table_of,
)
from ground_tools.paper.report import Numbers, Report, Statement, Value

PUBLISHED_BELOW: Final = dict(zip(DELAYS_S, (0, 2, 6), strict=True))
"""Published number of pairs, of ten, that come nearer than 10 m, by delay."""
PUBLISHED_LEAST: Final = dict(zip(DELAYS_S, ("> 10", "9.75", "> 2"), strict=True))
"""Published least separation (m) of all pairs, by delay. With delays of 1 to 2 s, the other pair below 10 m
keeps 9.94 m."""
NAMES: Final[dict[Law, str]] = {"paper": "paper's law", "dmuca": "ours"}
PAIR_NAMES: Final = tuple(f"UAV{i + 1}-UAV{j + 1}" for i, j in PAIRS)


def report(samples: int, seed: int) -> Report:
    """The statements and numbers of the figures.

    Args:
        samples: number of flights by each law with each delay, limited by `table_of`.
        seed: seed of the first flight, whose pairs are listed.
    """
    table = table_of(samples, seed)
    flights = len(table[CASES[0]])
    box = " x ".join(f"{side:g}" for side in BOX_M)
    paper, noisy = LAWS["paper"], IN["noisy"]
    return Report(
        title="DMUCA: separation of five aircraft under random message delays",
        notes=(
            "Paths: S2, five straight paths of 500 s through a ball of 8 m at 250 s, at most "
            f"{SPEED_MPS:g} m/s. The paper gives no paths but a box of {box} m in which they converge. Of "
            f"{flights} draws with crossing points anywhere in the box, "
            f"{conflicts_in_the_box(flights, seed)} come below {SEPARATION_M:g} m without avoidance.",
            "paper: the paper's law. The paper gives no parameters; these kept most pairs apart among "
            f"those tried: horizon {paper.horizon_s:g} s, a decision every {paper.period_s:g} s, recovery "
            f"after {paper.n_noncollide} decisions without conflict, T {paper.recovery_time_s:g} s. "
            "dmuca: our law, the default in flight. none: no avoidance.",
            "exact: the sent values are true; the paper mentions no errors. noisy: GNSS errors of "
            f"{noisy.sigma_m:g} m, velocity errors of {noisy.sigma_mps:g} m/s, and quantised messages.",
            f"Statements are checked for each of {flights} exact flights (seeds from {seed} on). Two and six "
            "pairs are checked literally, so that keeping more pairs apart also counts as a failure.",
        ),
        statements=tuple(s for law in ("paper", "dmuca") for s in statements(table, law, seed)),
        numbers=(shares(table), pairs(table, seed)),
    )


def statements(table: Table, law: Law, seed: int) -> list[Statement]:
    """The paper's statements about the figures, checked for a law's flights without navigation errors."""
    least = [table[Case(law, delay_s, "exact")].min(axis=1) for delay_s in DELAYS_S]
    below = [_below(table[Case(law, delay_s, "exact")]) for delay_s in DELAYS_S]

    def asked(words: str, ours: str, holds: Bools) -> Statement:
        checks = {f"seed {number}": bool(one) for number, one in enumerate(holds, seed)}
        return Statement(f"{NAMES[law]}: {words}", ours, checks)

    means = [float(counts.mean()) for counts in below]
    return [
        asked("[0, 1] s: all pairs above 10 m", _least(least[0]), least[0] > SEPARATION_M),
        asked("[1, 2] s: two pairs below 10 m", _counted(below[1]), below[1] == PUBLISHED_BELOW[DELAYS_S[1]]),
        asked("[2, 3] s: six pairs below 10 m", _counted(below[2]), below[2] == PUBLISHED_BELOW[DELAYS_S[2]]),
        asked("[2, 3] s: all pairs above 2 m", _least(least[2]), least[2] > COLLISION_M),
        Statement(
            f"{NAMES[law]}: more pairs below 10 m with more delay",
            ", ".join(f"{mean:.2f}" for mean in means) + " pairs per flight",
            {
                f"from {interval(DELAYS_S[i])} to {interval(DELAYS_S[i + 1])} s": means[i + 1] > means[i]
                for i in range(len(means) - 1)
            },
        ),
    ]


def _below(least_m: Floats) -> Integers:
    """Number of pairs below the required separation, for each flight."""
    return np.asarray((least_m < SEPARATION_M).sum(axis=1), dtype=np.int64)


def _least(least_m: Floats) -> str:
    return f"least {least_m.min():.2f} m, median {np.median(least_m):.2f} m"


def _counted(below: Integers) -> str:
    """Text that gives, for each number of pairs below the required separation, the number of flights."""
    counts = sorted(Counter(int(count) for count in below).items())
    return ", ".join(f"{pairs}: {flights}" for pairs, flights in counts) + " (pairs: flights)"


def shares(table: Table) -> Numbers:
    """Table of all flights of each case, next to the paper's single flight."""
    rows: list[dict[str, Value]] = []
    for case in CASES:
        least, below = table[case].min(axis=1), _below(table[case])
        above = int((least > SEPARATION_M).sum())
        low, high = wilson(above, len(least))
        avoids = case.law != "none"
        rows.append(
            {
                "law": case.law,
                "air": case.air,
                "delay_s": case.delay_s if avoids else None,
                "flights": len(least),
                "above": above,
                "share_percent": (round(100.0 * low), round(100.0 * high)),
                "pairs_below": float(below.mean()),
                "published_pairs_below": PUBLISHED_BELOW[case.delay_s] if avoids else None,
                "least_m": float(least.min()),
                "published_least": PUBLISHED_LEAST[case.delay_s] if avoids else None,
                "median_least_m": float(np.median(least)),
            }
        )
    columns = {
        "law": "law",
        "air": "air",
        "delay_s": "delay\ns",
        "above": "all\n>10 m",
        "share_percent": "95 %:\n%",
        "pairs_below": "pairs\n<10 m",
        "published_pairs_below": "pub.",
        "least_m": "least\nm",
        "published_least": "pub.",
        "median_least_m": "median\nm",
    }
    title = (
        f"{len(table[CASES[0]])} flights: number with all pairs above 10 m, mean number of pairs below 10 m, "
        "least separation, and median of the flights' least separations. 95 %: interval of the share. "
        "pub.: the paper's one flight."
    )
    return Numbers(title, columns, tuple(rows))


def pairs(table: Table, seed: int) -> Numbers:
    """Table of the least separation of each pair in the first flight, without errors."""
    cases = {
        "none_m" if case.law == "none" else f"{case.law}_{case.delay_s[0]:g}_{case.delay_s[1]:g}_m": case
        for case in CASES
        if case.air == "exact"
    }
    heads = {
        key: case.law if case.law == "none" else f"{case.law}\n{interval(case.delay_s)}"
        for key, case in cases.items()
    }
    rows: list[dict[str, Value]] = [
        {"pair": name, **{key: float(table[case][0, index]) for key, case in cases.items()}}
        for index, name in enumerate(PAIR_NAMES)
    ]
    title = (
        f"The flight of seed {seed}, exact: least separation of each pair in m. The aircraft are not those "
        "of the paper's UAV1-UAV3 (9.75 m at [1, 2] s) and UAV2-UAV3 (9.94 m)."
    )
    return Numbers(title, {"pair": "pair", **heads}, tuple(rows))


def interval(delay_s: tuple[float, float]) -> str:
    """Text of a delay interval in the paper's notation."""
    return f"[{delay_s[0]:g}, {delay_s[1]:g}]"
