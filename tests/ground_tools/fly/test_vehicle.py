"""One vehicle, without MAVSDK: which messages count, and whether we armed it."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

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
