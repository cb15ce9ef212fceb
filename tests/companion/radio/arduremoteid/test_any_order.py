"""The ArduRemoteID radio survives whatever happens, in any order."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.autopilot.wire import MavlinkWriter
from companion.errors import ConfigError
from companion.radio.arduremoteid.module_messages import Module
from companion.radio.arduremoteid.module_radio import RATES
from companion.remote_id.messages import (
    OperatorId,
    SelfId,
)
from companion.remote_id.transports import BLE4
from sitl_mocks.remote_id_module.module import ModuleOptions
from tests.companion.radio.arduremoteid.bench import TRAPS, Bench, Wire, messages


@pytest.mark.parametrize("name", ["LOCK_LEVEL", "TO_DEFAULTS", "OPTIONS", "WIFI_POWER", "WIFI_CHANNEL"])
def test_nothing_but_rates_can_be_set(name: str) -> None:
    wire = Wire(ModuleOptions())
    module = Module(wire, 7)
    with pytest.raises(ValueError, match="allowed: only rates"):
        module.set(name, 1.0)
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="above 0"):
            module.set("BT4_RATE", rate)


ACTIONS = st.one_of(
    st.tuples(st.just("broadcast"), st.sampled_from(sorted(RATES)), st.integers(0, 63)),
    st.tuples(st.just("wait"), st.floats(0.05, 4.0)),
    st.tuples(st.just("reboot")),
    st.tuples(st.just("cut")),
    st.tuples(st.just("bytes"), st.binary(max_size=300)),
    st.tuples(st.just("configure"), st.dictionaries(st.sampled_from(sorted(RATES)), st.integers(0, 6))),
)
ALL = (*messages(5.0), SelfId(description_type=0, text="s"), OperatorId(operator_id_type=0, operator_id="o"))


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(sorted(TRAPS)), st.lists(ACTIONS, max_size=25))
def test_in_any_order_of_things_the_module_is_never_ruined(trap: str, actions: list[tuple[Any, ...]]) -> None:
    bench = Bench(**TRAPS[trap])
    started = False
    for action, *arguments in actions:
        if action == "broadcast":
            transport, mask = arguments
            chosen = tuple(m for bit, m in enumerate(ALL) if mask >> bit & 1)
            try:
                bench.radio.broadcast(transport, chosen, bench.wire.now_s)
                started = True
            except ValueError:
                assert transport not in bench.radio.capabilities
        elif action == "wait":
            bench.wait(arguments[0])
        elif action == "reboot":
            bench.module.reboot(bench.wire.now_s)
        elif action == "cut":
            bench.wire.cut = not bench.wire.cut
        elif action == "bytes":
            bench.wire.extra = arguments[0]
        else:
            writes = len(bench.module.param_sets)
            with contextlib.suppress(ConfigError):
                bench.radio.configure(arguments[0])
            assert not started or len(bench.module.param_sets) == writes
        health = bench.health()
        assert health.can_send <= bench.radio.capabilities
        assert health.confirmed is None or health.confirmed <= health.can_send
    assert bench.module.catastrophes == []
    assert {name for name, _ in bench.module.param_sets} <= set(RATES.values())
    assert all(1.0 <= value <= 5.0 for _, value in bench.module.param_sets)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(st.tuples(st.sampled_from((0, 1, 22, 253, 12918, 12901)), st.binary(max_size=60)), max_size=12)
)
def test_frames_of_any_content_are_survived_and_kept_small(frames: list[tuple[int, bytes]]) -> None:
    bench = Bench()
    writer = MavlinkWriter(1, 236)
    for message_id, payload in frames:
        bench.wire.extra += writer.pack_payload(message_id, payload or b"\0")
    bench.wait(0.1)
    bench.radio.broadcast(BLE4, messages(1.0), bench.wire.now_s)
    health = bench.health()
    assert health.text.isascii()
    assert health.text.isprintable()
    assert len(health.text) < 500
    module = bench.radio._module
    assert len(module.raw) <= 512
    assert len(module.params) <= 9
