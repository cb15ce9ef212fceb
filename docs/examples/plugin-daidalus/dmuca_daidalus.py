"""Follows the bands of NASA's DAIDALUS: the nearest direction or speed that is in no conflict, once a second.

C. Munoz, A. Narkawicz et al., "DAIDALUS: Detect and Avoid Alerting Logic for Unmanned Systems" (2015), here
version 2. DAIDALUS only advises; that everybody follows the nearest advice, and stands still where there is
none, is the choice of this law. Build the library first (`build.sh`); DMUCA_DAIDALUS names it if it is not
beside this file.
"""

import ctypes
import functools
import os
from pathlib import Path
from types import SimpleNamespace

from companion.errors import ConfigError

RADIUS_M = 30.0
"""Radius and half height of the cylinder to keep clear of."""
LOOK_S = 30.0
DIRECTIONS_FIRST = 1
"""1: a change of speed is flown only where there is no direction; 0: the nearer of both is flown."""
COLLISION_M = 20.0
"""Distance at which aircraft collide: no recovery from within the cylinder keeps less."""
PERIOD_S = 1.0
"""Time between two questions to DAIDALUS."""
_STILL_MPS = 0.05
"""A slower velocity has no direction that DAIDALUS could judge."""

_NUMBER, _POINTER = ctypes.c_double, ctypes.c_void_p
_FUNCTIONS = {
    "set_up": (_POINTER, [_NUMBER] * 4),
    "begin": (None, [_POINTER, *[_NUMBER] * 6]),
    "add": (None, [_POINTER, *[_NUMBER] * 6]),
    "decide": (ctypes.c_int, [_POINTER, ctypes.c_int]),
    "north": (_NUMBER, [_POINTER]),
    "east": (_NUMBER, [_POINTER]),
}
"""Type of the answer and of the arguments of each function; `shim.cpp` describes them."""


@functools.cache
def library():
    """The functions of the built library, by their names without the prefix.

    Raises:
        ConfigError: it is missing, or is no such library.
    """
    path = Path(os.environ.get("DMUCA_DAIDALUS") or Path(__file__).with_name("libdmuca_daidalus.so"))
    try:
        built = ctypes.CDLL(str(path))
        found = {name: getattr(built, f"dmuca_daidalus_{name}") for name in _FUNCTIONS}
    except (OSError, AttributeError) as error:
        raise ConfigError(f"DAIDALUS: {path}: {error}; build.sh of dmuca-daidalus makes it") from error
    for name, (answer, arguments) in _FUNCTIONS.items():
        found[name].restype, found[name].argtypes = answer, arguments
    return SimpleNamespace(**found)


class Daidalus:
    """The law of one aircraft. Limits, floor, ceiling and fence are kept for it."""

    def __init__(self, avoidance):
        self._library = library()
        self._asked_s, self._found = float("-inf"), None

    def choose(self, situation, follow, limits):
        """The velocity to fly now: that of the path, or what DAIDALUS has advised last."""
        if situation.now_s - self._asked_s >= PERIOD_S - 1e-6:
            self._asked_s = situation.now_s
            self._found = self._ask(situation, follow, limits)
        return follow.wanted_ned_mps if self._found is None else self._found

    def _ask(self, situation, follow, limits):
        wanted, ask = follow.wanted_ned_mps, self._library
        if (wanted[0] ** 2 + wanted[1] ** 2) ** 0.5 < _STILL_MPS:
            return None
        daa = ask.set_up(RADIUS_M, LOOK_S, limits.max_speed_mps, COLLISION_M)
        ask.begin(daa, *situation.position_ned_m, *wanted)
        for track in follow.tracks:
            ask.add(daa, *track.position_ned_m, *track.velocity_ned_mps)
        answer = ask.decide(daa, DIRECTIONS_FIRST)
        if answer == 0:
            return None
        return (ask.north(daa), ask.east(daa), wanted[2]) if answer == 1 else (0.0, 0.0, wanted[2])
