"""A `flight.rearm` that the vehicle cannot keep is told before the flight."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from companion.autopilot.wire import MavlinkWriter
from companion.commands.check import check
from companion.config import AvoidanceConfig, Config, RecordConfig, VehicleConfig
from companion.runtime.flight import Flight

TOLD = "cannot restore authority on PX4"


@pytest.fixture
def link(request: pytest.FixtureRequest) -> Iterator[str]:
    """A link on which the heartbeats of the autopilot `request.param` (MAV_AUTOPILOT) come."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    ended = threading.Event()

    def serve() -> None:
        writer = MavlinkWriter(1, 1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ended.wait(0.02):
                sender.sendto(
                    writer.pack(writer.encoder.heartbeat_encode(2, request.param, 1, 5, 4)), address
                )

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield f"udpin:127.0.0.1:{address[1]}"
    ended.set()
    thread.join(60.0)


@pytest.mark.parametrize(
    ("link", "flight", "told"),
    [
        (12, {"use": "fly", "rearm": "mode"}, True),
        (12, {"use": "fly", "rearm": "disarm"}, False),
        (12, {"use": "watch", "rearm": "mode"}, False),
        (3, {"use": "fly", "rearm": "mode"}, False),
    ],
    indirect=["link"],
)
def test_an_autopilot_that_cannot_be_given_back_by_mode_is_named_by_check_and_run(
    link: str,
    flight: dict[str, str],
    told: bool,
    make_config: Callable[..., Config],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
    monkeypatch.setattr("companion.commands.check_radios._RADIO_S", 0.1)
    for name in ("_SETTLE_S", "_MEASURE_S", "_PARAMETERS_S"):
        monkeypatch.setattr(f"companion.commands.check.{name}", 0.1)
    config = msgspec.structs.replace(
        make_config(**flight),
        vehicle=VehicleConfig(link=link, wait_s=60.0),
        avoidance=AvoidanceConfig(law="none"),
        record=RecordConfig(folder=str(tmp_path)),
    )
    checked: list[str] = []
    assert check(config, checked.append) == 1 or not told
    assert any(TOLD in line for line in checked) is told
    run: list[str] = []
    companion = Flight(config, run.append, dry_run=True)
    try:
        companion._find_vehicle()
    finally:
        companion._close()
    assert any(TOLD in line for line in run) is told
