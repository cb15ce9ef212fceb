"""`companion check` says what `companion run` will do: both prepare real modules and access points."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from companion.broadcast.legal_floor import keep_floor
from companion.commands.check import _judge_parameters, check
from companion.commands.check_containment import judge_containment, judge_mission
from companion.commands.preflight import Preflight
from companion.config import Config, RecordConfig, TrafficConfig, VehicleConfig
from companion.errors import ConfigError
from companion.events import (
    Firmware,
    MissionDownloaded,
    MissionItem,
    MissionRefused,
    Parameter,
    VehicleParameters,
)
from companion.radio.arduremoteid.module_radio import ArduRemoteIdTransport
from companion.radio.arduremoteid.section import ArduRemoteIdRadio
from companion.radio.frames_io import radio_address
from companion.radio.radio import Radio
from companion.radio.wifi import wifi_radio
from companion.radio.wifi.hostapd import ApStatus
from companion.radio.wifi.section import WifiRadio
from companion.radio.wifi.wifi_radio import WifiTransport
from companion.remote_id.region import Region
from companion.runtime import prepare, radios
from companion.runtime.flight import Flight
from companion.toml_reader import decode_toml
from sitl_mocks.remote_id_module.module import ModuleOptions, RemoteIdModule
from tests.companion.commands.conftest import Vehicle

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
        """Keep the module open."""


class AccessPoint:
    """A running hostapd on channel 11."""

    path = "/run/hostapd/wlan0"
    trouble: str | None = None
    updates = 0

    def __init__(self, path: str) -> None:
        self.status = ApStatus("ENABLED", "02:00:00:aa:bb:cc", 11, 100)

    def poll(self, now_s: float) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Nothing to release."""


def plain(lines: list[str]) -> list[str]:
    """The printed findings without colours and advice."""
    return [re.sub(r"^(green|yellow|red) +", "", line).split("\n")[0] for line in lines]


Both = Callable[..., tuple[list[str], list[str]]]


