"""Input (events) and output (commands) of the core, each an immutable value.

They are `msgspec` structs (frozen, slotted, compared by value), so that the recorder writes them and the
replay reads them without a second definition. Units are SI, vectors are local NED, and unknown values are
`None`. Each file of this package holds the types of one subject; import all of them from here.
"""

from __future__ import annotations

from companion.events.authority import (
    AllowanceSpent,
    AuthorityChanged,
    GateAuthority,
    GateRefused,
    InputBehind,
    Settings,
)
from companion.events.base import Command, Event
from companion.events.remote_id import (
    ArmStatus,
    Broadcast,
    BroadcastChanged,
    OperatorData,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    TransportsChosen,
)
from companion.events.sensed import Attitude, ObstaclePoint, ObstacleScan, SensedAircraft
from companion.events.stored import (
    DownloadFence,
    DownloadMission,
    FenceArea,
    FenceDownloaded,
    FenceRefused,
    MissionCurrent,
    MissionDownloaded,
    MissionItem,
    MissionRefused,
    Parameter,
    VehicleParameters,
)
from companion.events.texts import Say, Severity, VehicleText
from companion.events.traffic import (
    AdsbVehicle,
    AlertChanged,
    Decision,
    Threat,
    TrackFlagged,
    TrackView,
    TrafficReport,
)
from companion.events.vehicle import (
    SIGMA_UNKNOWN_M,
    AirPressure,
    ClockRead,
    CurrentMode,
    EstimatorState,
    Firmware,
    FlightMode,
    GlobalPosition,
    GnssFix,
    Heartbeat,
    Landed,
    LandedState,
    LocalPosition,
    ModeRefused,
    RcChannels,
    SecondCompanion,
    SetMode,
    SetSpeed,
    TwoAutopilots,
    VehicleTime,
    VelocitySetpoint,
)

__all__ = [
    "SIGMA_UNKNOWN_M", "AdsbVehicle", "AirPressure", "AlertChanged", "AllowanceSpent", "AnyCommand",
    "AnyEvent", "ArmStatus", "Attitude", "AuthorityChanged", "Broadcast", "BroadcastChanged", "ClockRead",
    "Command", "CurrentMode", "Decision", "DownloadFence", "DownloadMission", "EstimatorState", "Event",
    "FenceArea", "FenceDownloaded", "FenceRefused", "Firmware", "FlightMode", "GateAuthority", "GateRefused",
    "GlobalPosition", "GnssFix", "Heartbeat", "InputBehind", "Landed", "LandedState", "LocalPosition",
    "MissionCurrent", "MissionDownloaded", "MissionItem", "MissionRefused", "ModeRefused", "ObstaclePoint",
    "ObstacleScan", "OperatorData", "Parameter", "RadioState", "RcChannels", "RemoteIdHeard",
    "RemoteIdModule", "Say", "SecondCompanion", "SensedAircraft", "SetMode", "SetSpeed", "Settings",
    "Severity", "Threat", "TrackFlagged", "TrackView", "TrafficReport", "TransportsChosen", "TwoAutopilots",
    "VehicleParameters", "VehicleText", "VehicleTime", "VelocitySetpoint",
]  # fmt: skip

AnyEvent = (
    Heartbeat | CurrentMode | TwoAutopilots | GlobalPosition | LocalPosition | GnssFix | VehicleTime
    | AirPressure | ClockRead | LandedState | EstimatorState | RcChannels | ModeRefused | MissionDownloaded
    | MissionRefused | MissionCurrent | FenceDownloaded | FenceRefused | VehicleParameters | AdsbVehicle
    | VehicleText | InputBehind | GateRefused | GateAuthority | RemoteIdHeard | RadioState | OperatorData
    | RemoteIdModule | Settings | Attitude | ObstacleScan | ObstaclePoint | SensedAircraft | SecondCompanion
)  # fmt: skip

AnyCommand = (
    VelocitySetpoint | SetMode | SetSpeed | DownloadMission | DownloadFence | Threat | Say | ArmStatus
    | Broadcast | AuthorityChanged | BroadcastChanged | TransportsChosen | TrackFlagged | AlertChanged
    | Decision | AllowanceSpent | TrafficReport
)  # fmt: skip
