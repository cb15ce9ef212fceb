"""Link budget: log-distance path loss, log-normal shadowing, and the links that follow from positions.

Section "Packet Collision Model" (the sets R and S), with the parameters of "Performance of Remote ID Modes".
A link carries a mode if transmit power - path loss >= sensitivity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.arrays import Bools, Floats, Indices
from sitl_mocks.channel.parameters import ChannelParameters, PropagationParameters

_MIN_DISTANCE_M = 0.1
_SHADOW_MARGIN = 4.0
"""Standard deviations of shadowing that the search for neighbours covers. 3 in 100,000 values lie beyond."""


@dataclass(frozen=True, slots=True)
class Links:
    """Directed links of one environment or of many environments, one row each."""

    nodes: int
    """Number of aircraft in all environments together."""
    transmitter: Indices
    """Shape (links,): index of the aircraft that sends."""
    receiver: Indices
    """Shape (links,): index of the aircraft that receives."""
    path_loss_db: Floats
    """Shape (links,), including shadowing."""


def path_loss_db(distance_m: Floats, propagation: PropagationParameters) -> Floats:
    """Log-distance path loss without shadowing (dB), same shape as the distances (m)."""
    away = np.maximum(distance_m, _MIN_DISTANCE_M)
    return propagation.loss_at_1m_db + 10.0 * propagation.exponent * np.log10(away)


def thresholds_db(parameters: ChannelParameters) -> Floats:
    """Greatest path loss at which each mode can be received (dB), shape (3,) in the order of `MODES`."""
    modes = (parameters.ble4, parameters.ble5, parameters.wifi)
    return np.array([m.transmit_power_dbm - m.sensitivity_dbm for m in modes])


def ranges_m(parameters: ChannelParameters) -> Floats:
    """Distance (m) up to which each mode can be received without shadowing, shape (3,)."""
    p = parameters.propagation
    return np.asarray(10.0 ** ((thresholds_db(parameters) - p.loss_at_1m_db) / (10.0 * p.exponent)), float)


def reached(links: Links, parameters: ChannelParameters) -> Bools:
    """Whether each link carries each mode, shape (links, 3)."""
    return np.asarray(links.path_loss_db[:, None] <= thresholds_db(parameters), bool)


def all_links(
    positions_m: Floats, propagation: PropagationParameters, rng: np.random.Generator | None = None
) -> Links:
    """The links between all aircraft of each environment.

    Args:
        positions_m: shape (environments, aircraft, 3) or (aircraft, 3).
        rng: draws the shadowing, the same for both directions of a pair. Required with shadowing.

    Raises:
        ValueError: a wrong shape, a position that is not finite, or shadowing without a generator.
    """
    positions = positions_m if positions_m.ndim == 3 else positions_m[None]
    if positions.ndim != 3 or positions.shape[2] != 3:
        raise ValueError(f"positions have shape {positions_m.shape}; expected (environments, aircraft, 3)")
    # Such an aircraft would reach no other, which P0 would treat as the best result.
    if not np.isfinite(positions).all():
        raise ValueError("a position is not finite")
    environments, aircraft, _ = positions.shape
    first, second = np.triu_indices(aircraft, k=1)
    apart = positions[:, first] - positions[:, second]
    loss = path_loss_db(np.sqrt(np.einsum("epk,epk->ep", apart, apart)), propagation).ravel()
    base = (np.arange(environments) * aircraft)[:, None]
    return _both_ways(
        environments * aircraft, (base + first).ravel(), (base + second).ravel(), loss, propagation, rng
    )


def near_links(
    positions_m: Floats, parameters: ChannelParameters, rng: np.random.Generator | None = None
) -> Links:
    """The links of one large environment that may carry any mode. The search takes about linear time.

    Args:
        positions_m: shape (aircraft, 3).
        rng: see `all_links`.

    Raises:
        ValueError: a wrong shape, a position that is not finite, or shadowing without a generator.
    """
    # SciPy is needed only to simulate thousands of aircraft. The extra `inspect` installs it.
    from scipy.spatial import cKDTree

    if positions_m.ndim != 2 or positions_m.shape[1] != 3:
        raise ValueError(f"positions have shape {positions_m.shape}; expected (aircraft, 3)")
    p = parameters.propagation
    margin_db = _SHADOW_MARGIN * p.shadowing_sigma_db
    reach = float(ranges_m(parameters).max()) * 10.0 ** (margin_db / (10.0 * p.exponent))
    pairs = cKDTree(positions_m).query_pairs(reach, output_type="ndarray")
    first, second = pairs[:, 0], pairs[:, 1]
    loss = path_loss_db(np.linalg.norm(positions_m[first] - positions_m[second], axis=1), p)
    return _both_ways(len(positions_m), first, second, loss, p, rng)


def _both_ways(
    nodes: int,
    first: Indices,
    second: Indices,
    loss_db: Floats,
    propagation: PropagationParameters,
    rng: np.random.Generator | None,
) -> Links:
    if propagation.shadowing_sigma_db > 0.0:
        if rng is None:
            raise ValueError("shadowing needs a random generator")
        loss_db = loss_db + rng.normal(0.0, propagation.shadowing_sigma_db, loss_db.shape)
    return Links(
        nodes,
        np.concatenate([first, second]),
        np.concatenate([second, first]),
        np.concatenate([loss_db, loss_db]),
    )


def draw_positions(
    environments: int,
    aircraft: int,
    side_m: float,
    rng: np.random.Generator,
    *,
    altitude_m: tuple[float, float] = (30.0, 120.0),
) -> Floats:
    """Uniform positions (m) in a square and an altitude band, shape (environments, aircraft, 3)."""
    low = np.array([0.0, 0.0, altitude_m[0]])
    high = np.array([side_m, side_m, altitude_m[1]])
    return rng.uniform(low, high, (environments, aircraft, 3))
