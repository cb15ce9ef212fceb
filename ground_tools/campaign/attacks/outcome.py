"""Evaluates an attacked flight from the true positions of the aircraft only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import msgspec

from companion.arrays import Floats
from companion.config import AvoidanceConfig
from companion.geometry import Vec3
from ground_tools.campaign.attacks.scene import BEGIN_S, Scene

SEPARATION_M: Final = 2.0 * AvoidanceConfig().conflict_radius_m
HIT_M: Final = 2.0
AWAY_M: Final = 15.0
"""With `fly`, the own aircraft counts as held while it is farther than this from its timed point. A start
from rest counts too: of the return within 15 s, up to about 12 s count at 15 m/s."""


class Row(msgspec.Struct, frozen=True):
    """Outcome of one flight."""

    seed: int
    use: str
    met: str
    """How the aircraft on collision course flies, or the direction in which a herding ghost pushes."""
    separation_m: float | None
    """Least distance between an avoiding aircraft (the own one or another) and an honest aircraft; None
    without honest aircraft."""
    at_s: float
    """Time of that least distance."""
    held_s: float
    """Time during which the own aircraft did not fly its mission (guard) or was not at its timed point
    (fly)."""
    longest_s: float
    """Longest uninterrupted part of `held_s`."""
    aside_m: float
    """Largest horizontal distance from the own path's line."""
    up_m: float
    """Largest height above the own path; `down_m` likewise below it."""
    down_m: float
    lowest_m: float
    """Least height above home."""
    beyond_m: float | None
    """Largest distance beyond the fence (0 inside); None without a fence."""

    @property
    def lost(self) -> bool:
        """Whether separation was lost."""
        return self.separation_m is not None and self.separation_m < SEPARATION_M

    @property
    def hit(self) -> bool:
        """Whether two aircraft collided."""
        return self.separation_m is not None and self.separation_m < HIT_M


class Judge:
    """Accumulates the outcome of one flight. Call `look` after every step."""

    def __init__(self, scene: Scene, met: str) -> None:
        self._scene = scene
        self._met = met
        self._before: tuple[Vec3, ...] = ()
        self._least, self._at_s = math.inf, 0.0
        self._held_s = self._longest_s = self._since_s = 0.0
        self._aside_m = self._up_m = self._down_m = 0.0
        self._lowest_m = math.inf
        self._beyond_m = 0.0

    def look(
        self,
        now_s: float,
        elapsed_s: float,
        places: Sequence[Vec3],
        avoids: Sequence[bool],
        *,
        on_mission: bool | None,
    ) -> None:
        """Update the outcome with the true positions (NED, m) after a step.

        Args:
            elapsed_s: duration of the step.
            places: the own aircraft first.
            avoids: whether each aircraft has a companion that avoids.
            on_mission: whether the own vehicle flies its mission itself; None: the companion flies the path.
        """
        self._near(now_s, tuple(places), avoids)
        if now_s < BEGIN_S:
            return
        own = places[0]
        held = math.dist(own, self._scene.planned(now_s)) > AWAY_M if on_mission is None else not on_mission
        self._since_s = self._since_s + elapsed_s if held else 0.0
        self._held_s += elapsed_s * held
        self._longest_s = max(self._longest_s, self._since_s)
        cosine, sine = math.cos(self._scene.heading_rad), math.sin(self._scene.heading_rad)
        aside = abs(cosine * own[1] - sine * own[0])
        self._aside_m = max(self._aside_m, aside)
        self._up_m = max(self._up_m, -own[2] - self._scene.height_m)
        self._down_m = max(self._down_m, self._scene.height_m + own[2])
        self._lowest_m = min(self._lowest_m, -own[2])
        if self._scene.fence_m is not None:
            self._beyond_m = max(self._beyond_m, aside - self._scene.fence_m)

    def _near(self, now_s: float, places: tuple[Vec3, ...], avoids: Sequence[bool]) -> None:
        before = self._before or places
        for i in range(len(places)):
            if not avoids[i]:
                continue
            for j in range(len(places)):
                if j != i:
                    away = least_distance(before[i], before[j], places[i], places[j])
                    if away < self._least:
                        self._least, self._at_s = away, now_s
        self._before = places

    def row(self) -> Row:
        """The outcome of the flight so far."""
        alone = math.isinf(self._least)
        return Row(
            seed=self._scene.seed,
            use=self._scene.use,
            met=self._met,
            separation_m=None if alone else round(self._least, 3),
            at_s=round(self._at_s, 2),
            held_s=round(self._held_s, 2),
            longest_s=round(self._longest_s, 2),
            aside_m=round(self._aside_m, 2),
            up_m=round(self._up_m, 2),
            down_m=round(self._down_m, 2),
            lowest_m=round(self._lowest_m, 2),
            beyond_m=None if self._scene.fence_m is None else round(self._beyond_m, 2),
        )


def least_distance(a: Vec3, b: Vec3, a_after: Vec3, b_after: Vec3) -> float:
    """Least distance (m) of two aircraft that move straight from `a` and `b` to `a_after` and `b_after`."""
    gap = [q - p for p, q in zip(a, b, strict=True)]
    change = [q - p - g for p, q, g in zip(a_after, b_after, gap, strict=True)]
    size2 = sum(c * c for c in change)
    share = 0.0
    if size2 > 0.0:
        share = min(max(-sum(g * c for g, c in zip(gap, change, strict=True)) / size2, 0.0), 1.0)
    return math.hypot(*(g + share * c for g, c in zip(gap, change, strict=True)))


def quantiles(values: Floats) -> dict[str, float]:
    """Least value, 1 % and 5 % quantiles, and median of some values."""
    ordered = sorted(values.tolist())
    picks = {"least": 0.0, "p1": 0.01, "p5": 0.05, "median": 0.5}
    return {name: round(ordered[int(share * (len(ordered) - 1))], 3) for name, share in picks.items()}
