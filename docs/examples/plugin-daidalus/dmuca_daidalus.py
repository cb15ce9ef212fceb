"""Follows the bands of NASA's DAIDALUS: the nearest direction or speed that is in no conflict, once a second.

C. Munoz, A. Narkawicz et al., "DAIDALUS: Detect and Avoid Alerting Logic for Unmanned Systems" (2015), here
version 2. DAIDALUS only advises; that everybody follows the nearest advice, and stands still where there is
none, is the choice of this law. Build the library first (`build.sh`); DMUCA_DAIDALUS names it if it is not
beside this file.
"""

import ctypes
import functools
import os
import weakref
from pathlib import Path

from companion.errors import ConfigError

RADIUS_M, HEIGHT_M = 25.0, 25.0
"""Cylinder to keep clear of: its radius, and half its height."""
LOOK_S = 30.0
PERIOD_S = 1.0
"""Time between two questions to DAIDALUS."""
_STILL_MPS = 0.05
"""A slower velocity has no direction that DAIDALUS could judge."""

_NUMBERS = ctypes.POINTER(ctypes.c_double)


@functools.cache
def library():
    """The built library.

    Raises:
        ConfigError: it is missing, or is no such library.
    """
    path = Path(os.environ.get("DMUCA_DAIDALUS") or Path(__file__).with_name("libdmuca_daidalus.so"))
    try:
        found = ctypes.CDLL(str(path))
        new, delete, decide = (
            getattr(found, f"dmuca_daidalus_{name}") for name in ("new", "delete", "decide")
        )
    except (OSError, AttributeError) as error:
        raise ConfigError(f"DAIDALUS: {path}: {error}; build.sh of dmuca-daidalus makes it") from error
    new.restype, new.argtypes = ctypes.c_void_p, [ctypes.c_double] * 4
    delete.restype, delete.argtypes = None, [ctypes.c_void_p]
    decide.argtypes = [
        ctypes.c_void_p, ctypes.c_double, _NUMBERS, _NUMBERS, ctypes.c_int, _NUMBERS, _NUMBERS, _NUMBERS,
    ]  # fmt: skip
    return found


def _numbers(values):
    return (ctypes.c_double * max(len(values), 1))(*values)


class Daidalus:
    """The law of one aircraft. Limits, floor, ceiling and fence are kept for it."""

    def __init__(self, avoidance):
        self._library = library()
        self._daa, self._speed_mps = None, 0.0
        self._asked_s, self._found = float("-inf"), None

    def choose(self, situation, follow, limits):
        """The velocity to fly now: that of the path, or what DAIDALUS has advised last."""
        if situation.now_s - self._asked_s >= PERIOD_S - 1e-6:
            self._asked_s = situation.now_s
            self._found = self._ask(situation, follow, limits)
        return follow.wanted_ned_mps if self._found is None else self._found

    def _ask(self, situation, follow, limits):
        wanted = follow.wanted_ned_mps
        if (wanted[0] ** 2 + wanted[1] ** 2) ** 0.5 < _STILL_MPS:
            return None
        if self._daa is None or self._speed_mps != limits.max_speed_mps:
            self._speed_mps = limits.max_speed_mps
            self._daa = self._library.dmuca_daidalus_new(RADIUS_M, HEIGHT_M, LOOK_S, self._speed_mps)
            weakref.finalize(self, self._library.dmuca_daidalus_delete, self._daa)
        found = (ctypes.c_double * 3)()
        answer = self._library.dmuca_daidalus_decide(
            self._daa, situation.now_s, _numbers(situation.position_ned_m), _numbers(wanted),
            len(follow.tracks), _numbers([x for track in follow.tracks for x in track.position_ned_m]),
            _numbers([x for track in follow.tracks for x in track.velocity_ned_mps]), found,
        )  # fmt: skip
        if answer == 0:
            return None
        return tuple(found) if answer == 1 else (0.0, 0.0, wanted[2])
