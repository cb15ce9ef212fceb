"""Parameter files: the default is the paper's; errors in a file name the key and its limit."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import pytest

from companion.errors import ConfigError
from companion.radio.frames_io import FrameSender, radio_address
from companion.remote_id.messages import BasicId, IdType, Location, OperatorId, System, UaType
from companion.remote_id.transports import BLE5, WIFI_BEACON
from sitl_mocks.channel.parameters import (
    BackgroundLoad,
    BleParameters,
    ChannelParameters,
    Slots,
    WifiParameters,
    check_rate,
    load,
)

CONFIG = Path(__file__).parents[3] / "config" / "channel"


def test_the_paper_s_file_is_the_default():
    assert load(CONFIG / "paper.toml") == ChannelParameters()


def test_the_paper_s_durations_in_slots():
    p = ChannelParameters()
    slots = Slots(p)
    assert [slots.of(x) for x in (p.ble4.packet_ms, p.ble5.packet_ms, p.ble4.gap_ms)] == [3, 9, 1]
    assert [slots.of(x) for x in (p.ble4.scan_interval_ms, p.ble4.scan_window_ms)] == [64, 16]
    assert [slots.of(x) for x in (p.ble5.auxiliary_offset_ms, p.ble5.auxiliary_ms)] == [40, 26]
    assert [slots.of(x) for x in (p.wifi.beacon_ms, p.wifi.scan_ms, p.wifi.switch_ms)] == [5, 48, 8]
    assert slots.gnss_period == 8000
    assert slots.seconds(8000) == 1.0


def test_decimal_fractions_that_fill_slots_do_so():
    slots = Slots(msgspec.structs.replace(ChannelParameters(), slot_ms=0.1))
    assert 0.3 / 0.1 < 3.0
    assert [slots.of(x) for x in (0.3, 0.376, 8.0)] == [3, 3, 80]


@pytest.mark.parametrize(
    ("changes", "mode", "filled_ms"),
    [
        ({"ble4": {"packet_ms": 1.0}}, "ble4", 3.25),
        ({"ble5": {"packet_ms": 1.3}}, "ble4", 1.676),
        ({"ble5": {"auxiliary_uncertainty_ms": 1.0}}, "ble5", 9.328),
        ({"ble4": {"packet_ms": 8.0, "scan_window_ms": 8.0}}, "ble5", 9.152),
        ({"wifi": {"beacon_ms": 60.0, "scan_ms": 60.0}}, "ble5", 9 / 37 * 63.328),
        ({"wifi": {"beacon_ms": 1.5}}, "wifi", 3.0),
        ({"ble5": {"auxiliary_ms": 20.0}}, "wifi", 9 / 37 * 20.632),
    ],
)
def test_a_period_must_hold_its_events_and_their_collisions(changes, mode, filled_ms):
    """By hand: the event, or what one interferer's message spoils for the others, whichever is longer."""
    p = ChannelParameters()
    sections = {key: msgspec.structs.replace(getattr(p, key), **values) for key, values in changes.items()}
    others = {key: sections.get(key, getattr(p, key)) for key in ("ble4", "ble5", "wifi")}
    single = {key: msgspec.structs.replace(value, max_rate=1) for key, value in others.items()}
    fits = math.floor(1000.0 / filled_ms)
    for rate in (fits, fits + 1):
        asked = single | {mode: msgspec.structs.replace(single[mode], max_rate=rate)}
        if rate == fits:
            ChannelParameters(**asked)
        else:
            with pytest.raises(ValueError, match=f"^{mode}.max_rate: {rate} is too high; allowed: less than"):
                ChannelParameters(**asked)


