"""The dialect of a plug-in takes the place of the firmware that it names, and leaves it again."""

from __future__ import annotations

import dataclasses
import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion import plugins
from companion.autopilot.dialect import DIALECTS, FIRMWARES, use
from companion.autopilot.dialects import ardupilot
from companion.autopilot.dialects.definition import ModeCommand
from companion.autopilot.link import AutopilotLink
from companion.config import VehicleConfig
from companion.errors import ConfigError
from companion.events import Firmware, FlightMode, Heartbeat, SetMode
from companion.plugins import Plugin

HERON = dataclasses.replace(
    ardupilot.DIALECT,
    title="Heron",
    autopilot=mavlink.MAV_AUTOPILOT_GENERIC,
    modes={3: FlightMode.MISSION, 17: FlightMode.HOLD, 40: FlightMode.EXTERNAL},
    commands=ardupilot.DIALECT.commands | {FlightMode.EXTERNAL: ModeCommand(40, 40.0, 0.0)},
)


@pytest.fixture
def brought(monkeypatch):
    """Lets a plug-in bring an object."""

    def bring(loaded):
        monkeypatch.setattr(plugins, "load", lambda group, name: Plugin(name, "m:o", "d 1.0", loaded))

    yield bring
    use(None)


def heartbeat(autopilot, mode):
    writer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(writer.heartbeat_encode(2, autopilot, 1, mode, 3, 3).pack(writer))


def test_its_modes_are_read_and_commanded(brought):
    brought(HERON)
    link = AutopilotLink(VehicleConfig(dialect="heron"))
    (event,) = [e for e in link.receive(heartbeat(0, 40), 0.0) if isinstance(e, Heartbeat)]
    assert (event.firmware, event.mode) == (Firmware.ARDUPILOT, FlightMode.EXTERNAL)
    assert DIALECTS[event.firmware].command(FlightMode.EXTERNAL).custom_mode == 40
    link.send(SetMode(mode=FlightMode.EXTERNAL), 0.0)
    assert mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA not in FIRMWARES, "its modes would be misread"


def test_a_link_without_it_knows_the_firmware_itself(brought):
    brought(HERON)
    use("heron")
    link = AutopilotLink(VehicleConfig())
    assert DIALECTS[Firmware.ARDUPILOT] is ardupilot.DIALECT
    (event,) = [e for e in link.receive(heartbeat(3, 4), 0.0) if isinstance(e, Heartbeat)]
    assert event.mode is FlightMode.EXTERNAL


@pytest.mark.parametrize(
    ("loaded", "words"),
    [
        ("heron", "'heron' is not a companion.autopilot.dialects.definition.Dialect"),
        (dataclasses.replace(HERON, modes={3: FlightMode.MISSION}), "mode external is not commanded"),
        (dataclasses.replace(HERON, commands={}), "mode external is not commanded"),
        (dataclasses.replace(HERON, autopilot=12), "MAV_AUTOPILOT 12 is that of PX4"),
        (
            dataclasses.replace(HERON, wanted=(dataclasses.replace(HERON.wanted[0], field="wings"),)),
            "'wings' is no field of VehicleParameters",
        ),
        (dataclasses.replace(HERON, take_from={"external"}), "take_from: a value has a wrong type"),
        (dataclasses.replace(HERON, modes=HERON.modes | {5: None}), "Heron: Expected `str`, got `null`"),
        (dataclasses.replace(HERON, mode_known_s=math.nan), "mode_known_s: a value has a wrong"),
        (dataclasses.replace(HERON, names=object()), "Heron: Encoding objects of type object"),
    ],
)
def test_one_that_does_not_hold_together_is_refused(brought, loaded, words):
    brought(loaded)
    with pytest.raises(ConfigError) as refused:
        AutopilotLink(VehicleConfig(dialect="heron"))
    assert str(refused.value).startswith("vehicle.dialect: ")
    assert words in str(refused.value)
    assert DIALECTS[Firmware.ARDUPILOT] is ardupilot.DIALECT
