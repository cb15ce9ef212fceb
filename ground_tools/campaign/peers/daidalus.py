"""A law that follows the bands of NASA's DAIDALUS, which its own library computes.

C. Munoz, A. Narkawicz et al., "DAIDALUS: Detect and Avoid Alerting Logic for Unmanned Systems" (2015), here
version 2. DAIDALUS only advises. Following the nearest advice once a second, and what to do where there is
none, is the choice of this law. `docs/examples/plugin-daidalus` builds the library; its `shim.cpp` describes
the functions.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
import math
import os
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from llvmlite import binding
from numba import types

from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.errors import ConfigError
from ground_tools.campaign.compiled import compiled
from ground_tools.campaign.flight import Mind, loop_of, state_of
from ground_tools.campaign.outcome import Log, Tally
from ground_tools.campaign.peers.common import AVOIDS, FIRST, beside, commanded, following, report
from ground_tools.campaign.powers import Powers
from ground_tools.campaign.vehicles import Fleet
from ground_tools.campaign.world import Conditions

LIBRARY: Final = "DMUCA_DAIDALUS"
"""Environment variable that names the library if it is not in the installed plug-in `dmuca_daidalus`."""
_EVERY_S: Final = 1.0
"""Time between two questions to DAIDALUS."""
_STILL_MPS: Final = 0.05
"""A slower velocity has no direction that DAIDALUS could judge."""
_TINY: Final = 1e-6
# Entries that an aircraft keeps about itself in `Mind.notes`: 1 after the first question, the time of the
# last one, 1 if it flies advice, and the velocity of that.
_BEGUN, _TIME, _ACTIVE, _VELOCITY = 0, 1, 2, 3
_NUMBER, _HANDLE = types.float64, types.intp


def _function(name: str, answer: Any, *arguments: Any) -> Any:
    """A function of the library. Its address is looked up when the calling function is loaded."""
    return types.ExternalFunction(f"dmuca_daidalus_{name}", answer(*arguments))


_NAMES: Final = ("set_up", "begin", "add", "decide", "north", "east")
_SET_UP = _function("set_up", _HANDLE, *[_NUMBER] * 4)
_BEGIN = _function("begin", types.void, _HANDLE, *[_NUMBER] * 6)
_ADD = _function("add", types.void, _HANDLE, *[_NUMBER] * 6)
_DECIDE = _function("decide", types.int32, _HANDLE, types.int32)
_NORTH = _function("north", _NUMBER, _HANDLE)
_EAST = _function("east", _NUMBER, _HANDLE)


class Daidalus(NamedTuple):
    """Parameters."""

    radius_m: float
    """Radius and half height of the volume to keep clear of."""
    look_s: float
    """Time ahead in which conflicts are detected, and for which advice holds."""
    directions_first: float
    """1: a change of speed is flown only where there is no direction; 0: the nearer of both is flown."""
    predicted: float
    """1: positions are extrapolated by the age of the message; 0: they are those of the message."""
    collision_m: float
    """Distance at which aircraft collide (DAIDALUS's near mid-air collision, both ways): no recovery from
    within the volume keeps less."""


@functools.cache
def load() -> str:
    """Load the library into this process. Returns a digest of it.

    Raises:
        ConfigError: it is missing, or is no such library.
    """
    found = os.environ.get(LIBRARY)
    if not found:
        plugin = importlib.util.find_spec("dmuca_daidalus")
        if plugin is None or plugin.origin is None:
            raise ConfigError(
                f"DAIDALUS is not installed: {LIBRARY} names no library, and the plug-in dmuca-daidalus of "
                "docs/examples is not installed"
            )
        found = str(Path(plugin.origin).with_name("libdmuca_daidalus.so"))
    try:
        built = ctypes.CDLL(found)
        for name in _NAMES:  # calling a function that is not there would end the process
            getattr(built, f"dmuca_daidalus_{name}")
        binding.load_library_permanently(found)
        return hashlib.sha256(Path(found).read_bytes()).hexdigest()[:12]
    except (OSError, AttributeError, RuntimeError) as error:
        raise ConfigError(f"DAIDALUS: {found}: {error}; build.sh of dmuca-daidalus makes it") from error


_compiled = compiled()


@_compiled
def parameters(settings: Floats, i: int) -> Daidalus:
    """The parameters of aircraft i."""
    p = settings[i, FIRST:]
    return Daidalus(p[0], p[1], p[2], p[3], p[4])


@_compiled
def _ask(mind: Mind, i: int, count: int, own: k.Own, wanted: k.Vector, p: Daidalus, law: k.Settings) -> None:
    """Ask DAIDALUS about the wanted velocity of aircraft i, and write the answer to its notes."""
    notes = mind.notes[i, len(mind.notes) :]
    notes[_BEGUN], notes[_TIME], notes[_ACTIVE] = 1.0, own.now_s, 0.0
    if math.sqrt(wanted.n * wanted.n + wanted.e * wanted.e) < _STILL_MPS:
        return
    daa = _SET_UP(p.radius_m, p.look_s, law.speed_mps, p.collision_m)
    place = own.position
    _BEGIN(daa, place.n, place.e, place.d, wanted.n, wanted.e, wanted.d)
    for row in range(count):
        away, v = beside(k.other_at(mind.neighbours, row), own, p.predicted != 0.0)
        _ADD(daa, place.n + away.n, place.e + away.e, place.d + away.d, v.n, v.e, v.d)
    answer = _DECIDE(daa, 1 if p.directions_first != 0.0 else 0)
    if answer == 0:
        return
    notes[_ACTIVE] = 1.0
    if answer == 1:
        notes[_VELOCITY], notes[_VELOCITY + 1] = _NORTH(daa), _EAST(daa)
    else:
        notes[_VELOCITY], notes[_VELOCITY + 1] = 0.0, 0.0
    notes[_VELOCITY + 2] = wanted.d


@_compiled
def decide(
    mind: Mind,
    i: int,
    count: int,
    own: k.Own,
    path: k.Path,
    fence: Floats,
    settings: Floats,
    law: k.Settings,
    work: k.Workspace,
) -> k.Decision:
    """The decision function; see `flight.Decide`."""
    state = state_of(mind, i)
    plain = following(mind, i, own, path, fence, law, work)
    if settings[i, AVOIDS] == 0.0:
        return plain
    p, notes = parameters(settings, i), mind.notes[i, len(mind.notes) :]
    if notes[_BEGUN] == 0.0 or own.now_s - notes[_TIME] >= _EVERY_S - _TINY:
        _ask(mind, i, count, own, plain.wanted, p, law)
    active = notes[_ACTIVE] != 0.0
    for row in range(count):
        away, velocity = beside(k.other_at(mind.neighbours, row), own, p.predicted != 0.0)
        t, near2 = k.closest(away, k.minus(plain.wanted, velocity), 1e6)
        avoided = active and near2 < p.radius_m * p.radius_m and t <= p.look_s
        report(work.seen, row, own, plain.wanted, away, velocity, p.radius_m, avoided)
    found = plain.wanted
    if active:
        found = k.Vector(notes[_VELOCITY], notes[_VELOCITY + 1], notes[_VELOCITY + 2])
    return commanded(plain, found, True, active, own, law, state)


@_compiled
def fly(
    rng: np.random.Generator,
    world: Conditions,
    path_times: Floats,
    path_points: Floats,
    fence: Floats,
    settings: Floats,
    kinds: Floats,
    trace: Floats,
    log: Log,
    pairs: Floats,
    result: Floats,
    craft: Fleet,
    tally: Tally,
    mind: Mind,
    work: k.Workspace,
    dark: int,
    dark_from: float,
    powers: Powers,
    power_rng: np.random.Generator,
) -> None:
    """The loop of this law; see `flight.Loop`."""
    loop_of(
        decide, rng, world, path_times, path_points, fence, settings, kinds, trace, log, pairs, result, craft,
        tally, mind, work, dark, dark_from, powers, power_rng,
    )  # fmt: skip
