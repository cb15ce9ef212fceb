"""Remarks for the operator on what the vehicle's own parameters mean for the companion."""

from __future__ import annotations

from collections.abc import Sequence

from companion.autopilot.dialect import DIALECTS
from companion.autopilot.lists.mission import speed_changes
from companion.avoidance.law import horizon_s
from companion.avoidance.limits import effective, lower_ones
from companion.config import Config, LimitsConfig
from companion.events import Firmware, MissionItem, Parameter, VehicleParameters

LEAST_TIMEOUT_S = 0.5
LEAST_SETPOINTS = 5
"""Shortest setpoint timeout of the vehicle, in setpoint periods. It should outlast a delay of the loop and
some lost frames."""
CREWED_MPS = 80.0
"""Assumed speed of crewed aircraft. In low airspace they are seldom faster."""
WELL_CLEAR_M = 3000.0
"""In flights with encounter models, more range than this hardly kept well clear more often
(docs/encounters-results.md)."""
_SINGLE = 1.0 + 1e-6
"""Tolerance for single precision in missions and parameters: 5.3 arrives as 5.3000002."""


def remarks(config: Config, vehicle: VehicleParameters, *, final: bool = False) -> list[str]:
    """Remarks on the vehicle's parameters that the operator should know, in words. If the companion only
    watches, they concern only the traffic.

    Args:
        final: no more parameters will come, so one that is not known stays unknown.
    """
    late, acting = late_traffic(config, vehicle), None
    known = final or (vehicle.adsb_type or vehicle.traffic_action) is not None
    if config.traffic.publish == "if-ignored" and known:
        acting = acts_on_traffic(vehicle)
    told = [late, None if acting is None else f"heard traffic is not published: {acting}"]
    return [*(text for text in told if text is not None), *_flown(config, vehicle)]


def acts_on_traffic(vehicle: VehicleParameters) -> str | None:
    """Why the autopilot might act on traffic that is published (ADSB_VEHICLE), in words; None if it does not.

    With ADSB_TYPE 0, ArduPilot only forwards the message (MAVLink_routing). PX4 always takes it; up to
    NAV_TRAFF_AVOID 1 it does no more than warn.
    """
    if vehicle.firmware is Firmware.ARDUPILOT:
        receiver = vehicle.adsb_type
        if receiver is None:
            return "ADSB_TYPE is not known"
        return None if receiver.value == 0 else f"{receiver.name} {receiver.value:g}: the autopilot uses it"
    action = vehicle.traffic_action
    if action is None:
        return "NAV_TRAFF_AVOID is not known"
    return None if action.value <= 1 else f"{action.name} {action.value:g}: the autopilot avoids it by itself"


def late_traffic(config: Config, vehicle: VehicleParameters) -> str | None:
    """What it costs that the autopilot reports no crewed traffic from farther off, in words; None if it
    reports all that alerts could be about."""
    receiver, radius = vehicle.adsb_type, vehicle.adsb_radius_m
    if receiver is None or receiver.value == 0 or radius is None:
        return None
    horizon = horizon_s(config.avoidance, crewed=True)
    least_m = horizon * CREWED_MPS
    if radius.value == 0 or radius.value >= least_m:
        return None
    said = f"{radius.name} {radius.value:g}: the autopilot reports no aircraft beyond {radius.value:g} m"
    alerts = f"alerts look {horizon:g} s ahead, at {CREWED_MPS:g} m/s {least_m:g} m"
    if radius.value < WELL_CLEAR_M:
        return (
            f"{said}, too late to keep well clear of many. In simulations 2000 m left up to 35 % of the "
            f"losses of well clear, {WELL_CLEAR_M:g} m up to 23 %: set {WELL_CLEAR_M:g} m or more ({alerts})"
        )
    return (
        f"{said}. In simulations more than {WELL_CLEAR_M:g} m hardly kept well clear more often, but "
        f"{alerts}: set {least_m:g} m or more for all of them"
    )


