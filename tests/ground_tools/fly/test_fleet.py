"""The steps with fake vehicles: which commands each vehicle receives, and which none may receive."""

from __future__ import annotations

import math

import pytest

from companion.events import Firmware, FlightMode, MissionItem
from ground_tools.fly import fleet as steps
from ground_tools.fly.fleet import Fleet, finished
from ground_tools.fly.modes import MODES
from ground_tools.fly.vehicle import ARM_DISARM, VehicleError

RTL = MissionItem(seq=2, command=20, frame=2)
WAYPOINT = MissionItem(seq=1, command=16, frame=3, lat_deg=47.4, lon_deg=8.5, alt_m=20.0)


class Made:
    """A fake vehicle with the interface that the steps use. It records the commands in `told`."""

    def __init__(self, firmware: Firmware, mode: str, *, on_ground: bool = False) -> None:
        self.name = "vehicle 1"
        self.firmware = firmware
        self.modes = MODES[firmware]
        self.first_seq = 1 if firmware is Firmware.ARDUPILOT else 0
        self.ours: frozenset[str] = frozenset()
        self.armed_by_us = True
        self.armed = True
        self.on_ground = on_ground
        self.height_m = 0.0 if on_ground else 20.0
        self.mode = mode
        self.told: list[object] = []
        self.messages: dict[str, dict[str, int]] = {}
        self.heard_s = 0.0
        """Time of the messages."""
        self.refuses = False
        self.silent = False
        self.item = 1

    def hear_again(self) -> None:
        if self.silent:
            raise VehicleError(f"{self.name}: no heartbeat for 12 s")

    def age_s(self, _: str) -> float:
        return 12.0 if self.silent else 0.1

    def said(self, _: float) -> str:
        return ""

    def last(self, name: str, since_s: float = 0.0) -> dict[str, int]:
        return self.messages.get(name, {}) if self.heard_s >= since_s else {}

    def command(self, number: int, *params: float | None) -> None:
        self.told.append((number, *params))
        if self.refuses:
            raise VehicleError(f"{self.name}: refused")

    def set_mode(self, mode: FlightMode) -> None:
        self.told.append(mode)
        self.mode = self.modes.holding


def fleet_of(*vehicles: Made) -> Fleet:
    return Fleet(vehicles, lambda _: None, [])


ARDUPILOT, PX4 = Firmware.ARDUPILOT, Firmware.PX4


@pytest.mark.parametrize(
    ("firmware", "mode", "ours", "told", "words"),
    [
        (ARDUPILOT, "AUTO", {"AUTO"}, [FlightMode.HOLD], "holds at 20.0 m in BRAKE"),
        (ARDUPILOT, "GUIDED", {"GUIDED"}, [FlightMode.HOLD], "holds at 20.0 m in BRAKE"),
        (ARDUPILOT, "GUIDED", {"AUTO"}, [], "flown by another operator at 20.0 m and was left in GUIDED"),
        (ARDUPILOT, "LOITER", {"AUTO"}, [], "flown by another operator at 20.0 m and was left in LOITER"),
        (ARDUPILOT, "LAND", {"LAND"}, [], "descends at 20.0 m and was left in LAND"),
        (ARDUPILOT, "AUTO", set(), [], "was not commanded to move"),
        (PX4, "AUTO.MISSION", {"AUTO.MISSION"}, [FlightMode.HOLD], "holds at 20.0 m in AUTO.LOITER"),
        (PX4, "AUTO.LOITER", {"AUTO.MISSION"}, [], "holds at 20.0 m in AUTO.LOITER"),
        (
            PX4,
            "OFFBOARD",
            {"AUTO.MISSION"},
            [],
            "flown by another operator at 20.0 m and was left in OFFBOARD",
        ),
        (PX4, "AUTO.RTL", {"AUTO.MISSION"}, [], "descends at 20.0 m and was left in AUTO.RTL"),
    ],
)
def test_interrupted_in_the_air(firmware, mode, ours, told, words):
    vehicle = Made(firmware, mode)
    vehicle.ours = frozenset(ours)
    vehicle.armed_by_us = bool(ours)
    assert words in fleet_of(vehicle).make_safe()["vehicle 1"]
    assert vehicle.told == told