@pytest.fixture
def both(
    vehicle: Vehicle,
    make_config: Callable[..., Config],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kept_signals: None,
) -> Both:
    """What `check` says of such radios, and then what `run` says before it flies, or why it does not.

    Radios are a `Wire` to a module, an `AccessPoint`, or an error.
    """

    def say_both(
        *parts: Any, region: str = "us", system_id: int = 1, **remote_id: Any
    ) -> tuple[list[str], list[str]]:
        left: list[Any] = []

        def open_radio(*_: object) -> Radio:
            part = left.pop(0)
            if isinstance(part, Exception):
                raise part
            if isinstance(part, Wire):
                return ArduRemoteIdTransport(part, system_id, time.monotonic, "the module")
            return WifiTransport(WifiRadio(hostapd=AccessPoint.path), radio_address("OWN"))

        monkeypatch.setattr(wifi_radio, "HostapdControl", AccessPoint)
        monkeypatch.setattr(radios, "open_radio", open_radio)
        monkeypatch.setattr("companion.runtime.flight.warm_up", lambda: 0.0)
        monkeypatch.setattr("companion.runtime.flight._ARMED_S", 0.1)
        base = make_config(use="watch")
        law = msgspec.toml.decode((REGIONS / f"{region}.toml").read_bytes(), type=Region)
        config = msgspec.structs.replace(
            base,
            vehicle=VehicleConfig(link=f"tcp:127.0.0.1:{vehicle.port}", wait_s=60.0),
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
            flight = Flight(config, run.append, dry_run=False)
            if flight._radio_trouble is None:
                flight._close()
            else:
                flight.run()
        except ConfigError as error:
            run.append(str(error))
        return plain(checked), run

    return say_both


def module(**params: float) -> Wire:
    return Wire(ModuleOptions(boot_s=0.0, params={"UAS_TYPE": 2.0, "UAS_ID_TYPE": 1.0, **params}))


def test_a_rate_that_the_module_cannot_send_is_refused_by_both(both: Both) -> None:
    wire = module()
    checked, run = both(wire, transports=("wifi",), rate=8)
    refusal = "radio[0]: the module: wifi: 8 messages a second; allowed: 1 to 5"
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
    line = "remote ID: wifi 6.25/s (region eu asks for wifi on channel 11 every 0.2 s, not 2/s)"
    for said in both(AccessPoint, region="eu", transports=("wifi",), rate=2):
        assert line in said


@pytest.mark.parametrize(
    ("rate", "words"),
    [(1, "wifi 1.25/s (region us asks for wifi every 1 s, sent with a margin)"), (2, "wifi 2/s")],
)
def test_the_rate_that_is_told_is_the_one_with_the_margin_to_the_law(rate: int, words: str) -> None:
    """The schedule sends a Location every 0.8 s where the law asks for one every second."""
    region = decode_toml(REGIONS / "us.toml", Region)
    decided = keep_floor({"wifi": rate}, region, frozenset({"wifi"}))
    assert prepare._on_air(decided, region, None) == words


def test_a_module_that_is_told_to_be_another_vehicles_is_warned_of(both: Both) -> None:
    checked, _ = both(module(), system_id=7)
    (warning,) = (line for line in checked if line.startswith("radio[0].system_id: 7"))
    assert "but the vehicle is system 1" in warning
    checked, _ = both(module())
    assert not any("system_id" in line for line in checked)


def test_every_bad_radio_is_told_before_the_vehicle_is_waited_for(both: Both) -> None:
    checked, run = both(ConfigError("no such port"), module(), ConfigError("no such card"))
    at = [checked.index(line) for line in ("radio[0]: no such port", "radio[2]: no such card")]
    assert any(line.startswith("radio[1]: ArduRemoteID") for line in checked)
    assert max(at) < next(n for n, line in enumerate(checked) if line.startswith("vehicle: "))
    assert checked[-1] == NOT_READY
    assert run[-1] == "radio[0]: no such port; radio[2]: no such card"


def test_a_single_bad_radio_is_not_called_the_null_backend(both: Both) -> None:
    checked, _ = both(ConfigError("no such port"))
    assert "radio[0]: no such port" in checked
    assert not any("backend null" in line for line in checked)


def test_a_path_that_the_vehicle_cannot_fly_is_not_ready(make_config: Callable[..., Config]) -> None:
    def judge(use: str, told: VehicleParameters | None) -> tuple[bool, list[str]]:
        found = Preflight()
        _judge_parameters(make_config(use=use), told, found)
        return found.ready, [f"{finding.what}: {finding.text}" for finding in found.findings]

    slow = VehicleParameters(
        firmware=Firmware.PX4,
        speed_mps=Parameter(name="MPC_XY_VEL_MAX", value=2.0),
        setpoint_timeout_s=Parameter(name="COM_OF_LOSS_T", value=0.2),
        loss_action=Parameter(name="COM_OBL_RC_ACT", value=3.0),
    )
    ready, said = judge("fly", slow)
    assert not ready
    assert said[0] == "vehicle: without setpoints for 0.2 s (COM_OF_LOSS_T) it returns (COM_OBL_RC_ACT 3)"
    assert "vehicle: MPC_XY_VEL_MAX 2 is below limits.max_speed_mps 5: the vehicle's limit applies" in said
    assert any(line.startswith("vehicle: COM_OF_LOSS_T 0.2 s is too short") for line in said)
    assert "is above the vehicle's MPC_XY_VEL_MAX 2" in said[-1]
    assert judge("watch", slow) == (True, [])
    ready, said = judge("fly", VehicleParameters(firmware=Firmware.ARDUPILOT))
    assert ready
    assert any("does not report its speed limits" in line for line in said)
    assert judge("fly", None) == (True, [])


def test_the_mission_that_is_to_be_guarded(make_config: Callable[..., Config]) -> None:
    told = VehicleParameters(firmware=Firmware.ARDUPILOT, speed_mps=Parameter(name="WP_SPD", value=9.6))
    place = MissionItem(seq=2, command=16, frame=6, lat_deg=47.0, lon_deg=8.0, alt_m=30.0)
    slow = MissionItem(seq=1, command=178, frame=2, params=(1.0, 4.0, -1.0, 0.0))

    def judge(mission: MissionDownloaded | MissionRefused | None) -> list[tuple[str, str]]:
        found = Preflight()
        judge_mission(make_config(use="guard"), told, mission, found)
        assert found.ready
        assert all(bool(f.do) is (f.light.value != "green") for f in found.findings)
        assert {f.what for f in found.findings} <= {"mission", "containment"}
        return [(f.light.value, f.text) for f in found.findings if f.what == "mission"]

    fast = (
        "yellow",
        "WP_SPD 9.6 is above limits.max_speed_mps 5: in a conflict, the companion slows the vehicle down to "
        "that at once",
    )
    assert judge(MissionDownloaded(items=(slow, place))) == [("green", "2 items, read from the vehicle")]
    assert judge(MissionDownloaded(items=(place,))) == [("green", "1 items, read from the vehicle"), fast]
    assert judge(MissionDownloaded(items=())) == [("yellow", "the vehicle has none"), fast]
    assert judge(MissionRefused(reason="item 3 of 5 did not come")) == [
        ("yellow", "not read: item 3 of 5 did not come"),
        fast,
    ]
    assert judge(None) == [("yellow", "not read: the vehicle did not finish sending it"), fast]


def test_the_containment_is_told(make_config: Callable[..., Config]) -> None:
    told = VehicleParameters(firmware=Firmware.PX4)

    def place(seq: int, north_m: float, alt_m: float) -> MissionItem:
        lat_deg = 47.0 + north_m / 111_170.0
        return MissionItem(seq=seq, command=16, frame=6, lat_deg=lat_deg, lon_deg=8.0, alt_m=alt_m)

    found = Preflight()
    judge_mission(
        make_config(use="guard"),
        told,
        MissionDownloaded(items=(place(1, 0.0, 40.0), place(2, 1000.0, 60.0))),
        found,
    )
    assert [f.text for f in found.findings if f.what == "containment"] == [
        "the volume is 1300 m from south to north, 300 m from west to east; 10 to 90 m above home, within "
        "floor and ceiling"
    ]
    found = Preflight()
    config = make_config(use="guard")
    wide = msgspec.structs.replace(config.avoidance, crewed_horizontal_m=600.0)
    narrow = msgspec.structs.replace(config.containment, crewed_side_m=500.0, then="hold")
    judge_containment(msgspec.structs.replace(config, path=None, avoidance=wide, containment=narrow), found)
    assert [(f.light.value, f.text) for f in found.findings] == [
        ("green", "unproven traffic: 150 m to the side, 30 m below and 30 m above the leg; 600 s, then hold"),
        (
            "green",
            "crewed traffic: 500 m to the side, 96.25 m above the leg, down to the floor; 600 s, then hold",
        ),
        ("yellow", "limits.ceiling_height_m is not set: traffic can move the vehicle 96.25 m above its leg"),
        ("yellow", "crewed_side_m 500 m is less than the separation avoidance.crewed_horizontal_m"),
    ]
    found = Preflight()
    low = msgspec.structs.replace(config.limits, ceiling_height_m=100.0)
    judge_containment(msgspec.structs.replace(config, path=None, limits=low), found)
    assert not any("ceiling" in f.text for f in found.findings)
    found = Preflight()
    judge_containment(make_config(use="watch"), found)
    assert not found.findings


@pytest.mark.parametrize(
    ("firmware", "known", "why"),
    [
        (Firmware.ARDUPILOT, {}, "ADSB_TYPE is not known"),
        (Firmware.PX4, {}, "NAV_TRAFF_AVOID is not known"),
        (
            Firmware.ARDUPILOT,
            {"adsb_type": ("ADSB_TYPE", 1.0)},
            "ADSB_TYPE 1: the autopilot uses it",
        ),
        (Firmware.PX4, {"traffic_action": ("NAV_TRAFF_AVOID", 1.0)}, None),
    ],
)
def test_why_heard_traffic_is_not_published_is_told(
    make_config: Callable[..., Config],
    firmware: Firmware,
    known: dict[str, tuple[str, float]],
    why: str | None,
) -> None:
    found = Preflight()
    made = msgspec.structs.replace(make_config(use="watch"), traffic=TrafficConfig(publish="if-ignored"))
    values = {key: Parameter(name=name, value=value) for key, (name, value) in known.items()}
    _judge_parameters(made, VehicleParameters(firmware=firmware, **values), found)
    told = [f.text for f in found.findings if "not published" in f.text]
    assert told == ([] if why is None else [f"heard traffic is not published: {why}"])


def test_what_the_vehicle_hears_of_crewed_traffic_is_told(make_config: Callable[..., Config]) -> None:
    def judge(use: str, receiver: float) -> list[str]:
        found = Preflight()
        told = VehicleParameters(
            firmware=Firmware.ARDUPILOT,
            adsb_type=Parameter(name="ADSB_TYPE", value=receiver),
            adsb_radius_m=Parameter(name="ADSB_LIST_RADIUS", value=2000.0),
        )
        _judge_parameters(make_config(use=use), told, found)
        assert found.ready
        return [f"{f.light.name} {f.what}: {f.text}" for f in found.findings if "ADSB" in f.text]

    for use in ("fly", "watch"):
        (line,) = judge(use, 1.0)
        assert line.startswith(
            "YELLOW vehicle: ADSB_LIST_RADIUS 2000: the autopilot reports no aircraft beyond 2000 m"
        )
        assert judge(use, 0.0) == [
            "GREEN vehicle: ADSB_TYPE 0: no ADS-B receiver, so crewed traffic is not received"
        ]