def _flown(config: Config, vehicle: VehicleParameters) -> list[str]:
    """Remarks for a vehicle that the companion flies or guards."""
    if config.flight.use == "watch":
        return []
    dialect, limits, rate_hz = DIALECTS[vehicle.firmware], config.limits, config.flight.setpoint_rate_hz
    found = [
        f"{_told(vehicle, p)} is below limits.{key} {getattr(limits, key):g}: the vehicle's limit applies"
        for key, p in lower_ones(limits, vehicle).items()
    ]
    timeout, loss, fence = vehicle.setpoint_timeout_s, vehicle.loss_action, vehicle.fence_action
    least_s = max(LEAST_TIMEOUT_S, LEAST_SETPOINTS / rate_hz)
    if timeout is not None and timeout.value < least_s:
        found.append(
            f"{timeout.name} {timeout.value:g} s is too short for {rate_hz:g} setpoints a second: "
            f"set {least_s:g} or more"
        )
    if loss is not None and loss.value in dialect.crashing_actions:
        found.append(
            f"{loss.name} {loss.value:g}: without setpoints the vehicle "
            f"{dialect.after_silence(int(loss.value))}"
        )
    restart = restarting(vehicle)
    if config.flight.use == "guard" and restart is not None:
        found.append(restart)
    if limits.fence == "vehicle" and fence is not None and fence.value in dialect.idle_fence_actions:
        found.append(f"{fence.name} {fence.value:g}: the vehicle itself does not enforce its fence")
    return found


def _told(vehicle: VehicleParameters, p: Parameter) -> str:
    """Name and value of a limit (SI). Where the vehicle holds it in centimetres, its own number is told too,
    because that is what is set in a ground station."""
    factors = {name: factor for wanted in DIALECTS[vehicle.firmware].wanted for name, factor in wanted.names}
    if factors.get(p.name, 1.0) == 1.0:
        return f"{p.name} {p.value:g}"
    return f"{p.name} {p.value:g} (set in centimetres: {p.value / factors[p.name]:g})"


def restarting(vehicle: VehicleParameters) -> str | None:
    """Why a mission cannot be given back to this vehicle, in words; None when it can."""
    restart = vehicle.mission_restart
    if restart is None or restart.value == 0:
        return None
    return (
        f"{restart.name} {restart.value:g}: after a handback the mission would restart from its beginning; "
        "set 0 to guard it"
    )


def too_fast(limits: LimitsConfig, vehicle: VehicleParameters, items: Sequence[MissionItem]) -> str | None:
    """Why a guarded mission is faster than the companion may fly, in words; None when it is not."""
    changes, own = speed_changes(items)
    asked = [(speed_mps, f"mission item {seq}: {speed_mps:g} m/s") for seq, speed_mps in changes]
    cruise = vehicle.cruise_mps or vehicle.speed_mps
    if own and cruise is not None:
        asked.append((cruise.value, _told(vehicle, cruise)))
    most_mps, who = max(asked, default=(0.0, ""))
    if DIALECTS[vehicle.firmware].own_speed_limits_missions and vehicle.speed_mps is not None:
        most_mps = min(most_mps, vehicle.speed_mps.value)
    limit_mps = effective(limits, vehicle).max_speed_mps
    if most_mps <= limit_mps * _SINGLE:
        return None
    lower = lower_ones(limits, vehicle).get("max_speed_mps")
    what = f"limits.max_speed_mps {limit_mps:g}" if lower is None else _told(vehicle, lower)
    return f"{who} is above {what}: in a conflict, the companion slows the vehicle down to that at once"


def no_receiver(vehicle: VehicleParameters) -> str | None:
    """Remark that the vehicle has no ADS-B receiver, in words; None when it has one or does not report it."""
    receiver = vehicle.adsb_type
    if receiver is None or receiver.value != 0:
        return None
    return f"{receiver.name} 0: no ADS-B receiver, so crewed traffic is not received"


def after_silence(vehicle: VehicleParameters) -> str:
    """What the vehicle does when setpoints stop, in words."""
    loss, timeout = vehicle.loss_action, vehicle.setpoint_timeout_s
    action = DIALECTS[vehicle.firmware].after_silence(None if loss is None else int(loss.value))
    if loss is not None:
        action += f" ({loss.name} {loss.value:g})"
    when = "" if timeout is None else f" for {timeout.value:g} s ({timeout.name})"
    return f"without setpoints{when} it {action}"