def test_interrupted_on_the_ground():
    vehicle = Made(ARDUPILOT, "GUIDED", on_ground=True)
    vehicle.ours = vehicle.modes.climbing
    assert fleet_of(vehicle).make_safe() == {"vehicle 1": "is on the ground and was disarmed"}
    # Not forced: param 2 is not 21196.
    assert vehicle.told == [(ARM_DISARM, 0.0)]


def test_a_vehicle_that_we_did_not_arm_is_not_disarmed():
    vehicle = Made(ARDUPILOT, "AUTO", on_ground=True)
    vehicle.ours, vehicle.armed_by_us = frozenset({"AUTO"}), False
    fleet_of(vehicle).make_safe()
    assert vehicle.told == [FlightMode.HOLD]


def test_an_autopilot_that_refuses_to_disarm_is_commanded_to_hold():
    """It took off after its last telemetry."""
    vehicle = Made(ARDUPILOT, "GUIDED", on_ground=True)
    vehicle.ours, vehicle.refuses = vehicle.modes.climbing, True
    assert "holds" in fleet_of(vehicle).make_safe()["vehicle 1"]
    assert vehicle.told == [(ARM_DISARM, 0.0), FlightMode.HOLD]


def test_a_silent_vehicle_does_not_prevent_making_the_others_safe():
    lost, heard = Made(PX4, "AUTO.MISSION"), Made(PX4, "AUTO.MISSION")
    heard.name = "vehicle 2"
    lost.ours = heard.ours = frozenset({"AUTO.MISSION"})
    lost.silent = True
    done = fleet_of(lost, heard).make_safe()
    assert "its own failsafe applies" in done["vehicle 1"]
    assert heard.told == [FlightMode.HOLD]


def test_an_unexpected_error_does_not_prevent_making_the_others_safe():
    broken, heard = Made(PX4, "AUTO.MISSION"), Made(PX4, "AUTO.MISSION")
    heard.name = "vehicle 2"
    broken.ours = heard.ours = frozenset({"AUTO.MISSION"})
    broken.set_mode = lambda _: broken.messages["none"]["such"]  # type: ignore[method-assign]
    done = fleet_of(broken, heard).make_safe()
    assert "its own failsafe applies" in done["vehicle 1"]
    assert heard.told == [FlightMode.HOLD]


def test_a_vehicle_whose_mission_does_not_start_is_made_safe():
    """It hovers where our take-off ended, so it is commanded to hold."""
    vehicle = Made(ARDUPILOT, "GUIDED")
    vehicle.ours, vehicle.refuses = vehicle.modes.climbing, True
    fleet = fleet_of(vehicle)
    with pytest.raises(VehicleError, match="refused"):
        fleet.start()
    vehicle.refuses = False
    assert "holds" in fleet.make_safe()["vehicle 1"]
    assert vehicle.told[-1] is FlightMode.HOLD


def test_a_mission_that_begins_in_the_air_is_not_started_on_the_ground():
    vehicle = Made(ARDUPILOT, "GUIDED", on_ground=True)
    fleet = fleet_of(vehicle)
    fleet._missions = [(WAYPOINT, RTL)]
    with pytest.raises(VehicleError, match="does not begin with a take-off; add --takeoff"):
        fleet.start()
    assert vehicle.told == []


def test_a_mission_that_flies_is_not_replaced():
    """Both firmwares would fly the new items at once, and a part of them if the upload fails."""
    idle, flying = Made(PX4, "AUTO.LOITER"), Made(PX4, "AUTO.MISSION")
    for vehicle in (idle, flying):
        vehicle.upload = vehicle.told.append  # type: ignore[attr-defined]
    flying.name = "vehicle 2"
    with pytest.raises(VehicleError, match=r"vehicle 2: it flies a mission in AUTO\.MISSION"):
        fleet_of(idle, flying).upload([(WAYPOINT,), (WAYPOINT,)])
    assert idle.told == flying.told == []


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(("firmware", "gone_to"), [(ARDUPILOT, [1]), (PX4, [])])
def test_a_mission_that_is_uploaded_in_flight_starts_with_its_first_item(firmware, gone_to):
    """ArduPilot would continue with the item number at which the mission before was left."""
    vehicle, asked = Made(firmware, "LOITER"), []
    vehicle.item, vehicle.heard_s = 7, math.inf
    vehicle.messages["MISSION_CURRENT"] = {"mission_state": 3}

    def command(*_: object) -> None:
        vehicle.told.append(vehicle.item)
        vehicle.mode = vehicle.modes.mission

    def go_on_with(number: int) -> None:
        asked.append(number)
        vehicle.item = number

    vehicle.upload = lambda _: None  # type: ignore[attr-defined]
    vehicle.go_on_with = go_on_with  # type: ignore[attr-defined]
    vehicle.command = command  # type: ignore[method-assign]
    fleet = fleet_of(vehicle)
    fleet.upload([(WAYPOINT, RTL)])
    fleet.start()
    assert asked == gone_to
    assert vehicle.told == [1 if gone_to else 7]


