"""The own broadcast: where the operator is, whether it is on the air, and who else broadcasts."""

from __future__ import annotations

from itertools import pairwise

import msgspec
import pytest

from companion.broadcast.own_messages import OPERATOR_FRESH_S
from companion.events import (
    ArmStatus,
    BroadcastChanged,
    Landed,
    OperatorData,
    RadioState,
    RemoteIdHeard,
    RemoteIdModule,
    Severity,
)
from companion.radio.ether.section import EtherRadio
from companion.remote_id.messages import (
    BasicId,
    ClassificationType,
    IdType,
    Location,
    OperatorId,
    OperatorLocationType,
    SelfId,
    Status,
    System,
)
from companion.remote_id.region import Region
from tests.companion.broadcast.on_air import configured, said, told

UTC_S = 1_767_225_600.0
OWN = "c2:00:00:00:00:01"


def ground_station(bench, stamp_s, lat_deg=47.5, **more):
    fields = {
        "operator_location_type": OperatorLocationType.LIVE_GNSS,
        "operator_lat_deg": lat_deg,
        "operator_lon_deg": 8.5,
        "timestamp_utc_s": stamp_s,
        **more,
    }
    bench.extra.append(OperatorData(messages=(System(**fields),)))


def test_the_operator_is_where_the_ground_station_says_while_it_says_so(bench):
    ground_station(bench, UTC_S + 1.0)
    system = told(bench, System)[-1]
    assert system.operator_location_type is OperatorLocationType.LIVE_GNSS
    assert system.operator_lat_deg == 47.5
    system = told(bench, System, OPERATOR_FRESH_S + 1.0)[-1]
    assert system.operator_location_type is OperatorLocationType.TAKEOFF
    assert system.operator_lat_deg != 47.5


def test_a_position_that_is_only_repeated_grows_stale(bench):
    for second in range(round(OPERATOR_FRESH_S) + 2):
        ground_station(bench, UTC_S + 1.0)
        systems = told(bench, System, 1.0)
        fresh = systems[-1].operator_location_type is OperatorLocationType.LIVE_GNSS
        assert fresh == (second + 1 <= OPERATOR_FRESH_S)
    ground_station(bench, UTC_S + 2.0)
    assert told(bench, System)[-1].operator_location_type is OperatorLocationType.LIVE_GNSS


def test_without_a_timestamp_each_repetition_counts(bench):
    for _ in range(round(OPERATOR_FRESH_S) + 2):
        ground_station(bench, None)
        assert told(bench, System, 1.0)[-1].operator_lat_deg == 47.5


def test_ground_stations_that_repeat_in_turn_prove_nothing(bench):
    for second in range(round(OPERATOR_FRESH_S) + 4):
        ground_station(bench, UTC_S + 100.0 * (second % 2))
        system = told(bench, System, 1.0)[-1]
    assert system.operator_location_type is OperatorLocationType.TAKEOFF


def test_a_ground_station_whose_clock_is_set_back_is_heard_on(bench):
    for second in range(30):
        ground_station(bench, UTC_S + second - (5.0 if second > 10 else 0.0))
        system = told(bench, System, 1.0)[-1]
        assert system.operator_location_type is OperatorLocationType.LIVE_GNSS


def test_a_ground_station_without_a_position_takes_none_from_another(bench):
    for second in range(6):
        ground_station(bench, UTC_S + second, lat_deg=None if second % 2 else 47.5)
        assert told(bench, System, 1.0)[-1].operator_lat_deg == 47.5


def test_a_ground_station_without_a_position_is_no_operator_position(bench):
    ground_station(bench, UTC_S + 1.0, lat_deg=None)
    assert told(bench, System)[-1].operator_location_type is OperatorLocationType.TAKEOFF


