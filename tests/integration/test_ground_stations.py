"""Clients that share no code with us read and set our parameters, and fetch what they mean, over UDP on
loopback: MAVSDK, and pymavlink's for parameters and for files."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavparm import MAVParmDict

from companion.adjustable_parameters import NAMES
from companion.autopilot.link import AutopilotLink
from companion.autopilot.served.component_information import ComponentInformation
from companion.autopilot.served.metadata import metadata_files
from companion.autopilot.served.own_parameters import OwnParameters
from companion.autopilot.wire import MavlinkWriter
from companion.config import Config, IdentityConfig, VehicleConfig
from companion.events import Settings
from companion.radio.ether.section import EtherRadio
from tests.support.waiting import PATIENCE_S, until

CONFIG = Config(identity=IdentityConfig(uas_id="OWN"), radio=(EtherRadio(address="127.0.0.1:1"),))
FILES = {path: content.decode() for path, content in metadata_files(CONFIG).items()}
VALUES = dict(zip(NAMES, (1.0, 5.0, 20.0, 5.0), strict=True))


class Aboard:
    """An autopilot's heartbeat and our link behind one port, as behind a router."""

    def __init__(self) -> None:
        self.parameters = OwnParameters(CONFIG, Settings())
        self.link = AutopilotLink(
            VehicleConfig(), settings=self.parameters, information=ComponentInformation(CONFIG)
        )
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self.port = self._socket.getsockname()[1]
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        autopilot, station, beat_s = MavlinkWriter(1, 1), None, 0.0
        while not self._end.is_set():
            with contextlib.suppress(TimeoutError, ConnectionError):
                data, station = self._socket.recvfrom(65536)
                self.link.receive(data, time.monotonic())
            now_s = time.monotonic()
            self.link.advance(now_s)
            out = self.link.drain()
            if now_s >= beat_s:
                beat_s = now_s + 0.3
                heartbeat = autopilot.pack(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
                self.link.receive(heartbeat, now_s)
                out += heartbeat
            if station is not None and out:
                with contextlib.suppress(ConnectionError):
                    self._socket.sendto(out, station)

    def close(self) -> None:
        self._end.set()
        self._thread.join()
        self._socket.close()


@pytest.fixture
def aboard():
    companion = Aboard()
    yield companion
    companion.close()


def test_mavsdk_reads_sets_and_learns_what_they_mean(aboard: Aboard, tmp_path: Path) -> None:
    mavsdk = pytest.importorskip("mavsdk", reason="mavsdk is not installed")
    from mavsdk.plugins.component_metadata import ComponentMetadata, MetadataType
    from mavsdk.plugins.ftp import Ftp, FtpResult
    from mavsdk.plugins.param import Param, ParamError, ParamResult, ProtocolVersion

    ground = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    with mavsdk.Mavsdk(ground) as client:
        assert client.add_any_connection(f"udpout://127.0.0.1:{aboard.port}").name == "SUCCESS"
        system = client.first_autopilot(PATIENCE_S)
        assert system is not None
        until(lambda: 191 in system.component_ids())

        param = Param(system)
        # 4.1 selects it and reports UNKNOWN.
        with contextlib.suppress(ParamError):
            param.select_component(191, ProtocolVersion.V1)
        assert {p.name: p.value for p in param.get_all_params().float_params} == VALUES
        assert param.get_param_float("DMUCA_HORIZON") == 20.0
        assert param.set_param_float("DMUCA_RADIUS", 7.5) == ParamResult.SUCCESS
        assert aboard.parameters.settings == Settings(conflict_radius_m=7.5)
        with pytest.raises(ParamError):
            param.set_param_float("DMUCA_RADIUS", 500.0)
        assert param.get_param_float("DMUCA_RADIUS") == 7.5
        assert aboard.parameters.settings == Settings(conflict_radius_m=7.5)
        assert aboard.link.counts.settings_refused > 0

        files = Ftp(system)
        files.set_target_compid(191)
        for path, burst in zip(FILES, (False, True), strict=True):
            ended: list[FtpResult] = []
            files.download_async(path, str(tmp_path), burst, lambda r, *_, to=ended: to.append(r))
            until(lambda to=ended: to and to[-1] != FtpResult.NEXT)
            assert ended[-1] == FtpResult.SUCCESS
            assert (tmp_path / path).read_text() == FILES[path]
            assert files.are_files_identical(str(tmp_path / path), path)

        metadata = ComponentMetadata(system)
        told: list[object] = []
        metadata.subscribe_metadata_available(lambda update, _: told.append(update))
        metadata.request_component(191)
        until(lambda: told)
        assert metadata.get_metadata(191, MetadataType.PARAMETER).json_metadata == FILES["parameter.json"]


@pytest.fixture
def station(aboard: Aboard):
    connection = mavutil.mavlink_connection(
        f"udpout:127.0.0.1:{aboard.port}", source_system=255, source_component=190, dialect="ardupilotmega"
    )
    connection.mav.heartbeat_send(6, 8, 0, 0, 4)
    until(lambda: aboard.link.vehicle is not None)
    connection.target_system, connection.target_component = 1, 191
    yield connection
    connection.close()


def test_pymavlinks_parameter_client_reads_and_sets(aboard: Aboard, station) -> None:
    def told():
        message = station.recv_match(type="PARAM_VALUE", blocking=True, timeout=PATIENCE_S)
        assert message is not None
        return message.param_id, message.param_value

    station.param_fetch_all()
    assert dict(told() for _ in NAMES) == VALUES
    client = MAVParmDict()
    assert client.mavset(station, "DMUCA_HORIZON", 30)
    assert aboard.parameters.settings == Settings(horizon_s=30.0)
    # It takes any answer for a success, even one with another value.
    client.mavset(station, "DMUCA_HORIZON", 500)
    station.param_fetch_one("DMUCA_HORIZON")
    assert told() == ("DMUCA_HORIZON", 30.0)
    assert aboard.parameters.settings == Settings(horizon_s=30.0)


def test_pymavlinks_file_client_fetches_the_files(station, tmp_path: Path) -> None:
    """It reads in bursts of 80 bytes."""
    mavftp = pytest.importorskip("pymavlink.mavftp")
    client = mavftp.MAVFTP(station, 1, 191)
    for path, content in FILES.items():
        got = tmp_path / path
        assert client.cmd_get([path, str(got)]).error_code == mavftp.FtpError.Success
        assert client.process_ftp_reply("OpenFileRO", timeout=PATIENCE_S).error_code == 0
        assert json.loads(got.read_text()) == json.loads(content)


def test_pymavlink_is_told_that_a_command_is_not_supported(station) -> None:
    def send(component: int, command: int) -> None:
        station.mav.command_long_send(1, component, command, 0, 1, 0, 0, 0, 0, 0, 0)

    # What is sent to the autopilot and to all stays theirs; the last one ends the wait.
    for component in (1, 0, 191):
        send(component, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    send(191, mavlink.MAV_CMD_NAV_TAKEOFF)
    told = [station.recv_match(type="COMMAND_ACK", blocking=True, timeout=PATIENCE_S) for _ in range(2)]
    assert [(ack.get_srcComponent(), ack.command, ack.result) for ack in told] == [
        (191, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, mavlink.MAV_RESULT_UNSUPPORTED),
        (191, mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_RESULT_UNSUPPORTED),
    ]
    assert all((ack.target_system, ack.target_component) == (255, 190) for ack in told)