def test_the_standard_s_file_holds_the_airtimes_of_real_frames():
    p = load(CONFIG / "standard.toml")
    messages = [
        BasicId(id_type=IdType.SERIAL_NUMBER, ua_type=UaType.HELICOPTER_OR_MULTIROTOR, uas_id="X"),
        Location(),
        System(),
        OperatorId(operator_id_type=0, operator_id="Y"),
    ]
    sender = FrameSender(radio_address("X"))
    (advertising_data,) = sender.frames(BLE5, messages)
    (beacon,) = sender.frames(WIFI_BEACON, messages)

    def coded_us(octets):
        """LE Coded S=8: preamble 80, access address 256, CI 16, TERM1 24, octets, CRC 192, TERM2 24."""
        return 80 + 256 + 16 + 24 + 64 * octets + 192 + 24

    # AUX_ADV_IND: header 2, extended header length 1, flags 1, AdvA 6, ADI 2. ADV_EXT_IND ends with AuxPtr 3.
    assert p.ble5.auxiliary_ms == pytest.approx(coded_us(12 + len(advertising_data)) / 1000, abs=1e-9)
    assert p.ble5.packet_ms == pytest.approx(coded_us(9) / 1000, abs=1e-9)
    assert p.ble4.packet_ms == ChannelParameters().ble4.packet_ms
    assert (p.ble4.schedule, p.ble5.schedule) == ("random", "random")
    # 802.11b at 1 Mbit/s: 192 us of preamble, header; the frame check sequence follows the frame. These 166
    # octets are an access point's beacon: 11 more of SSID and rates than the shortest, which is ours.
    assert p.wifi.beacon_ms == pytest.approx((192 + 8 * (len(beacon) + 4 + 11)) / 1000, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[ble4]\npacket_ms = -0.376", r"ble4.packet_ms: -0.376 is out of range; allowed: more than 0"),
        ("[ble5]\nauxiliary_ms = -1.0", r"ble5.auxiliary_ms: -1 is out of range; allowed: more than 0"),
        ("[wifi]\nswitch_ms = -1.0", r"wifi.switch_ms: -1 is out of range; allowed: 0 to"),
        (
            "[ble4]\nscan_window_ms = 9.0",
            r"ble4.scan_window_ms: 9 is out of range; allowed: more than 0, up to 8",
        ),
        ("[ble5]\npacket_ms = 2.5", r"ble5.packet_ms: 2.5 is out of range; allowed: more than 0, up to 2"),
        ("[wifi]\nbeacon_ms = 6.5", r"wifi.beacon_ms: 6.5 is out of range; allowed: more than 0, up to 6"),
        (
            "[ble5]\nauxiliary_offset_ms = 3.0",
            r"ble5.auxiliary_offset_ms: 3 is out of range; allowed: 3.706 to",
        ),
        ("[wifi]\nmax_rate = 0", r"wifi.max_rate: 0 is out of range; allowed: 1 to 1000"),
        ("[ble5]\nmax_rate = 200", r"ble5.max_rate: 200 is too high; allowed: less than 120.1"),
        ("slot_ms = 0.5", r"ble4.packet_ms: 0.376 is less than one slot"),
        (
            "slot_ms = 0.000001",
            r"ble4.scan_interval_ms: 8 is too long; allowed: up to 0.333333, so that three times",
        ),
        (
            "[ble5]\nscan_interval_ms = 5e4",
            r"ble5.scan_interval_ms: 50000 is too long; allowed: up to 41666.7",
        ),
        ("[wifi]\nswitch_ms = 5e4", r"wifi.scan_ms and switch_ms: 50006 is too long; allowed: up to 41666.7"),
        ("gnss_period_ms = 0.0", r"gnss_period_ms: 0 is out of range; allowed: more than 0"),
        ('wifi_channels = "all"', r"wifi_channels: 'all': allowed: 'shared', 'random'"),
        ("[propagation]\nexponent = 0.0", r"propagation.exponent: 0 is out of range; allowed: 1 to 10"),
        (
            "[propagation]\nshadowing_sigma_db = -1.0",
            r"propagation.shadowing_sigma_db: -1 is out of range; allowed: 0 to 30",
        ),
        ("[background]\nwifi = 1.0", r"background.wifi: 1 is out of range; allowed: 0 to 0.999"),
        ("[ble4]\nburst_ms = 1.0", r"ble4.burst_ms: unknown key"),
        ("[ble4]\nsensitivity_dbm = nan", r"ble4.sensitivity_dbm: nan is not a finite number"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, expected):
    path = tmp_path / "bad.toml"
    path.write_text(text + "\n")
    with pytest.raises(ConfigError, match=expected) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_bad_values_from_code_are_refused_too():
    with pytest.raises(ValueError, match="scan_window_ms: 9 is out of range; allowed: more than 0, up to 8"):
        BleParameters(scan_window_ms=9.0)
    with pytest.raises(ValueError, match="beacon_ms: nan is out of range; allowed: more than 0"):
        WifiParameters(beacon_ms=math.nan)
    with pytest.raises(ValueError, match="burst_ms: 0 is out of range; allowed: more than 0"):
        BackgroundLoad(burst_ms=0.0)
    with pytest.raises(ValueError, match="slot_ms"):
        msgspec.structs.replace(ChannelParameters(), slot_ms=-1.0)


def test_rates():
    p = ChannelParameters()
    check_rate("ble4", 10, p)
    for rate in (0, 11):
        with pytest.raises(ConfigError, match=f"ble4: rate {rate} is out of range; allowed: 1 to 10"):
            check_rate("ble4", rate, p)