def test_the_take_off_point_is_the_last_place_on_the_ground(make_bench):
    bench = make_bench(use="watch")
    bench.landed, bench.armed = Landed.ON_GROUND, False
    bench.step(20)
    bench.landed, bench.armed, bench.north_m = Landed.IN_AIR, True, 500.0
    system = told(bench, System)[-1]
    assert system.operator_location_type is OperatorLocationType.TAKEOFF
    assert system.operator_lat_deg == pytest.approx(bench.lat_deg, abs=1e-6)


def test_ids_of_the_ground_station_are_sent_unless_configured(bench):
    bench.extra.append(
        OperatorData(
            messages=(
                SelfId(description_type=0, text="SURVEY"),
                OperatorId(operator_id_type=0, operator_id="GCS-OP"),
            )
        )
    )
    assert told(bench, SelfId)[-1].text == "SURVEY"
    assert told(bench, OperatorId)[-1].operator_id == "GCS-OP"
    mine = configured(bench, self_id="MAPPING", operator_id="MY-OP")
    mine.extra.append(OperatorData(messages=(SelfId(description_type=0, text="SURVEY"),)))
    assert {m.text for m in told(mine, SelfId)} == {"MAPPING"}
    assert {m.operator_id for m in told(mine, OperatorId)} == {"MY-OP"}


def test_eu_classification_where_configured(bench):
    assert told(bench, System)[-1].classification_type is ClassificationType.UNDECLARED
    system = told(configured(bench, category_eu=1, class_eu=5), System)[-1]
    assert (system.classification_type, system.category_eu, system.class_eu) == (ClassificationType.EU, 1, 5)


# ---------------------------------------------------------------- is it on the air?


def monitored(bench, **more):
    bench.extra.append(RadioState(can_send=("wifi",), monitored=("wifi",), own_addresses=(OWN,), **more))


def echo(bench, address=OWN, transport="wifi"):
    bench.extra.append(
        RemoteIdHeard(transport=transport, address=address, messages=(SelfId(description_type=0, text="x"),))
    )


def test_an_own_frame_that_is_not_heard_back_is_a_failure_until_it_is(bench):
    monitored(bench)
    commands = bench.step(95)
    assert not said(commands)
    commands = bench.step(20)
    assert said(commands) == [(Severity.WARNING, "DMUCA own Remote ID not heard on wifi")]
    assert any(isinstance(c, BroadcastChanged) for c in commands)
    assert {m.status for m in told(bench, Location)} == {Status.REMOTE_ID_SYSTEM_FAILURE}
    echo(bench)
    assert {m.status for m in told(bench, Location)} == {Status.AIRBORNE}
    assert not said(bench.step(60))
    echo(bench)
    assert said(bench.step(20)) == [(Severity.INFO, "DMUCA Remote ID works again")]


def test_what_comes_and_goes_is_told_to_the_pilot_once(bench):
    """A radio that fails at every second step, and works again at the others."""
    config = bench.core.config
    bench.core.broadcaster._config = msgspec.structs.replace(config, radio=(EtherRadio(address="x:1"),))
    texts = []
    for number in range(600):
        bench.extra.append(RadioState(can_send=("wifi",) if number % 2 else ()))
        texts += said(bench.step())
    assert texts == [(Severity.WARNING, "DMUCA Remote ID not sent: radio cannot send on wifi")]
    assert said(bench.step(110)) == [(Severity.INFO, "DMUCA Remote ID works again")]


def test_a_trouble_that_changes_all_the_time_is_told_now_and_then(bench):
    bench.armed = False
    texts = []
    for number in range(34):
        bench.extra.append(RemoteIdModule(component_id=236, ready=False, text=f"reason {number}"))
        texts += said(bench.step(20))
    assert texts[0] == (Severity.WARNING, "DMUCA Remote ID module not ready: reason 4")
    assert 5 <= len(texts) <= 7


def test_somebody_elses_frame_does_not_count(bench):
    monitored(bench)
    for _ in range(130):
        echo(bench, address="c2:00:00:00:00:02")
        echo(bench, transport="ble5")
        bench.step()
    assert bench.core.broadcaster.trouble == "own Remote ID not heard on wifi"


