"""Costs of all methods at each set of positions, and what follows from them: means, intervals and the tail.

A mean over squares can hide places where a policy is far behind, and rests on a few places in wide squares,
where few pairs of aircraft are near each other. So the advantage over the best fixed mode has an interval
(bootstrap over the places of each square), and the places where the policy is behind are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from companion.arrays import Bools, Floats
from companion.atmc.actions import Action
from ground_tools.atmc.env.world import SIDES_M
from ground_tools.common.intervals import DRAWS, wilson

DENSITIES: Final = {"high": SIDES_M[:3], "low": SIDES_M[3:], "dynamic": SIDES_M}
BEHIND: Final = 0.05
"""A place counts as worse if the policy's cost exceeds that of the best fixed mode by more than this."""
LEAST_WEIGHT: Final = 1e-3
"""Places with less weight are not counted as worse: nobody there could soon be in conflict with anybody."""
LEAST_PLACES: Final = 30
"""Fewest places in each square for an interval. With 2, 5 and 12 places the bootstrap's 95 % intervals hold
the true value in 61 to 72, 80 to 86 and 85 to 90 % of the cases."""
_METHODS: Final = ("policy", "rule", "search")
_SEED: Final = 1


@dataclass(frozen=True, slots=True)
class Square:
    """Costs (s) in one square."""

    cost: dict[str, Floats]
    """For the policy, the rule and the search, each of shape (places,)."""
    fixed: Floats
    """For each fixed action, shape (actions, places)."""
    weight: Floats
    """What a cost is divided by, shape (places,)."""

    def ms(self, cost: Floats) -> Floats:
        """Mean cost (ms) over the places, which are the last axis."""
        mean: Floats = 1e3 * cost.sum(-1) / max(float(self.weight.sum()), 1e-9)
        return mean


class Places:
    """The squares of one measurement, in the order of `SIDES_M`."""

    def __init__(self) -> None:
        self.squares: list[Square] = []

    def report(self, allowed: Bools, actions: Sequence[Action]) -> dict[str, float | int | str]:
        """Means by density, for the policy and the search also by side; the advantage over the best fixed
        mode with its 95 % interval; and the places where the policy is worse."""
        ms = {name: np.array([s.ms(s.cost[name]) for s in self.squares]) for name in _METHODS}
        fixed = np.array([s.ms(s.fixed) for s in self.squares])  # (sides, actions)
        fixed[:, ~allowed] = np.inf
        at = {density: [SIDES_M.index(side) for side in sides] for density, sides in DENSITIES.items()}
        best = int(fixed.mean(0).argmin())
        return {
            **{f"{density}_ms": _rounded(ms["policy"][sides].mean()) for density, sides in at.items()},
            "best_fixed_dynamic_ms": _rounded(fixed[:, best].mean()),
            "best_fixed": "+".join(map(str, actions[best])),
            "best_fixed_by_side_dynamic_ms": _rounded(fixed.min(1).mean()),
            "rule_dynamic_ms": _rounded(ms["rule"].mean()),
            "search_dynamic_ms": _rounded(ms["search"].mean()),
            **{
                f"{key}side_{side:.0f}_ms": _rounded(ms[name][k])
                for key, name in (("", "policy"), ("search_", "search"))
                for k, side in enumerate(SIDES_M)
            },
            **self._against_fixed(best),
            **self._tail(best),
        }

    def _against_fixed(self, best: int) -> dict[str, float]:
        """Policy against the best fixed mode (%), and in each square. The 95 % interval is given if no square
        has fewer places than `LEAST_PLACES`."""
        rng = np.random.default_rng(_SEED)
        drawn = np.zeros((2, DRAWS))
        each = []
        for square in self.squares:
            parts = np.stack([square.cost["policy"], square.fixed[best]])
            each.append(square.ms(parts))
            places = square.weight.size
            counts = rng.multinomial(places, np.full(places, 1.0 / places), DRAWS).astype(float)
            drawn += 1e3 * (parts @ counts.T) / np.maximum(counts @ square.weight, 1e-9)
        found = np.sum(each, axis=0)
        low, high = np.percentile(100.0 * (drawn[0] / drawn[1] - 1.0), (2.5, 97.5))
        interval = {"vs_best_fixed_low_pct": _rounded(low), "vs_best_fixed_high_pct": _rounded(high)}
        if any(square.weight.size < LEAST_PLACES for square in self.squares):
            interval = {}
        return {
            **{
                f"vs_side_{side:.0f}_pct": _rounded(_worse_pct(policy, fixed))
                for side, (policy, fixed) in zip(SIDES_M, each, strict=True)
            },
            "vs_best_fixed_pct": _rounded(_worse_pct(*found)),
            **interval,
        }

    def _tail(self, best: int) -> dict[str, float | int]:
        """How many places are worse than with the best fixed mode, and by how much."""
        ratios = [_ratios(square, best) for square in self.squares]
        every = np.concatenate(ratios)
        worse = int((every > 1.0 + BEHIND).sum())
        low, high = wilson(worse, every.size)
        p95, p99, most = (1.0, 1.0, 1.0) if not every.size else np.percentile(every, (95, 99, 100))
        return {
            "places": every.size,
            "places_worse": worse,
            "places_worse_pct": _rounded(100.0 * worse / max(1, every.size)),
            "places_worse_low_pct": _rounded(100.0 * low),
            "places_worse_high_pct": _rounded(100.0 * high),
            "ratio_p95": _rounded(p95),
            "ratio_p99": _rounded(p99),
            "ratio_max": _rounded(most),
            **{
                f"worse_side_{side:.0f}": int((ratio > 1.0 + BEHIND).sum())
                for side, ratio in zip(SIDES_M, ratios, strict=True)
            },
            **{f"places_side_{side:.0f}": ratio.size for side, ratio in zip(SIDES_M, ratios, strict=True)},
        }


def _ratios(square: Square, best: int) -> Floats:
    """Policy's cost as a multiple of the best fixed mode's, at the places that count."""
    fixed, policy = square.fixed[best], square.cost["policy"]
    counts = (square.weight >= LEAST_WEIGHT) & (fixed > 0.0)
    ratios: Floats = policy[counts] / fixed[counts]
    return ratios


def _worse_pct(policy: float, fixed: float) -> float:
    """By how much (%) a cost exceeds another one; 0 where nobody reaches anybody, so that both are 0."""
    return 100.0 * (policy / fixed - 1.0) if fixed > 0.0 else 0.0


def _rounded(value: float) -> float:
    return round(float(value), 3)
