"""Distributions with plug-ins for tests: each has a module and the metadata that an installer would write."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from companion import plugins

LAWS = '''
class Straight:
    """Asks for whatever its class says."""

    asks = (0.0, 0.0, 0.0)

    def __init__(self, avoidance):
        self.avoidance = avoidance

    def choose(self, situation, follow, limits):
        return self.asks


class Follow(Straight):
    def choose(self, situation, follow, limits):
        return follow.wanted_ned_mps


class Aside(Straight):
    """Flies to the right while the path is in conflict."""

    def choose(self, situation, follow, limits):
        n, e, d = follow.wanted_ned_mps
        return (-e, n, d) if follow.conflict else (n, e, d)


class East(Straight):
    asks = (0.0, 1e5, 0.0)


class Down(Straight):
    asks = (0.0, 0.0, 50.0)


class Nan(Straight):
    asks = (0.0, float("nan"), 0.0)


class Huge(Straight):
    asks = (1e300, 0.0, 0.0)


class Two(Straight):
    asks = (0.0, 1.0)


class Words(Straight):
    asks = "fast"


class Nothing(Straight):
    asks = None


class Raises(Follow):
    """Fails in its 40th decision."""

    def __init__(self, avoidance):
        self.left = 40

    def choose(self, situation, follow, limits):
        self.left -= 1
        if not self.left:
            raise RuntimeError("no idea")
        return super().choose(situation, follow, limits)


class Exits(Straight):
    def choose(self, situation, follow, limits):
        raise SystemExit(3)


class Cancelled(Straight):
    """Fails with an exception that is no Exception, as asyncio's CancelledError."""

    def choose(self, situation, follow, limits):
        raise GeneratorExit("cancelled")


class Interrupted(Straight):
    def choose(self, situation, follow, limits):
        raise KeyboardInterrupt


class Unmade:
    def __init__(self, avoidance):
        raise OSError("no weights")


class Clumsy(Straight):
    """Changes what it is given."""

    def choose(self, situation, follow, limits):
        situation.neighbours.clear()
'''
KINDS = (
    "Straight", "Follow", "Aside", "East", "Down", "Nan", "Huge", "Two", "Words", "Nothing", "Raises",
    "Exits", "Cancelled", "Interrupted", "Unmade", "Clumsy",
)  # fmt: skip


def install(folder: Path, name: str, source: str, entry_points: Mapping[str, Mapping[str, str]]) -> None:
    """Write a distribution with version 1.0 and one module of the same name.

    Args:
        entry_points: for each group, the names of entry points and the objects that they refer to.
    """
    (folder / f"{name}.py").write_text(source)
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = []
    for group, named in entry_points.items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in named.items())]
    (about / "entry_points.txt").write_text("\n".join(lines) + "\n")


def forget(*names: str) -> None:
    """Clear what Python and `companion.plugins` have loaded from these distributions."""
    plugins.load.cache_clear()
    for name in names:
        sys.modules.pop(name, None)
    importlib.invalidate_caches()


def installed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, name: str, install_it: Callable[[Path], None]
) -> Iterator[Path]:
    """Body of a fixture: install the distribution `name` in `folder` while the test runs."""
    monkeypatch.syspath_prepend(str(folder))
    forget(name)
    install_it(folder)
    yield folder
    forget(name)


def laws(folder: Path, name: str = "plugged_laws") -> None:
    """Install `LAWS`: one plug-in for each of `KINDS`, by its name in lower case."""
    install(folder, name, LAWS, {plugins.LAWS: {kind.lower(): f"{name}:{kind}" for kind in KINDS}})


POLICIES = '''
from asyncio import CancelledError

import numpy as np

from companion.atmc.actions import SET_ACTIONS


class First:
    """Always the first allowed action."""

    actions = SET_ACTIONS

    def choose(self, own_row, neighbour_rows, allowed, current):
        return np.flatnonzero(allowed)[0]


class Far(First):
    """Actions of its own: another one if somebody is heard."""

    actions = [[0, 0, 4], [5, 5, 5]]

    def choose(self, own_row, neighbour_rows, allowed, current):
        return 1 if len(neighbour_rows) else 0


class Forbidden(First):
    """Changes what it is given, which is a copy."""

    def choose(self, own_row, neighbour_rows, allowed, current):
        allowed[:] = True
        return 0


class Beyond(First):
    def choose(self, own_row, neighbour_rows, allowed, current):
        return 9999


class Half(First):
    def choose(self, own_row, neighbour_rows, allowed, current):
        return 0.5


class Lost(First):
    def choose(self, own_row, neighbour_rows, allowed, current):
        raise KeyError("weights")


class Cancelled(First):
    """Raises what is no `Exception`."""

    def choose(self, own_row, neighbour_rows, allowed, current):
        raise CancelledError("timed out")


class Vast(First):
    """An integer of more digits than Python writes out."""

    def choose(self, own_row, neighbour_rows, allowed, current):
        return 10**5000


class Fast(First):
    actions = ((0, 0, 11),)


class Silent(First):
    actions = ((0, 0, 0),)


class Twice(First):
    actions = ((0, 0, 1), (0, 0, 1))


class Bare:
    pass
'''
POLICY_KINDS = (
    *("First", "Far", "Forbidden", "Beyond", "Half", "Lost", "Cancelled", "Vast"),
    *("Fast", "Silent", "Twice", "Bare"),
)


def policies(folder: Path, name: str = "plugged_policies") -> None:
    """Install `POLICIES`: one plug-in for each of `POLICY_KINDS`, by its name in lower case."""
    entries = {kind.lower(): f"{name}:{kind}" for kind in POLICY_KINDS}
    install(folder, name, POLICIES, {plugins.POLICIES: entries})