def test_frames_heard_back_keep_it_quiet(bench):
    monitored(bench)
    for n in range(400):
        if n % 40 == 0:
            echo(bench)
        assert not said(bench.step())


def test_without_a_second_receiver_nothing_is_claimed(bench):
    assert not said(bench.step(400))
    assert bench.core.broadcaster.trouble is None


def test_a_module_that_confirms_counts_as_heard(bench):
    monitored(bench, confirmed=("wifi",))
    assert not said(bench.step(200))
    monitored(bench, confirmed=())
    assert said(bench.step(200)) == [(Severity.WARNING, "DMUCA own Remote ID not heard on wifi")]


def test_a_radio_that_sends_nothing_is_said(bench):
    config = bench.core.config
    bench.core.broadcaster._config = msgspec.structs.replace(config, radio=(EtherRadio(address="x:1"),))
    bench.extra.append(RadioState(can_send=(), text="controller gone" + 1000 * "!"))
    ((severity, text),) = said(bench.step())
    assert severity is Severity.WARNING
    assert text.startswith("DMUCA Remote ID not sent: radio cannot send on wifi: controller gone!!!")
    assert len(text) < 200


def test_the_radios_own_reason_is_told_with_the_trouble(bench):
    monitored(bench, confirmed=(), text="module refuses: missing operator location")
    assert said(bench.step(130)) == [
        (
            Severity.WARNING,
            "DMUCA own Remote ID not heard on wifi: module refuses: missing operator location",
        )
    ]
    monitored(bench, confirmed=(), text="module refuses: missing operator location, 2 s")
    assert not said(bench.step(130))


def lawful(bench):
    """A fresh bench in a region that asks for operator data."""
    config = bench.core.config
    region = Region(name="eu", transport_sets=(("wifi",),), location_period_s=1.0, operator_id_required=True)
    return type(bench)(type(bench.core)(msgspec.structs.replace(config, region=region)))


def test_what_the_law_asks_and_nobody_has_told_is_said_once_in_flight(bench):
    mine = lawful(bench)
    assert said(mine.step(100)) == [(Severity.WARNING, "DMUCA Remote ID: missing operator location")]
    for second in range(3):
        ground_station(mine, UTC_S + second)
        commands = mine.step(20)
        assert said(commands) == [(Severity.WARNING, "DMUCA Remote ID: missing operator_id message")] * (
            second == 0
        )
    mine.extra.append(OperatorData(messages=(OperatorId(operator_id_type=0, operator_id="OP"),)))
    assert not said(mine.step(20))
    assert mine.core.broadcaster.lacking is None
    assert bench.core.broadcaster.lacking is None


def test_what_is_missing_in_turn_is_said_once_each(bench):
    """A GNSS fix at the edge, and no operator position."""
    mine = lawful(bench)
    texts = []
    for number in range(600):
        mine.fix_type = 3 if number % 2 else 0
        texts += said(mine.step())
    assert sorted(text for _, text in texts) == [
        "DMUCA Remote ID: missing location message",
        "DMUCA Remote ID: missing operator location",
    ]


def test_what_is_missing_is_said_now_and_then_to_a_pilot_who_arms_and_disarms(bench):
    mine = lawful(bench)
    texts = []
    for number in range(600):
        mine.armed = bool(number % 2)
        texts += said(mine.step())
    assert 5 <= len(texts) <= 7


def test_on_the_ground_nobody_is_bothered(bench):
    mine = lawful(bench)
    mine.armed = False
    assert not said(mine.step(100))
    assert mine.core.broadcaster.lacking == "missing operator location"


# ---------------------------------------------------------------- we are the Remote ID component


def statuses(commands):
    return [(c.ready, c.text) for c in commands if isinstance(c, ArmStatus)]


