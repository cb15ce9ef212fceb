"""`companion check` says what `companion run` will do: both prepare real modules and access points."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.autopilot.wire import MavlinkWriter
from companion.config import ArduRemoteIdRadio, Config, RecordConfig, VehicleConfig, WifiRadio
from companion.errors import ConfigError
from companion.events import Firmware, Parameter, VehicleParameters
from companion.radio import wifi
from companion.radio.arduremoteid import ArduRemoteIdTransport
from companion.radio.frames_io import radio_address
from companion.radio.hostapd import ApStatus
from companion.radio.transport import Transport
from companion.radio.wifi import WifiTransport
from companion.remote_id.region import Region
from companion.runtime import radios
from companion.runtime.check import _judge_parameters, check
from companion.runtime.flight import Flight
from sitl_mocks.remote_id_module import ModuleOptions, RemoteIdModule

REGIONS = Path(__file__).parents[3] / "config" / "regions"
NOT_READY = "check: NOT ready"


class Wire:
    """A link to a module."""

    def __init__(self, options: ModuleOptions) -> None:
        self.module = RemoteIdModule(options, time.monotonic())

    def wait(self, timeout_s: float) -> None:
        time.sleep(min(timeout_s, 0.005))

    def receive(self, now_s: float) -> bytes:
        self.module.advance(time.monotonic())
        return self.module.drain()

    def send(self, data: bytes) -> None:
        self.module.receive(data, time.monotonic())

    def close(self) -> None:
        """The module stays."""


class AccessPoint:
    """A running hostapd on channel 11."""

    path = "/run/hostapd/wlan0"
    trouble: str | None = None
    updates = 0

    def __init__(self, path: str) -> None:
        self.status = ApStatus("ENABLED", "02:00:00:aa:bb:cc", 11, 100)

    def poll(self, now_s: float) -> None:
        """Nothing to do."""

    def close(self) -> None:
        """Nothing to release."""


@pytest.fixture
def vehicle() -> Iterator[int]:
    """Port on which a vehicle, system 1, answers to whoever connects."""
    server = socket.create_server(("127.0.0.1", 0))
    server.settimeout(0.05)
    ended = threading.Event()

    def serve() -> None:
        writer, peers = MavlinkWriter(1, 1), list[socket.socket]()
        while not ended.wait(0.02):
            with contextlib.suppress(TimeoutError):
                peers.append(server.accept()[0])
            for peer in list(peers):
                try:
                    peer.sendall(writer.pack(writer.encoder.heartbeat_encode(2, 3, 1, 5, 4)))
                except OSError:
                    peers.remove(peer)
                    peer.close()
        for peer in peers:
            peer.close()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield server.getsockname()[1]
    ended.set()
    thread.join(60.0)
    server.close()


Both = Callable[..., tuple[list[str], list[str]]]


@pytest.fixture
def both(
    vehicle: int, make_config: Callable[..., Config], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Both:
    """What `check` says of such radios, and then what `run` says before it flies, or why it does not.

    Radios are a `Wire` to a module, an `AccessPoint`, or an error.
    """

    def say_both(
        *parts: Any, region: str = "us", system_id: int = 1, **remote_id: Any
    ) -> tuple[list[str], list[str]]:
        left: list[Any] = []

        def open_radio(*_: object) -> Transport:
            part = left.pop(0)
            if isinstance(part, Exception):
                raise part
            if isinstance(part, Wire):
                return ArduRemoteIdTransport(part, system_id, time.monotonic, "the module")
            return WifiTransport(WifiRadio(hostapd=AccessPoint.path), radio_address("OWN"))

        monkeypatch.setattr(wifi, "HostapdControl", AccessPoint)
        monkeypatch.setattr(radios, "open_radio", open_radio)
        monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
        base = make_config(use="watch")
        law = msgspec.toml.decode((REGIONS / f"{region}.toml").read_bytes(), type=Region)
        config = msgspec.structs.replace(
            base,
            vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{vehicle}", wait_s=60.0),
            record=RecordConfig(folder=str(tmp_path)),
            remote_id=msgspec.structs.replace(base.remote_id, **remote_id),
            region=msgspec.structs.replace(
                law, serial_number="any", operator_id="any", operator_id_required=False
            ),
            radio=tuple(ArduRemoteIdRadio(link="serial:/dev/x:1", system_id=system_id) for _ in parts),
        )
        checked: list[str] = []
        left[:] = parts
        code = check(config, checked.append)
        assert code == (0 if checked[-1] == "check: ready" else 1)
        run: list[str] = []
        left[:] = parts
        try:
            Flight(config, run.append, dry_run=False)._close()
        except ConfigError as error:
            run.append(str(error))
        return checked, run

    return say_both


def module(**params: float) -> Wire:
    return Wire(ModuleOptions(boot_s=0.0, params={"UAS_TYPE": 2.0, "UAS_ID_TYPE": 1.0, **params}))


def test_a_rate_that_the_module_cannot_send_is_refused_by_both(both: Both) -> None:
    wire = module()
    checked, run = both(wire, transports=("wifi",), rate=8)
    refusal = "radio[0]: the module: wifi: 8 messages a second; the module sends 1 to 5"
    assert refusal in checked
    assert checked[-1] == NOT_READY
    assert run[-1] == refusal


def test_a_locked_module_is_refused_by_both(both: Both) -> None:
    wire = module(LOCK_LEVEL=1.0)
    checked, run = both(wire, transports=("wifi",), rate=2)
    (refusal,) = (line for line in checked if "the module is locked (LOCK_LEVEL 1)" in line)
    assert checked[-1] == NOT_READY
    assert run[-1] == refusal
    assert wire.module.param_sets == []


def test_what_the_check_says_would_be_set_is_what_run_sets(
    both: Both, monkeypatch: pytest.MonkeyPatch
) -> None:
    wire = module()
    sets_at_check: list[int] = []
    close = ArduRemoteIdTransport.close

    def counted(self: ArduRemoteIdTransport) -> None:
        sets_at_check.append(len(wire.module.param_sets))
        close(self)

    monkeypatch.setattr(ArduRemoteIdTransport, "close", counted)
    checked, run = both(wire, transports=("wifi",), rate=2)
    assert "remote ID: wifi 2/s" in checked
    assert "radio: would set WIFI_BCN_RATE to 2 (it is 0)" in checked
    assert checked[-1] == "check: ready"
    assert "remote ID: wifi 2/s" in run
    assert "radio: set WIFI_BCN_RATE to 2 (was 0)" in run
    assert sets_at_check == [0, 1]
    assert wire.module.param_sets == [("WIFI_BCN_RATE", 2.0)]


def test_the_rate_that_the_law_asks_for_on_a_channel_is_the_one_that_is_told(both: Both) -> None:
    line = "remote ID: wifi at least 5/s (region eu asks for wifi on channel 11 every 0.2 s, not 2/s)"
    for said in both(AccessPoint, region="eu", transports=("wifi",), rate=2):
        assert line in said


def test_a_module_that_is_told_to_be_another_vehicles_is_warned_of(both: Both) -> None:
    checked, _ = both(module(), system_id=7)
    (warning,) = (line for line in checked if line.startswith("radio[0].system_id: 7"))
    assert "but the vehicle is system 1" in warning
    assert "set system_id = 1" in warning
    checked, _ = both(module())
    assert not any("system_id" in line for line in checked)


def test_every_bad_radio_is_told_before_the_vehicle_is_waited_for(both: Both) -> None:
    checked, run = both(ConfigError("no such port"), module(), ConfigError("no such card"))
    at = [checked.index(line) for line in ("radio[0]: no such port", "radio[2]: no such card")]
    assert any(line.startswith("radio[1]: ArduRemoteID") for line in checked)
    assert max(at) < next(n for n, line in enumerate(checked) if line.startswith("vehicle: "))
    assert checked[-1] == NOT_READY
    assert run[-1] == "radio[0]: no such port"


def test_a_single_bad_radio_is_not_called_the_null_backend(both: Both) -> None:
    checked, _ = both(ConfigError("no such port"))
    assert "radio[0]: no such port" in checked
    assert not any("backend null" in line for line in checked)


def test_a_path_that_the_vehicle_cannot_fly_is_not_ready(make_config: Callable[..., Config]) -> None:
    def judge(use: str, told: VehicleParameters | None) -> tuple[bool, list[str]]:
        said: list[str] = []
        return _judge_parameters(make_config(use=use), told, said.append), said

    slow = VehicleParameters(
        firmware=Firmware.PX4,
        speed_mps=Parameter(name="MPC_XY_VEL_MAX", value=2.0),
        setpoint_timeout_s=Parameter(name="COM_OF_LOSS_T", value=0.2),
        loss_action=Parameter(name="COM_OBL_RC_ACT", value=3.0),
    )
    ready, said = judge("fly", slow)
    assert not ready
    assert said[0] == "vehicle: without setpoints for 0.2 s (COM_OF_LOSS_T) it returns (COM_OBL_RC_ACT 3)"
    assert "vehicle: MPC_XY_VEL_MAX 2 is below limits.max_speed_mps 5: the vehicle's limit counts" in said
    assert any(line.startswith("vehicle: COM_OF_LOSS_T 0.2 s is short") for line in said)
    assert "is above the vehicle's MPC_XY_VEL_MAX 2" in said[-1]
    assert judge("watch", slow) == (True, [])
    ready, said = judge("fly", VehicleParameters(firmware=Firmware.ARDUPILOT))
    assert ready
    assert any("does not tell how fast it flies" in line for line in said)
    assert judge("fly", None) == (True, [])
