"""Parameters as both firmwares tell them, damaged and missing ones, and when they are asked for again."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.dialects.ardupilot import DIALECT as ARDUPILOT
from companion.autopilot.dialects.definition import Dialect
from companion.autopilot.dialects.px4 import DIALECT as PX4
from companion.autopilot.polled.parameters import MAX_TRIES
from companion.events import Event, Firmware, Parameter, VehicleParameters
from tests.companion.autopilot.conftest import PX4 as PX4_ID
from tests.companion.autopilot.conftest import Scripted

INT8, INT16, INT32, REAL32, REAL64 = 2, 4, 6, 9, 10
BOTH = pytest.mark.parametrize("dialect", [ARDUPILOT, PX4], ids=lambda d: d.firmware.value)


def value(name: str, number: float, kind: int = REAL32) -> Any:
    return mavlink.MAVLink_param_value_message(name.encode(), number, kind, 1000, 65535)


def bytewise(name: str, number: int, kind: int = INT32, layout: str = "<i") -> Any:
    (laid,) = struct.unpack("<f", struct.pack(layout, number))
    return value(name, laid, kind)


def asked(scripted: Scripted) -> list[str]:
    requests = scripted.told("PARAM_REQUEST_READ")
    assert all((m.target_system, m.target_component, m.param_index) == (1, 1, -1) for m in requests)
    return [m.param_id for m in requests]


def heard(autopilot: int = 3) -> Scripted:
    """A vehicle that has just been heard, with all its parameters asked for."""
    scripted = Scripted(autopilot=autopilot)
    scripted.heartbeat()
    scripted.after(0.1)
    return scripted


def last(events: list[Event]) -> VehicleParameters:
    (told,) = (e for e in events[-1:] if isinstance(e, VehicleParameters))
    return told


# ---------------------------------------------------------------- the table


@BOTH
def test_the_table_names_fields_and_names_that_fit(dialect: Dialect) -> None:
    fields = [wanted.field for wanted in dialect.wanted]
    assert len(set(fields)) == len(fields)
    assert set(fields) <= set(VehicleParameters.__struct_fields__) - {"firmware"}
    for wanted in dialect.wanted:
        assert wanted.lowest < wanted.highest
        assert all(0 < len(name) <= 16 and scale > 0 for name, scale in wanted.names)


def test_every_action_of_px4_has_its_words() -> None:
    (loss,) = (w for w in PX4.wanted if w.field == "loss_action")
    words = [PX4.after_silence(n) for n in range(int(loss.lowest), int(loss.highest) + 1)]
    assert PX4.silence not in words
    assert {PX4.after_silence(n) for n in PX4.crashing_actions} == {"terminates the flight", "disarms"}


# ---------------------------------------------------------------- values


@pytest.mark.parametrize(
    ("names", "scale"),
    [
        (("WP_SPD", "WP_SPD_UP", "WP_SPD_DN", "WP_ACC"), 1.0),
        (("WPNAV_SPEED", "WPNAV_SPEED_UP", "WPNAV_SPEED_DN", "WPNAV_ACCEL"), 100.0),
    ],
)
def test_both_generations_of_ardupilot_tell_the_same(names: tuple[str, ...], scale: float) -> None:
    scripted = heard()
    assert set(names) < set(asked(scripted))
    numbers = (8.0, 2.5, 1.5, 2.0)
    told = last(scripted.says(*(value(n, x * scale) for n, x in zip(names, numbers, strict=True))))
    found = (told.speed_mps, told.climb_mps, told.descent_mps, told.acceleration_mps2)
    assert found == tuple(Parameter(name=n, value=x) for n, x in zip(names, numbers, strict=True))
    # The other generation's names are not asked for any more.
    scripted.after(1.1)
    assert set(asked(scripted)) == {
        "GUID_TIMEOUT", "FENCE_ENABLE", "MIS_RESTART", "ADSB_TYPE", "ADSB_ENABLE", "ADSB_LIST_RADIUS",
    }  # fmt: skip


@pytest.mark.parametrize("name", ["ADSB_TYPE", "ADSB_ENABLE"])
def test_ardupilot_tells_of_its_receiver_by_either_name(name: str) -> None:
    """4.7-dev answers for both with ADSB_TYPE 0, too: INT8 and INT32."""
    scripted = heard()
    assert name in asked(scripted)
    told = last(scripted.says(value(name, 1.0, INT8), value("ADSB_LIST_RADIUS", 2000.0, INT32)))
    assert told.adsb_type == Parameter(name=name, value=1.0)
    assert told.adsb_radius_m == Parameter(name="ADSB_LIST_RADIUS", value=2000.0)
    scripted.after(1.1)
    assert not {n for n in asked(scripted) if n.startswith("ADSB")}


def test_ardupilot_casts_what_px4_lays_bytewise() -> None:
    cast = last(heard().says(value("FENCE_ENABLE", 1.0, INT8)))
    assert cast.fence_action == Parameter(name="FENCE_ENABLE", value=1.0)
    told = last(heard(PX4_ID).says(bytewise("COM_OBL_RC_ACT", 3), value("MPC_XY_VEL_MAX", 12.0)))
    assert told.firmware is Firmware.PX4
    assert told.loss_action == Parameter(name="COM_OBL_RC_ACT", value=3.0)
    assert told.speed_mps == Parameter(name="MPC_XY_VEL_MAX", value=12.0)
    small = last(heard(PX4_ID).says(bytewise("GF_ACTION", 2, INT16, "<hxx")))
    assert small.fence_action == Parameter(name="GF_ACTION", value=2.0)


def test_a_cast_read_bytewise_or_the_other_way_is_not_believed() -> None:
    for scripted, message in (
        (heard(PX4_ID), value("COM_OBL_RC_ACT", 3.0, INT32)),
        (heard(PX4_ID), value("GF_ACTION", 1.0, REAL64)),
        (heard(), bytewise("FENCE_ENABLE", 1, INT8)),
        (heard(), value("FENCE_ENABLE", 0.5, INT8)),
        (heard(), value("FENCE_ENABLE", math.nan, INT8)),
    ):
        assert scripted.says(message) == []
        assert scripted.link.counts.bad_values == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 0.0, -500.0, 1e9, 1e38])
def test_senseless_values_are_counted_and_what_was_known_stays(bad: float) -> None:
    scripted = heard()
    scripted.says(value("WPNAV_SPEED", 800.0))
    assert scripted.says(value("WPNAV_SPEED", bad)) == []
    assert scripted.link.counts.bad_values == 1
    assert scripted.link.last_bad is not None
    assert "WPNAV_SPEED" in scripted.link.last_bad
    assert scripted.link.parameters is not None
    assert scripted.link.parameters.speed_mps == Parameter(name="WPNAV_SPEED", value=8.0)
    other = heard()
    other.says(value("WPNAV_SPEED", bad))
    assert other.link.parameters == VehicleParameters(firmware=Firmware.ARDUPILOT)
    other.told()
    other.after(1.1)
    # Asking again would not mend it.
    assert "WPNAV_SPEED" not in asked(other)


def test_names_that_nobody_wants_and_damaged_ones_are_left_out() -> None:
    scripted = heard()
    odd = (value("RTL_ALT", 1500.0), value("", 1.0), value("WPNAV_SPEE", 1.0))
    assert scripted.says(*odd) == []
    raw = mavlink.MAVLink_param_value_message(b"\xff\xfe\x80WPNAV_SPEED", 1.0, REAL32, 1, 0)
    assert scripted.says(raw) == []
    assert scripted.link.counts.bad_values == 0


def test_a_value_that_a_ground_station_sets_counts() -> None:
    scripted = heard()
    scripted.says(value("WPNAV_SPEED", 800.0))
    assert scripted.says(value("WPNAV_SPEED", 800.0)) == []
    told = last(scripted.says(value("WPNAV_SPEED", 300.0)))
    assert told.speed_mps == Parameter(name="WPNAV_SPEED", value=3.0)


# ---------------------------------------------------------------- asking


@BOTH
def test_silence_is_asked_a_few_times_and_then_believed(dialect: Dialect) -> None:
    scripted = Scripted(autopilot=3 if dialect is ARDUPILOT else PX4_ID)
    assert not scripted.link.asking
    scripted.heartbeat()
    assert scripted.link.asking
    requests: list[str] = []
    for _ in range(200):
        scripted.heartbeat()
        scripted.after(0.1)
        requests += asked(scripted)
    names = [name for wanted in dialect.wanted for name, _ in wanted.names]
    assert sorted(requests) == sorted(names * MAX_TRIES)
    assert not scripted.link.asking
    assert scripted.link.counts.parameter_requests == len(requests)


def test_nobody_is_asked_when_all_is_told() -> None:
    scripted = heard(PX4_ID)
    scripted.told()
    for wanted in PX4.wanted:
        name = wanted.names[0][0]
        scripted.says(bytewise(name, 3) if wanted.field.endswith("action") else value(name, 3.0))
    assert not scripted.link.asking
    assert scripted.link.parameters is not None
    assert None not in {getattr(scripted.link.parameters, wanted.field) for wanted in PX4.wanted}
    scripted.after(1.1)
    assert asked(scripted) == []


def test_a_reboot_and_a_drop_ask_again_and_what_was_known_counts_meanwhile(ardupilot: Scripted) -> None:
    everything = {name for wanted in ARDUPILOT.wanted for name, _ in wanted.names}
    ardupilot.says(value("WPNAV_SPEED", 800.0), ardupilot.position(60_000))
    for _ in range(8):
        ardupilot.heartbeat()
        ardupilot.after(1.0)
    assert not ardupilot.link.asking
    ardupilot.told()
    ardupilot.says(ardupilot.position(400))
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == everything
    assert ardupilot.link.parameters is not None
    assert ardupilot.link.parameters.speed_mps == Parameter(name="WPNAV_SPEED", value=8.0)
    for _ in range(8):
        ardupilot.heartbeat()
        ardupilot.after(1.0)
    assert not ardupilot.link.asking
    ardupilot.after(5.0)
    ardupilot.told()
    ardupilot.heartbeat()
    ardupilot.after(0.1)
    assert set(asked(ardupilot)) == everything


def test_another_vehicles_parameters_are_not_ours(ardupilot: Scripted) -> None:
    foreign = ardupilot.says(value("WPNAV_SPEED", 100.0), system=2)
    foreign += ardupilot.says(value("WPNAV_SPEED", 100.0), component=25)
    assert foreign == []
    assert ardupilot.link.counts.foreign == 2
    assert ardupilot.link.parameters == VehicleParameters(firmware=Firmware.ARDUPILOT)


def test_a_vehicle_that_cannot_be_commanded_is_not_asked() -> None:
    rover = Scripted()
    rover.heartbeat(vehicle_type=10)
    rover.after(0.1)
    assert asked(rover) == []
    assert rover.says(value("WPNAV_SPEED", 800.0)) == []
    assert not rover.link.asking
