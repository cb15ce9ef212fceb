"""Combines the configured limits with the vehicle's own: the lower one of each applies."""

from __future__ import annotations

import msgspec

from companion.config import LimitsConfig
from companion.events import Parameter, VehicleParameters


def lower_ones(limits: LimitsConfig, vehicle: VehicleParameters | None) -> dict[str, Parameter]:
    """Keys of [limits] for which the vehicle's own limit is lower, with its parameter.

    Args:
        vehicle: None: its limits are not known.
    """
    if vehicle is None:
        return {}
    own = {
        "max_speed_mps": vehicle.speed_mps,
        "max_climb_mps": vehicle.climb_mps,
        "max_descent_mps": vehicle.descent_mps,
        "max_acceleration_mps2": vehicle.acceleration_mps2,
    }
    return {key: p for key, p in own.items() if p is not None and p.value < getattr(limits, key)}


def effective(limits: LimitsConfig, vehicle: VehicleParameters | None) -> LimitsConfig:
    """Limits for commands to this vehicle. The vehicle's horizontal speed limit bounds the total speed."""
    lower = {key: parameter.value for key, parameter in lower_ones(limits, vehicle).items()}
    return msgspec.structs.replace(limits, **lower)
