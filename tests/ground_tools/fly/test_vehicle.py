"""One vehicle, without MAVSDK: which messages count, and whether we armed it."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from companion.errors import ConfigError
from ground_tools.fly.vehicle import ARM_DISARM, Vehicle, VehicleError


@pytest.fixture
def vehicle() -> Vehicle:
    """A connected vehicle from which nothing was received yet."""
    made = object.__new__(Vehicle)
    made.name, made.system_id, made.armed_by_us = "vehicle 1", 7, False
    made._heard, made._texts = {}, []
    return made


def heartbeat(system_id: int, component_id: int, base_mode: int) -> SimpleNamespace:
    fields = json.dumps({"base_mode": base_mode})
    return SimpleNamespace(
        message_name="HEARTBEAT", system_id=system_id, component_id=component_id, fields_json=fields
    )


def test_only_its_own_autopilot_is_heard(vehicle):
    """Links may forward messages of other vehicles and ground stations."""
    vehicle._hear(heartbeat(7, 1, 128), None)
    for system_id, component_id in ((8, 1), (255, 190), (7, 191)):
        vehicle._hear(heartbeat(system_id, component_id, 0), None)
    assert vehicle.armed


def test_arming_without_an_ack_counts_as_armed_by_us(vehicle, monkeypatch):
    def silent(number: int, _: object) -> int:
        assert number == ARM_DISARM
        raise VehicleError("vehicle 1: COMPONENT_ARM_DISARM: TIMEOUT")

    monkeypatch.setattr(vehicle, "_acknowledged", silent)
    with pytest.raises(VehicleError, match="TIMEOUT"):
        vehicle.arm()
    assert vehicle.armed_by_us


def test_a_refused_arming_does_not_count_as_armed_by_us(vehicle, monkeypatch):
    monkeypatch.setattr(vehicle, "_acknowledged", lambda *_: 2)
    with pytest.raises(VehicleError, match="COMPONENT_ARM_DISARM was refused"):
        vehicle.arm()
    assert not vehicle.armed_by_us


def test_a_second_vehicle_that_is_heard_after_the_first_is_found(vehicle, monkeypatch):
    """The first one may send its heartbeats more often."""
    now_s = [100.0]
    clock = SimpleNamespace(monotonic=lambda: now_s[0], sleep=lambda s: now_s.__setitem__(0, now_s[0] + s))
    monkeypatch.setattr("ground_tools.fly.vehicle.time", clock)

    def systems() -> list[SimpleNamespace]:
        ids = (7, 8) if now_s[0] > 101.9 else (7,)
        return [SimpleNamespace(get_system_id=lambda i=i: i, has_autopilot=lambda: True) for i in ids]

    vehicle._client = SimpleNamespace(get_systems=systems)
    with pytest.raises(ConfigError, match=r"several vehicles use the address \(systems 7, 8\)"):
        vehicle._check_alone(100.0)