def test_arm_status_says_what_is_missing_then_that_all_is_there(bench):
    mine = configured(bench, component=True)
    mine.stuck_position = True
    assert statuses(mine.step(3))[-1] == (False, "missing location message")
    mine.stuck_position = False
    assert statuses(mine.step(40))[-1] == (False, "missing operator location")
    ground_station(mine, UTC_S + 1.0)
    assert not statuses(mine.step(90))
    assert statuses(mine.step(15)) == [(True, "")]
    assert not statuses(mine.step(20))


def test_arm_status_of_a_radio_that_seems_to_work_now_and_then_stays_bad(bench):
    """Each second it tries again, and counts as able to send for one step."""
    mine = configured(bench, component=True)
    radio = (EtherRadio(address="x:1"),)
    mine.core.broadcaster._config = msgspec.structs.replace(mine.core.config, radio=radio)
    ground_station(mine, UTC_S + 1.0)
    assert statuses(mine.step(200))[-1] == (True, "")
    told = []
    for step in range(400):
        mine.extra.append(RadioState(can_send=("wifi",) if step % 20 == 19 else ()))
        ground_station(mine, UTC_S + mine.now_s)
        told += statuses(mine.step())
    assert told == [(False, "Remote ID not sent: radio cannot send on wifi")]
    mine.extra.append(RadioState(can_send=("wifi",)))
    ground_station(mine, UTC_S + mine.now_s)
    assert statuses(mine.step(130)) == [(True, "")]


def test_arm_status_without_an_identity(bench):
    config = bench.core.config
    identity = msgspec.structs.replace(config.identity, id_type=IdType.NONE)
    remote_id = msgspec.structs.replace(config.remote_id, component=True)
    config = msgspec.structs.replace(config, identity=identity, remote_id=remote_id)
    mine = type(bench)(type(bench.core)(config))
    assert statuses(mine.step(5))[-1] == (False, "missing basic_id message")


def test_nobody_is_told_who_only_watches(bench):
    assert not statuses(bench.step(100))


def test_every_pack_holds_all_messages(bench):
    packs = [
        c.messages for c in configured(bench, self_id="A", operator_id="B").step(60) if hasattr(c, "messages")
    ]
    assert packs
    for messages in packs:
        assert [type(m) for m in messages] == [BasicId, Location, System, SelfId, OperatorId]


@pytest.mark.parametrize(("rate", "period_s"), [(1, 0.5), (10, 0.1)])
def test_ble4_begins_with_its_name(make_bench, rate, period_s):
    """A receiver that misses the first Basic ID avoids an aircraft it knows from Wi-Fi a second time."""
    bench = make_bench()
    bench.core.broadcaster.ask({"wifi": 10})
    bench.extra = [RadioState(can_send=("ble4", "wifi"), wifi_channel=6)]
    bench.step(100)
    began_s = bench.now_s
    bench.core.broadcaster.ask({"ble4": rate, "wifi": 10})
    sent = []
    for _ in range(160):
        sent += [
            (bench.now_s - began_s, {type(m) for m in c.messages})
            for c in bench.step(1)
            if getattr(c, "transport", None) == "ble4"
        ]
    named_s = [s for s, kinds in sent if BasicId in kinds]
    first_s = [s for s in named_s if s < 3.05]
    assert all(BasicId in kinds for s, kinds in sent if s < 3.0 and Location in kinds)
    assert max(b - a for a, b in pairwise(first_s)) <= period_s + 0.051
    later = [b - a for a, b in pairwise(s for s in named_s if s > 3.05)]
    assert min(later) > 0.7


def test_a_higher_rate_takes_effect_at_once(make_bench):
    bench = make_bench()
    bench.core.broadcaster.ask({"wifi": 1})
    bench.extra = [RadioState(can_send=("wifi",), wifi_channel=6)]
    while not any(hasattr(c, "transport") for c in bench.step(1)):
        pass
    bench.step(22)  # the next Location is due in about a second
    while not any(hasattr(c, "transport") for c in bench.step(1)):
        pass
    bench.core.broadcaster.ask({"wifi": 10})
    assert any(hasattr(c, "transport") for c in bench.step(3))
