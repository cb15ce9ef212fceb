"""Flights from files of other projects: scaled to small aircraft, and cut into episodes.

In an episode all aircraft are in the air from its beginning to its end. A file whose aircraft are all created
together and end together is one episode. Any other file has an episode for each planned conflict: the
aircraft that are in the air for `AROUND_S` before and after it and come near its place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from companion.arrays import AnyFloats, Floats
from companion.errors import ConfigError
from ground_tools.campaign.encounters.sampling import FOOT_M
from ground_tools.campaign.generators import HEIGHT_M
from ground_tools.campaign.scenarios import bluesky, metropolis

PREFIX: Final = "file:"
ZONE_M, ZONE_HEIGHT_M = 5.0 * 1852.0, 1000.0 * FOOT_M
"""Radius and half height of BlueSky's protected zone."""
SMALL_ZONE_M: Final = 25.0
"""Radius and half height to which BlueSky's protected zone is scaled."""
CRUISE: Final = 0.75
"""Planned speed of the fastest aircraft as a share of the greatest speed, as in `generators`."""
LEAST_MPS: Final = 5.0
"""Lower bound of the greatest speed of aircraft in a file that is not scaled."""
NEAR_M: Final = 20.0
"""Two plans that come nearer than this are a conflict."""
AROUND_S: Final = 60.0
REACH_M: Final = 300.0
"""Aircraft that come nearer than this to the place of a conflict belong to its episode."""
MOST_AIRCRAFT: Final = 50
BEYOND_S: Final = 30.0
"""Time by which paths extend beyond a flight at both ends, because aircraft that are cut out of a longer
flight neither start nor stop. It is enough to stop from 30 m/s at 1 m/s^2."""
LARGEST_FLEET: Final = 20_000
"""Greatest number of aircraft in a file."""
_LARGEST_FILE: Final = 64_000_000
"""Largest accepted file, bytes."""
_TOGETHER_S: Final = 1.0
_LONGEST_S: Final = 900.0
"""Longest episode of a file whose aircraft are all created together and end together."""
_ORDER: Final = 200
"""First number in the seeds of the random draws of these flights."""
_JITTER_M: Final = 1.0
"""Largest offset of a path from its exact place, along each axis, redrawn for every seed."""


@dataclass(frozen=True, slots=True)
class Episode:
    """Planned paths of aircraft that fly at the same time; NED, m and s."""

    times: Floats
    """(A, K)."""
    points: Floats
    """(A, K, 3)."""

    @property
    def aircraft(self) -> int:
        """Number of aircraft."""
        return len(self.times)

    def going_on(self) -> Episode:
        """The same episode with paths that extend straight by `BEYOND_S` at both ends."""
        first = (self.points[:, 1] - self.points[:, 0]) / np.diff(self.times[:, :2])
        last = (self.points[:, -1] - self.points[:, -2]) / np.diff(self.times[:, -2:])
        before, after = self.points[:, 0] - BEYOND_S * first, self.points[:, -1] + BEYOND_S * last
        return Episode(
            np.column_stack([self.times[:, 0] - BEYOND_S, self.times, self.times[:, -1] + BEYOND_S]),
            np.concatenate([before[:, None], self.points, after[:, None]], axis=1),
        )

    @property
    def speed_mps(self) -> float:
        """Greatest planned speed along the ground."""
        ways = np.linalg.norm(np.diff(self.points[:, :, :2], axis=1), axis=2) / np.diff(self.times)
        return float(ways.max())


class Contents(NamedTuple):
    """Content of a file."""

    episodes: tuple[Episode, ...]
    aircraft: int
    """Number of aircraft in the file."""
    whole: bool
    """Whether `episodes` are all episodes of the file."""
    left_out: int
    """Number of planned conflicts, up to the last episode, that belong to no episode because one of the two
    aircraft is not in the air for long enough."""
    skipped: tuple[tuple[str, int], ...]
    """Inputs that were not understood, and their numbers, the most frequent first."""
    speed_mps: float
    """Greatest speed of each aircraft."""


