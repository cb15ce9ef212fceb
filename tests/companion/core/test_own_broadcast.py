"""What the core broadcasts, and how it recognises its own frames when it hears them."""

from __future__ import annotations

import msgspec
import pytest

from companion.events import (
    Broadcast,
    RadioState,
    RemoteIdHeard,
)
from companion.remote_id.messages import Location, Status
from companion.replay import on_air
from tests.companion.core.conftest import UTC_IN_HOUR_S, intruder


def test_broadcast_rate_and_content(flying):
    commands = flying.step(200)
    broadcasts = [c for c in commands if isinstance(c, Broadcast)]
    assert len(broadcasts) == 10
    _, location, system = broadcasts[0].messages
    assert location.alt_geodetic_m == pytest.approx(497.0)
    assert location.height_m == pytest.approx(50.0)
    assert location.timestamp_s == pytest.approx((UTC_IN_HOUR_S + flying.now_s) % 3600.0, abs=11.0)
    assert system.operator_lat_deg is None


def test_a_lost_own_position_is_broadcast_as_a_failure_not_as_silence(flying):
    flying.stuck_position = True
    flying.step(40)
    broadcast = next(c for c in flying.step(40) if isinstance(c, Broadcast))
    location = broadcast.messages[1]
    assert location.status is Status.REMOTE_ID_SYSTEM_FAILURE
    assert location.lat_deg is None


def test_own_echo_is_not_traffic(flying):
    broadcast = next(c for c in flying.step(40) if isinstance(c, Broadcast))
    messages = tuple(on_air(m) if isinstance(m, Location) else m for m in broadcast.messages)
    flying.extra = [RemoteIdHeard(transport="wifi", address="02:00", messages=messages)]
    flying.step()
    assert not flying.core.traffic.tracks
    assert flying.core.traffic.counts.own_echo == 1
    stranger = intruder(flying, 400.0, 3.0, uas_id="OWN")
    flying.extra = [stranger]
    flying.step()
    assert len(flying.core.traffic.tracks) == 1


def test_own_ble4_frames_come_back_before_their_name(flying):
    """A second receiver of ours hears the Location of BLE 4 before it has heard a Basic ID."""
    broadcast = next(c for c in flying.step(40) if isinstance(c, Broadcast))
    location = next(on_air(m) for m in broadcast.messages if isinstance(m, Location))
    own = "c2:00:00:00:00:01"
    flying.extra = [RadioState(can_send=("wifi",), own_addresses=(own,))]
    flying.step()
    flying.extra = [RemoteIdHeard(transport="ble4", address=own, messages=(location,))]
    flying.step()
    assert not flying.core.traffic.tracks
    flying.extra = [RemoteIdHeard(transport="ble4", address="c2:00:00:00:00:02", messages=(location,))]
    flying.step()
    assert len(flying.core.traffic.tracks) == 1
    away = msgspec.structs.replace(location, lat_deg=location.lat_deg + 0.003)
    flying.extra = [RemoteIdHeard(transport="ble4", address=own, messages=(away,))]
    flying.step()
    assert len(flying.core.traffic.tracks) == 2


def test_an_own_frame_without_a_time_may_come_back_late(flying):
    flying.velocity_ned_mps = (20.0, 0.0, 0.0)
    own = "c2:00:00:00:00:01"
    flying.extra = [RadioState(can_send=("wifi",), own_addresses=(own,))]
    sent = None
    for _ in range(60):
        flying.north_m += 1.0
        for command in flying.step():
            if isinstance(command, Broadcast):
                sent = sent or (flying.now_s, command)
    while flying.now_s < sent[0] + 1.0:
        flying.north_m += 1.0
        flying.step()
    messages = tuple(
        msgspec.structs.replace(on_air(m), timestamp_s=None) if isinstance(m, Location) else m
        for m in sent[1].messages
    )
    flying.extra = [RemoteIdHeard(transport="wifi", address=own, messages=messages)]
    flying.step()
    assert not flying.core.traffic.tracks
