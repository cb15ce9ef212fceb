"""The law of a plug-in, which is asked for a velocity and has limits, floor, ceiling and fence kept for it.

The plug-in is untrusted. The velocity that it returns becomes the wish in a decision of our own kernel
without neighbours, so that the command obeys the same limits and the same planes of the fence as that of
every other law. An exception, or anything but three numbers of at most `_MOST_MPS`, ends its use;
`PluginLaw.fault` reports that to the authority.
"""

from __future__ import annotations

import math
from typing import Protocol

import msgspec
import numpy as np

from companion import plugins
from companion.arrays import Floats
from companion.avoidance import kernels as k
from companion.avoidance.law import Law, LawResult, Neighbour, Situation, own_of
from companion.avoidance.trajectory import Trajectory
from companion.config import AvoidanceConfig, LimitsConfig
from companion.errors import ConfigError
from companion.geometry import Vec3

_MOST_MPS = 1e6
"""Largest magnitude of a component that a plug-in may ask for. The limits bound what is commanded."""
_NEAR_M = 300.0
_HALF_S = 0.5
"""Half the length in time of the straight path whose velocity is the wish of the plug-in."""


class OwnLaw(Protocol):
    """The law of one aircraft and one path, as a plug-in of `dmuca.laws` makes it from an `AvoidanceConfig`.

    Its answers must depend only on the arguments of this and earlier calls, because a replay repeats the
    calls and expects the same answers.
    """

    def choose(self, situation: Situation, follow: LawResult, limits: LimitsConfig) -> Vec3:
        """Choose the velocity to fly now (NED, m/s). It need not keep the limits.

        Args:
            situation: own state, and all neighbours that are not too old, sorted by their ids. Those that
                press on us (`Neighbour.presses`) are left out while any other is within 300 m.
            follow: the decision that follows the path and avoids nobody: the velocity along the path
                (`wanted_ned_mps`), whether it would enter the volume of a neighbour (`conflict`), and the
                neighbours as they are predicted now, with the radius of the volume of each (`tracks`).
            limits: limits in effect.
        """
        ...


class PluginLaw(Law):
    """The law of one aircraft that asks a plug-in. Arguments are those of `Law`.

    Raises:
        ConfigError: the plug-in cannot be loaded.
    """

    def __init__(
        self,
        avoidance: AvoidanceConfig,
        limits: LimitsConfig,
        trajectory: Trajectory,
        fence: Floats | None = None,
    ) -> None:
        super().__init__(avoidance, limits, trajectory, fence)
        self._plugin = plugins.load(plugins.LAWS, avoidance.law)
        self._flown = k.first_state(self._settings, 0)
        """State of the decisions that keep the limits."""
        self._ahead = np.zeros(2), np.zeros((2, 3))
        self._own_law: OwnLaw | None = None
        try:
            self._own_law = self._plugin.loaded(avoidance)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            self._fail(error)

    def follow(self, trajectory: Trajectory) -> None:
        """See `Law.follow`."""
        super().follow(trajectory)
        self._flown = k.first_state(self._settings, 0)

    def decide(self, situation: Situation) -> LawResult:
        """Ask the plug-in, and keep the limits. After a fault the command brakes.

        Raises:
            ValueError: as for `Law.decide`.
        """
        situation = _without_yielding(situation)
        follow = super().decide(situation)
        wish = self._wish(situation, follow)
        (n, e, d), velocity, sigma, now_s, path_s, floor_d, ceiling_d = own_of(situation)
        times, points = self._ahead
        times[:] = path_s - _HALF_S, path_s + _HALF_S
        for row, side in enumerate((-_HALF_S, _HALF_S)):
            points[row] = n + side * wish[0], e + side * wish[1], d + side * wish[2]
        flown = self._flown
        chosen, _, solved, flags, (hard, first), state = k.decide_plain(
            self._table, 0, ((n, e, d), velocity, sigma, now_s, path_s, floor_d, ceiling_d), self._ahead,
            self._fence, (*self._settings._replace(law=float(k.DMUCA), turn_s=_HALF_S, catch_up_s=0.0),),
            ((*flown.command,), *flown[1:-1], self._samples), self._history, (*self._work,),
        )  # fmt: skip
        self._flown = k.State(k.Vector(*state[0]), *state[1:])
        feasible, _, _, *bounds = flags
        return msgspec.structs.replace(
            follow,
            chosen_ned_mps=chosen,
            feasible=feasible,
            limits=self._reached(solved, bounds, outside=first > hard),
        )

    def _wish(self, situation: Situation, follow: LawResult) -> Vec3:
        """The velocity that the plug-in asks for; zero after a fault."""
        if self.fault is None and self._own_law is not None:
            seen = msgspec.structs.replace(situation, neighbours=tuple(self._take(situation.neighbours)))
            try:
                return _velocity(self._own_law.choose(seen, follow, self._configured[1]))
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                self._fail(error)
        return 0.0, 0.0, 0.0

    def _fail(self, error: BaseException) -> None:
        self.fault = f"law {self._plugin} failed: {plugins.cause(error)}"


def _without_yielding(situation: Situation) -> Situation:
    """The situation without aircraft that press on us, if another aircraft is near. Our own laws avoid them
    as far as all others allow, but the law of a plug-in has no such priorities."""
    here, others = situation.position_ned_m, situation.neighbours
    if all(not other.presses for other in others):
        return situation
    kept = tuple(other for other in others if not other.presses)
    if not any(math.dist(_now(other), here) < _NEAR_M for other in kept):
        return situation
    return msgspec.structs.replace(situation, neighbours=kept)


def _now(other: Neighbour) -> Vec3:
    (n, e, d), (vn, ve, vd), age = other.position_ned_m, other.velocity_ned_mps, max(other.age_s, 0.0)
    return n + age * vn, e + age * ve, d + age * vd


def _velocity(answer: Vec3) -> Vec3:
    """Convert the answer of a plug-in to a velocity of three numbers, each of at most `_MOST_MPS`.

    Raises:
        Exception: the answer is anything else.
    """
    n, e, d = map(float, answer)
    if not all(abs(component) <= _MOST_MPS for component in (n, e, d)):  # False for NaN too
        raise ValueError(f"({n:g}, {e:g}, {d:g}) m/s is no velocity")
    return n, e, d


def try_out(avoidance: AvoidanceConfig, limits: LimitsConfig) -> None:
    """Let the law of a plug-in make one decision on the ground, on a straight path beside one neighbour.

    Raises:
        ConfigError: the law cannot be loaded, or fails.
    """
    path = Trajectory([0.0, 100.0], [(0.0, 0.0, -50.0), (100.0, 0.0, -50.0)])
    law = PluginLaw(avoidance, limits, path)
    other = Neighbour(
        track_id="TRIAL", position_ned_m=(60.0, 0.0, -50.0), velocity_ned_mps=(-1.0, 0.0, 0.0), age_s=0.5,
        sigma_m=3.0,
    )  # fmt: skip
    law.decide(Situation(0.0, 0.0, (0.0, 0.0, -50.0), (1.0, 0.0, 0.0), 1.5, (other,)))
    if law.fault is not None:
        raise ConfigError(law.fault)
