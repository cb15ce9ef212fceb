"""Heron, a fork of ArduCopter that was invented for this example.

It flies setpoints in a mode of its own, and changes to BRAKE after the last item of a mission.
"""

import dataclasses

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects import ardupilot
from companion.autopilot.dialects.definition import ModeCommand
from companion.events import FlightMode

OBEY = 40

DIALECT = dataclasses.replace(
    ardupilot.DIALECT,  # its firmware is ArduPilot, whose place it takes
    title="Heron",
    autopilot=mavlink.MAV_AUTOPILOT_GENERIC,
    vehicles="multirotors and helicopters on Heron",
    modes={3: FlightMode.MISSION, 5: FlightMode.STICKS, 17: FlightMode.HOLD, OBEY: FlightMode.EXTERNAL},
    commands=ardupilot.DIALECT.commands | {FlightMode.EXTERNAL: ModeCommand(OBEY, float(OBEY), 0.0)},
    names=ardupilot.DIALECT.names | {OBEY: "OBEY"},
    take_from_names="OBEY or AUTO",
    mission_ends_in_hold=True,
)