class _Path(NamedTuple):
    times: AnyFloats
    points: AnyFloats
    """(K, 3): north, east, up."""


def name_of(path: Path, episode: int, zone_m: float | None) -> str:
    """The value of `Cell.generator` that stands for an episode of a file.

    Args:
        zone_m: radius to which BlueSky's protected zone is scaled, m; None: no scaling.
    """
    return f"{PREFIX}{'-' if zone_m is None else f'{zone_m:g}'}:{episode}:{path}"


def draw(name: str, seed: int) -> tuple[Floats, Floats]:
    """The paths of an episode, each moved a little by the seed.

    Args:
        name: from `name_of`.

    Returns:
        Times (A, K) and waypoints (A, K, 3), as `generators.draw` does. The flight begins `BEYOND_S` after
        the paths' beginning and ends `BEYOND_S` before their end.

    Raises:
        ConfigError: the file cannot be read, or there is no such episode.
    """
    _, zone, text, path = name.split(":", 3)
    number = int(text)
    # Search in growing steps, so that few episodes of a large file are searched repeatedly.
    most = 100 * (number // 100 + 1)
    episodes = contents(Path(path), None if zone == "-" else float(zone), most).episodes
    if number >= len(episodes):
        raise ConfigError(f"--scn: {path}: no episode {number}; there are {len(episodes)}")
    episode = episodes[number].going_on()
    rng = np.random.default_rng([_ORDER, number, seed])
    return episode.times, episode.points + rng.uniform(-_JITTER_M, _JITTER_M, (episode.aircraft, 1, 3))


@lru_cache(maxsize=16)
def contents(path: Path, zone_m: float | None, most: int) -> Contents:
    """The episodes of a file: flight intentions (`metropolis`) if its name ends in `.csv`, else `bluesky`.

    Args:
        zone_m: as in `name_of`.
        most: number of episodes after which the search stops.

    Raises:
        ConfigError: the file cannot be read, has too few or too many aircraft, or has no planned conflict.
    """
    scenario = read(path, "--scn")
    if not 2 <= len(scenario.plans) <= LARGEST_FLEET:
        raise ConfigError(
            f"--scn: {path}: it has {len(scenario.plans)} aircraft; allowed: 2 to {LARGEST_FLEET:,}; "
            f"not understood: {scenario.not_understood()}"
        )
    paths = _scaled(_flown(scenario.plans), zone_m)
    episodes, whole, left_out = _episodes(paths, most)
    if not episodes:
        raise ConfigError(
            f"--scn: {path}: no two of its {len(paths)} aircraft are planned to come within {NEAR_M:g} m of "
            f"each other while both are in the air for {AROUND_S:g} s before and after"
        )
    fastest = max(episode.speed_mps for episode in episodes)
    speed = LEAST_MPS if zone_m is not None else max(fastest / CRUISE, LEAST_MPS)
    skipped = tuple(scenario.skipped.most_common())
    return Contents(tuple(episodes), len(paths), whole, left_out, skipped, speed)


def read(path: Path, option: str) -> bluesky.Scenario:
    """The plans in a file: flight intentions (`metropolis`) if its name ends in `.csv`, else `bluesky`.

    Args:
        option: command-line option that named the file.

    Raises:
        ConfigError: the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_LARGEST_FILE + 1)
    except OSError as error:
        raise ConfigError(f"{option}: {path}: cannot be read: {error.strerror}") from error
    if len(raw) > _LARGEST_FILE:
        raise ConfigError(f"{option}: {path}: too large; allowed: up to {_LARGEST_FILE:,} bytes")
    text = raw.decode("utf-8", "replace")
    return metropolis.parse(text) if path.suffix.lower() == ".csv" else bluesky.parse(text)


def _flown(plans: Sequence[bluesky.Plan]) -> list[_Path]:
    """The paths of plans. An aircraft that flies on after its last corner does so until the end of all
    paths."""
    last_s = max(plan.corners[-1][0] for plan in plans)
    # In a larger file, meetings after the last corners are not looked for, and all paths end at the latest of
    # these corners.
    few = plans if len(plans) <= MOST_AIRCRAFT else []
    meet_s = max((_passing_s(a, b) for i, a in enumerate(few) for b in few[:i]), default=0.0)
    first_s = max(plan.corners[0][0] for plan in plans)
    # Continue as long after the last meeting as before it, to show which aircraft return to their paths.
    until_s = max(last_s, 2.0 * meet_s - first_s)
    paths = []
    for plan in plans:
        corners = list(plan.corners)
        t, n, e, up = corners[-1]
        if plan.goes_on and until_s > t:
            vn, ve, vu = plan.velocity
            rest = until_s - t
            corners.append((until_s, n + rest * vn, e + rest * ve, up + rest * vu))
        if len(corners) > 1:
            rows = np.array(corners)
            paths.append(_Path(rows[:, 0], rows[:, 1:]))
    return paths


def _passing_s(a: bluesky.Plan, b: bluesky.Plan) -> float:
    """Time at which two aircraft that fly on after their last corners meet. 0 if they do not, or if they are
    nearest to each other before one of these corners."""
    if not (a.goes_on and b.goes_on):
        return 0.0
    start = max(a.corners[-1][0], b.corners[-1][0])
    p, q = (
        np.array(plan.corners[-1][1:]) + (start - plan.corners[-1][0]) * np.array(plan.velocity)
        for plan in (a, b)
    )
    away, closing = q - p, np.array(b.velocity) - np.array(a.velocity)
    square = float(closing @ closing)
    passed = -float(away @ closing) / square if square > 0.0 else 0.0
    near = float(np.linalg.norm((away + max(passed, 0.0) * closing)[:2]))
    return start + passed if passed > 0.0 and near < ZONE_M else 0.0


def _scaled(paths: Sequence[_Path], zone_m: float | None) -> list[_Path]:
    """The paths for small aircraft: NED, with the median height at `HEIGHT_M`."""
    if not paths:
        return []
    middle_up = float(np.median(np.concatenate([path.points[:, 2] for path in paths])))
    level, height, clock = 1.0, 1.0, 1.0
    if zone_m is not None:
        level, height = zone_m / ZONE_M, zone_m / ZONE_HEIGHT_M
        fastest = max(_fastest(path) for path in paths)
        clock = level * fastest / (CRUISE * LEAST_MPS) if fastest > 0.0 else level
    found = []
    for times, points in paths:
        ned = np.column_stack(
            [points[:, 0] * level, points[:, 1] * level, -HEIGHT_M - (points[:, 2] - middle_up) * height]
        )
        found.append(_Path(times * clock, ned))
    return found


def _fastest(path: _Path) -> float:
    way = np.linalg.norm(np.diff(path.points[:, :2], axis=0), axis=1)
    return float((way / np.diff(path.times)).max())


def _episodes(paths: Sequence[_Path], most: int) -> tuple[list[Episode], bool, int]:
    """The first episodes, whether these are all, and the number of conflicts that belong to none."""
    if not paths:
        return [], True, 0
    begins = np.array([path.times[0] for path in paths])
    ends = np.array([path.times[-1] for path in paths])
    if len(paths) <= MOST_AIRCRAFT and np.ptp(begins) <= _TOGETHER_S and np.ptp(ends) <= _TOGETHER_S:
        start_s = float(begins.max())
        return [_cut(paths, start_s, min(float(ends.min()), start_s + _LONGEST_S))], True, 0
    found: list[Episode] = []
    members: list[tuple[float, set[int]]] = []
    left_out = 0
    for at_s, i, j in _conflicts(paths, begins, ends):
        if any(abs(at_s - other) < AROUND_S and {i, j} <= inside for other, inside in members):
            continue
        inside = (begins <= at_s - AROUND_S) & (ends >= at_s + AROUND_S)
        if not (inside[i] and inside[j]):
            left_out += 1
            continue
        if len(found) == most:
            return found, False, left_out
        near = _nearest(paths, np.flatnonzero(inside).tolist(), _at(paths[i], at_s), at_s)
        chosen = [i, j, *(other for other in near if other not in (i, j))][:MOST_AIRCRAFT]
        members.append((at_s, set(chosen)))
        found.append(_cut([paths[c] for c in chosen], at_s - AROUND_S, at_s + AROUND_S))
    return found, True, left_out


def _conflicts(
    paths: Sequence[_Path], begins: AnyFloats, ends: AnyFloats
) -> Iterator[tuple[float, int, int]]:
    """Time and both aircraft of every conflict of the plan, in the order of time. A conflict of a pair lasts
    as long as the pair stays near."""
    step_s, open_pairs = 1.0, dict[tuple[int, int], float]()
    for at_s in np.arange(begins.min(), ends.max() + step_s, step_s):
        flying = np.flatnonzero((begins <= at_s) & (ends >= at_s)).tolist()
        if len(flying) < 2:
            continue
        places = np.array([_at(paths[i], at_s) for i in flying])
        # Cells of the horizontal plane: only aircraft in neighbouring cells can be near.
        for a, b in _pairs(places):
            pair = flying[a], flying[b]
            if at_s - open_pairs.get(pair, -math.inf) > 2.0 * step_s:
                yield float(at_s), *pair
            open_pairs[pair] = float(at_s)


def _pairs(places: AnyFloats) -> Iterator[tuple[int, int]]:
    """Pairs of rows whose places are nearer than `NEAR_M`."""
    grid: dict[tuple[int, int], list[int]] = {}
    for i, (n, e, _) in enumerate(places.tolist()):
        cell = int(n // NEAR_M), int(e // NEAR_M)
        for dn in (-1, 0, 1):
            for de in (-1, 0, 1):
                for j in grid.get((cell[0] + dn, cell[1] + de), ()):
                    if np.linalg.norm(places[i] - places[j]) < NEAR_M:
                        yield j, i
        grid.setdefault(cell, []).append(i)


def _nearest(paths: Sequence[_Path], among: Sequence[int], place: AnyFloats, at_s: float) -> list[int]:
    """The aircraft that come within `REACH_M` of a place around a time, the nearest first."""
    found = []
    for i in among:
        times = np.arange(at_s - AROUND_S, at_s + AROUND_S + 1.0, 2.0)
        near = float(np.linalg.norm(_along(paths[i], times) - place, axis=1).min())
        if near < REACH_M:
            found.append((near, i))
    return [i for _, i in sorted(found)]


def _at(path: _Path, at_s: float) -> AnyFloats:
    return np.array([np.interp(at_s, path.times, c) for c in path.points.T])


def _cut(paths: Sequence[_Path], start_s: float, end_s: float) -> Episode:
    """The parts of the paths between two times. Time 0 is the first of these times, and the origin is the
    middle of the paths."""
    corners = np.concatenate([[start_s, end_s], *(path.times for path in paths)])
    inner = corners[(corners >= start_s) & (corners <= end_s)]
    times = np.unique(np.round(inner - start_s, 2))
    points = np.array([_along(path, times + start_s) for path in paths], np.float64)
    middle = (points[:, 0] + points[:, -1]).mean(axis=0) / 2.0 * [1.0, 1.0, 0.0]
    return Episode(np.tile(times, (len(paths), 1)), points - middle)


def _along(path: _Path, times: AnyFloats) -> AnyFloats:
    return np.column_stack([np.interp(times, path.times, c) for c in path.points.T])