@pytest.mark.usefixtures("clock")
def test_an_armed_vehicle_does_not_take_off_before_its_home_is_known():
    """The height of a take-off on PX4 is above mean sea level and follows from home."""
    vehicle = Made(PX4, "AUTO.LOITER", on_ground=True)
    with pytest.raises(VehicleError, match="vehicle 1: home did not finish within 90 s"):
        fleet_of(vehicle).take_off(10.0)
    assert vehicle.told == []


def test_a_disarmed_vehicle_is_on_the_ground_although_its_land_detector_is_not_heard():
    """PX4 arms at the start of a mission."""
    vehicle = Made(PX4, "AUTO.LOITER", on_ground=False)
    vehicle.armed = False
    fleet = fleet_of(vehicle)
    fleet._missions = [(WAYPOINT, RTL)]
    with pytest.raises(VehicleError, match="does not begin with a take-off; add --takeoff"):
        fleet.start()
    assert vehicle.told == []


@pytest.mark.parametrize(
    ("state", "reached", "answer"),
    [(5, None, True), (3, 4, False), (2, None, False), (0, 4, True), (0, 3, False), (0, None, False)],
)
def test_when_a_mission_is_flown(state, reached, answer):
    assert finished(state, reached, 4) is answer


def waiting(vehicle: Made, *items: MissionItem, seq: int, landed: bool = False) -> str | None:
    """Wait for the mission of a vehicle that is at an item. Returns the error that ended the wait, or None. A
    landed vehicle resets its item."""
    fleet = fleet_of(vehicle)
    fleet._missions = [items]
    vehicle.on_ground, vehicle.armed = False, True
    vehicle.messages["MISSION_CURRENT"] = {"seq": seq, "mission_state": 3}
    try:
        assert not fleet._is_finished(vehicle)
        if landed:
            vehicle.on_ground, vehicle.armed = True, False
            vehicle.messages["MISSION_CURRENT"]["seq"] = vehicle.first_seq
        fleet.wait()
    except VehicleError as error:
        return str(error)
    return None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A simulated clock that advances in `sleep`. After ten minutes it raises TimeoutError."""
    now, end = [0.0], [600.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds
        if now[0] > end[0]:
            end[0] += 600.0
            raise TimeoutError

    monkeypatch.setattr(steps, "time", type("", (), {"monotonic": lambda: now[0], "sleep": sleep}))


@pytest.mark.usefixtures("clock")
def test_an_rtl_outside_the_mission_does_not_complete_it():
    vehicle = Made(PX4, "AUTO.RTL")
    assert "is in AUTO.RTL, not AUTO.MISSION or OFFBOARD" in (waiting(vehicle, WAYPOINT, RTL, seq=0) or "")
    # At the item that commands the return, the wait lasts until the landing.
    with pytest.raises(TimeoutError):
        waiting(vehicle, WAYPOINT, RTL, seq=1)
    assert waiting(vehicle, WAYPOINT, RTL, seq=1, landed=True) is None
    assert "disarmed by itself" in (waiting(vehicle, WAYPOINT, RTL, seq=0, landed=True) or "")
    assert "disarmed by itself" in (waiting(vehicle, WAYPOINT, seq=0, landed=True) or "")


@pytest.mark.usefixtures("clock")
def test_an_item_that_was_reached_before_the_start_does_not_complete_the_mission():
    vehicle = Made(PX4, "AUTO.MISSION")
    fleet = fleet_of(vehicle)
    fleet._missions = [(WAYPOINT, WAYPOINT)]
    vehicle.messages = {
        "MISSION_CURRENT": {"seq": 0, "mission_state": 0},
        "MISSION_ITEM_REACHED": {"seq": 1},
    }
    steps.time.sleep(5.0)
    vehicle.heard_s = 4.0
    fleet._began_s["vehicle 1"] = 5.0
    assert not fleet._is_finished(vehicle)
    vehicle.heard_s = 6.0
    assert fleet._is_finished(vehicle)


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize("total", [{}, {"total": 0}, {"total": 0xFFFF}])
@pytest.mark.parametrize("firmware", [ARDUPILOT, PX4])
def test_without_the_number_of_items_no_return_is_the_end_of_the_mission(firmware, total):
    """A failsafe that returns in the middle of a mission that was aboard already."""
    mode = "RTL" if firmware is ARDUPILOT else "AUTO.RTL"
    vehicle = Made(firmware, mode)
    fleet = fleet_of(vehicle)
    vehicle.messages["MISSION_CURRENT"] = {"seq": 3, "mission_state": 0} | total
    with pytest.raises(VehicleError, match=f"it is in {mode}, not"):
        fleet.wait()
    vehicle.messages["MISSION_CURRENT"] = {"seq": 3, "mission_state": 3, "total": 4 - vehicle.first_seq}
    with pytest.raises(TimeoutError):
        fleet.wait()  # At the last item the return belongs to the mission.
    vehicle.on_ground, vehicle.armed = True, False
    fleet.wait()


@pytest.mark.usefixtures("clock")
def test_a_companion_may_take_control_during_a_mission():
    vehicle = Made(ARDUPILOT, "GUIDED")
    with pytest.raises(TimeoutError):
        waiting(vehicle, WAYPOINT, seq=1)
    vehicle.mode = "STABILIZE"
    assert "is in STABILIZE, not AUTO or GUIDED; a pilot or a failsafe changed the mode" in (
        waiting(vehicle, WAYPOINT, seq=1) or ""
    )


@pytest.mark.usefixtures("clock")
def test_a_moment_in_another_mode_is_forgotten_by_the_next_step():
    vehicle = Made(ARDUPILOT, "LOITER")
    fleet = fleet_of(vehicle)
    fleet._must_fly_in(vehicle, {"AUTO"})
    steps.time.sleep(60.0)
    vehicle.mode = "GUIDED"  # The mode may be this for a moment after the command to land.
    with pytest.raises(VehicleError, match="is in GUIDED, not"):
        fleet.land()
    assert steps.time.monotonic() > 63.0


@pytest.mark.usefixtures("clock")
@pytest.mark.parametrize(
    ("lost", "words"),
    [({"mode": "AUTO.RTL"}, "it is in AUTO.RTL"), ({"silent": True}, "no heartbeat for 10 s")],
)
def test_no_vehicle_starts_if_one_that_waits_at_its_start_is_lost(lost, words, monkeypatch):
    waits, comes = Made(PX4, "AUTO.MISSION"), Made(PX4, "AUTO.MISSION")
    comes.name = "vehicle 2"
    waits.place, comes.place = (47.4, 8.5, 20.0), (47.41, 8.5, 20.0)  # type: ignore[attr-defined]
    fleet = fleet_of(waits, comes)
    fleet._missions = [(WAYPOINT, WAYPOINT)] * 2
    polls, sleep = [0], steps.time.sleep

    def polled(seconds: float) -> None:
        sleep(seconds)
        polls[0] += 1
        if polls[0] == 5:
            for name, value in lost.items():
                setattr(waits, name, value)
        if polls[0] == 200:
            comes.place = waits.place  # type: ignore[attr-defined]

    monkeypatch.setattr(steps.time, "sleep", polled)
    with pytest.raises(VehicleError, match=f"vehicle 1: {words}"):
        fleet.gather()


@pytest.mark.usefixtures("clock")
def test_a_vehicle_that_falls_silent_ends_the_wait():
    vehicle = Made(ARDUPILOT, "AUTO")
    vehicle.silent = True
    assert waiting(vehicle, WAYPOINT, seq=1) == "vehicle 1: no heartbeat for 10 s"


def test_ctrl_c_ends_a_wait():
    vehicle = Made(ARDUPILOT, "AUTO")
    fleet = Fleet([vehicle], lambda _: None, [2])
    with pytest.raises(KeyboardInterrupt):
        fleet.wait()
