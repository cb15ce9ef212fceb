"""Remote ID of one aircraft: rates against the region's minimum, losses, latencies, ages."""

from pathlib import Path

import pytest

from companion.config import Config, IdentityConfig
from companion.events import Broadcast, BroadcastChanged, RadioState, RemoteIdHeard, VehicleTime
from companion.remote_id.messages import BasicId, IdType, Location, UaType
from companion.remote_id.region import Region
from ground_tools.inspect.explain.air import gather
from tests.ground_tools.inspect.flights import decision, read, step, track

REGION = Region(
    name="test",
    transport_sets=(("wifi",),),
    location_period_s=1.0,
    basic_id_period_s=3.0,
    beacon_channels=(6,),
    beacon_period_elsewhere_s=0.2,
)
CONFIG = Config(identity=IdentityConfig(uas_id="ONE"), region=REGION)
ON = BroadcastChanged(rates=(("wifi", 1.0),), legal=True, reason="")


def name_of(uas_id):
    return BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id=uas_id)


def sends(times, *, channel=6, before=(ON,), transport="wifi"):
    """Broadcasts of a message pack at each time."""
    pack = (
        BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="ONE"),
        Location(),
    )
    found = [step(0.0, *before, events=(RadioState(can_send=("wifi",), wifi_channel=channel),))]
    return found + [step(t, Broadcast(transport=transport, messages=pack)) for t in times]


def lane(found, message="Location"):
    return next(row for row in found["sent"] if row["message"] == message)


def test_a_gap_longer_than_the_legal_limit_is_a_violation(tmp_path: Path) -> None:
    kept = lane(gather(read(tmp_path / "a", CONFIG, sends([1.0, 2.0, 3.0, 4.0]))))
    assert (kept["kept"], kept["longest_s"], kept["legal_s"], kept["rate_hz"]) == (True, 1.0, 1.0, 1.0)
    found = gather(read(tmp_path / "b", CONFIG, sends([1.0, 2.0, 3.05, 4.05])))
    late = lane(found)
    assert (late["kept"], late["over_legal"], late["longest_at_s"]) == (False, 1, 3.05)
    assert lane(found, "BasicId")["kept"] is True


def test_the_legal_minimum_depends_on_the_wifi_channel(tmp_path: Path) -> None:
    row = lane(gather(read(tmp_path, CONFIG, sends([1.0, 2.0, 3.0], channel=1))))
    assert (row["legal_s"], row["kept"]) == (0.2, False)


def test_the_minimum_rate_applies_only_while_a_transport_is_on_the_air(tmp_path: Path) -> None:
    """A transport is stopped and started again. No message was due in between."""
    off = BroadcastChanged(rates=(), legal=True, reason="")
    steps = sends([1.0, 2.0])
    steps += [step(2.5, off), step(20.0, ON), *sends([20.5, 21.5])[1:]]
    row = lane(gather(read(tmp_path, CONFIG, steps)))
    assert (row["kept"], row["longest_s"], row["count"]) == (True, 1.0, 4)


def test_time_that_was_not_legal_is_summed_with_its_reasons(tmp_path: Path) -> None:
    bad = BroadcastChanged(rates=(), legal=False, reason="no radio")
    steps = [step(1.0, bad), step(4.0, ON), step(6.0, bad), step(7.5)]
    found = gather(read(tmp_path, CONFIG, steps))
    assert found["not_legal_s"] == pytest.approx(4.5)
    assert found["not_legal_because"] == ["no radio"]


def frame(counter, stamp_s=None):
    messages = (
        name_of("TWO"),
        Location(lat_deg=47.0, lon_deg=8.0, timestamp_s=stamp_s),
    )
    return RemoteIdHeard(transport="wifi", address="c2:00", messages=messages, counter=counter)


@pytest.mark.parametrize(
    ("counters", "lost", "of"),
    [
        ([250, 251, 252, 253], 0, 3),
        ([254, 255, 1, 2], 1, 4),  # none lost, the counter wraps around
        ([10, 12, 11, 13], 0, 3),  # 11 arrived late, it was not lost
        ([10, 10, 11], 0, 1),  # repeated content
        ([10, 200, 201], 0, 1),  # the counter was reset
        ([None, None], None, None),
    ],
)
def test_losses_are_counted_by_the_frames_counters(tmp_path: Path, counters, lost, of) -> None:
    steps = [step(float(t), events=(frame(c),)) for t, c in enumerate(counters)]
    (row,) = gather(read(tmp_path, CONFIG, steps))["heard"]
    assert (row["lost"], row["lost_of"]) == (lost, of)
    assert row["identities"] == ["TWO"]


def test_latency_is_by_utc_and_over_the_hour(tmp_path: Path) -> None:
    utc = VehicleTime(time_boot_s=0.0, utc_s=1_767_225_600.0 - 1.0)  # one second before the hour
    steps = [step(0.0, events=(utc, frame(1, 3598.6)))]
    steps += [step(2.0, events=(frame(2, 0.2),)), step(3.0, events=(frame(3, 0.0),))]
    (row,) = gather(read(tmp_path / "utc", CONFIG, steps))["heard"]
    assert row["latency"]["median_s"] == pytest.approx(0.8)
    assert row["latency"]["worst_s"] == pytest.approx(2.0)
    (row,) = gather(read(tmp_path / "none", CONFIG, steps[1:]))["heard"]
    assert row["latency"] is None


def test_own_frames_that_are_received_back_are_ignored(tmp_path: Path) -> None:
    own = step(0.0, events=(RadioState(own_addresses=("c2:00",)),))
    assert gather(read(tmp_path, CONFIG, [own, step(1.0, events=(frame(1),))]))["heard"] == []


def test_ages_are_those_that_the_law_decided_with(tmp_path: Path) -> None:
    steps = [step(k / 5, decision(track(age_s=k / 100))) for k in range(101)]
    (row,) = gather(read(tmp_path, CONFIG, steps))["ages"]
    assert (row["track"], row["adsb"]) == ("TWO", False)
    assert [row[key] for key in ("median_s", "p95_s", "worst_s")] == pytest.approx([0.5, 0.95, 1.0])
