"""The [air] section and its options: valid and refused combinations, and the resulting channel."""

from __future__ import annotations

import argparse
from pathlib import Path

import msgspec
import pytest
import tomli_w

from companion.errors import ConfigError
from companion.toml_reader import without_none
from sitl_mocks.air import air_settings
from sitl_mocks.air.air_settings import AirSettings, channel_of, with_options
from sitl_mocks.channel.equations.air_analytic import AnalyticChannel
from sitl_mocks.channel.packets.air_packets import PacketChannel
from sitl_mocks.channel.parameters import ChannelParameters
from sitl_mocks.channel.simple import SimpleChannel
from sitl_mocks.encounters import scenario_file

CHANNELS = Path(__file__).parents[3] / "config" / "channel"


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    air_settings.add_arguments(parser)
    parser.add_argument("--delay", type=float, nargs=2)
    return parser.parse_args(words)


def scenario(folder: Path, air: str) -> scenario_file.Scenario:
    path = folder / "s.toml"
    path.write_text(f'geometry = "S2"\n[air]\n{air}')
    return scenario_file.load(path)


def test_each_model_gives_its_channel() -> None:
    assert channel_of(AirSettings(), None) == SimpleChannel(delay_s=(0.0, 1.0))
    given = AirSettings(delay_s=(1.0, 2.0), loss=0.25, range_m=300.0)
    assert channel_of(given, None) == SimpleChannel((1.0, 2.0), 0.25, 300.0)
    assert isinstance(channel_of(AirSettings(model="analytic"), None), AnalyticChannel)
    assert isinstance(channel_of(AirSettings(model="packets"), None), PacketChannel)


@pytest.mark.parametrize(
    ("air", "words"),
    [
        ('model = "radio"\n', "air.model: 'radio': allowed: 'interval', 'analytic', 'packets'"),
        ('model = "packets"\ndelay_s = [0.0, 1.0]\n', 'air.delay_s: allowed only with model "interval"'),
        ('model = "analytic"\nloss = 0.1\n', 'air.loss: allowed only with model "interval"; here'),
        ('model = "packets"\nrange_m = 100.0\n', 'air.range_m: allowed only with model "interval"'),
        ('parameters = "p.toml"\n', 'air.parameters: allowed only with model "analytic" or "packets"'),
        ("delay_s = [2.0, 1.0]\n", "air.delay_s: 2, 1: the lower bound must come first"),
        ("delay_s = [0.0, 61.0]\n", "air.delay_s"),
        ('model = "packets"\nparameters = "no.toml"\n', "air.parameters: "),
        ("[channel]\nslot_ms = 0.125\n", 'channel: allowed only with air.model "analytic" or "packets"'),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused_by_key(tmp_path: Path, air: str, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        scenario(tmp_path, air)
    assert words in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_parameters_are_read_beside_the_scenario_and_checked(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text("wifi_channels = 'random'\n[wifi]\nmax_rate = 4\n")
    loaded = scenario(tmp_path, 'model = "packets"\nparameters = "p.toml"\nrate = 4\n')
    assert loaded.channel is not None
    assert loaded.channel.wifi_channels == "random"
    with pytest.raises(ConfigError, match=r"air.parameters: wifi: rate 5 is out of range; allowed: 1 to 4"):
        scenario(
            tmp_path, 'model = "packets"\nparameters = "p.toml"\nrate = 5\ntransports = ["ble4", "nan"]\n'
        )
    with pytest.raises(ConfigError, match=r"s.toml: channel: wifi: rate 5 is out of range; allowed: 1 to 4"):
        scenario(tmp_path, 'model = "packets"\nrate = 5\n[channel.wifi]\nmax_rate = 4\n')
    (tmp_path / "p.toml").write_text("[wifi]\nscan = 4\n")
    with pytest.raises(ConfigError, match=r"s.toml: air.parameters: .*p.toml: wifi.scan: unknown key"):
        scenario(tmp_path, 'model = "packets"\nparameters = "p.toml"\n')


def test_a_resolved_scenario_stands_alone(tmp_path: Path) -> None:
    """The scenario in a run folder contains the values of its parameter file."""
    packets = scenario_file.load(CHANNELS.parent / "scenarios" / "packets.toml")
    assert (packets.air.model, packets.air.transports, packets.air.rate) == ("packets", ("wifi",), 5)
    assert packets.channel is not None
    assert packets.channel != ChannelParameters()
    copy = tmp_path / "config.toml"
    copy.write_text(tomli_w.dumps(without_none(msgspec.to_builtins(packets))))
    assert scenario_file.load(copy) == packets


def test_options_replace_the_file() -> None:
    fixed = AirSettings(delay_s=(1.0, 2.0), loss=0.5, transports=("ble4", "wifi"), rate=9)
    assert with_options(fixed, None, options()) == (fixed, None)
    air, parameters = with_options(fixed, None, options("--channel", "packets"))
    assert (air, parameters) == (AirSettings(model="packets", transports=("ble4", "wifi"), rate=9), None)
    file = str(CHANNELS / "standard.toml")
    _, parameters = with_options(air, None, options("--parameters", file))
    assert parameters is not None
    assert with_options(air, parameters, options("--channel", "analytic"))[1] is parameters
    back = with_options(air, parameters, options("--channel", "interval", "--delay", "0", "2"))
    assert back == (AirSettings(delay_s=(0.0, 2.0), transports=("ble4", "wifi"), rate=9), None)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["--channel", "packets", "--delay", "0", "1"], '--delay: allowed only with --channel interval; the'),
        (["--parameters", "x.toml"], "--parameters: allowed only with --channel analytic or"),
        (["--channel", "packets", "--parameters", "/nowhere.toml"], "/nowhere.toml: cannot be read"),
        (["--delay", "2", "1"], "--delay: 2 1 is out of range; allowed: 0 <= LOW <= HIGH <= 60"),
    ],
)  # fmt: skip
def test_options_that_do_not_go_together_are_refused(words: list[str], error: str) -> None:
    with pytest.raises(ConfigError) as refused:
        with_options(AirSettings(), None, options(*words))
    assert error in str(refused.value)
