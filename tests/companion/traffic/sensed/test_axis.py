"""The filter along one direction, against the matrices of a textbook."""

from __future__ import annotations

import numpy as np
import pytest

from companion.traffic.sensed.objects import MANOEUVRE_MPS2, _Axis


def matrix(axis: _Axis) -> np.ndarray:
    return np.array([[axis.pp, axis.pv], [axis.pv, axis.vv]])


@pytest.mark.parametrize("passed_s", [0.0, 0.1, 1.5])
def test_the_prediction_is_that_of_a_velocity_with_white_acceleration(passed_s: float) -> None:
    """F P F' + Q; Q is that of continuous white acceleration."""
    axis, t = _Axis(4.0, 0.7, 2.5), passed_s
    f = np.array([[1.0, t], [0.0, 1.0]])
    q = MANOEUVRE_MPS2**2 * np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    assert matrix(axis.later(t)) == pytest.approx(f @ matrix(axis) @ f.T + q)


def test_a_prediction_in_steps_is_that_in_one() -> None:
    axis = _Axis(4.0, 0.7, 2.5)
    assert tuple(axis.later(0.3).later(0.9)) == pytest.approx(tuple(axis.later(1.2)))


@pytest.mark.parametrize("noise2", [0.04, 9.0])
def test_a_measurement_of_the_place_is_that_of_kalman(noise2: float) -> None:
    axis, h = _Axis(4.0, 0.7, 2.5), np.array([[1.0, 0.0]])
    p = matrix(axis)
    gain = p @ h.T / (h @ p @ h.T + noise2)
    after, kp, kv = axis.measured(noise2)
    assert (kp, kv) == pytest.approx(tuple(gain[:, 0]))
    assert matrix(after) == pytest.approx((np.eye(2) - gain @ h) @ p)
