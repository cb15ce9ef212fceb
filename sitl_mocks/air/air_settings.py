"""The air of a scenario: which radio channel, with what parameters; a file's [air], and its options."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from companion.errors import ConfigError
from companion.remote_id.region import TransportName
from companion.remote_id.transports import WIFI_BEACON, WIFI_NAN
from sitl_mocks.channel import parameters as channel_parameters
from sitl_mocks.channel.air import Channel
from sitl_mocks.channel.equations.air_analytic import AnalyticChannel
from sitl_mocks.channel.packets.air_packets import PacketChannel
from sitl_mocks.channel.parameters import ChannelParameters, check_rate
from sitl_mocks.channel.simple import MAX_DELAY_S, SimpleChannel

Model = Literal["interval", "analytic", "packets"]
DEFAULT_DELAY_S = (0.0, 1.0)
_INTERVAL_KEYS = ("delay_s", "loss", "range_m")

Delay = Annotated[float, Meta(ge=0, le=MAX_DELAY_S)]


class AirSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the aircraft send, and the radio channel between them."""

    model: Model = "interval"
    """"interval": delay, loss and range by fixed numbers. "analytic": the channel equations for every frame.
    "packets": every packet on the air."""
    parameters: str | None = None
    """Path of a parameter file (relative to this file) for "analytic" and "packets"; None: the paper's."""
    delay_s: tuple[Delay, Delay] | None = None
    """Uniform, drawn for each message and receiver; 0 to 1 when left out. This and the next two are for
    "interval"."""
    loss: Annotated[float, Meta(ge=0, le=1)] | None = None
    """None: nothing is lost."""
    range_m: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    """None: everywhere."""
    transports: Annotated[tuple[TransportName, ...], Meta(min_length=1, max_length=4)] = ("wifi",)
    """What all aircraft send on, together; where [atmc] chooses, until its first choice."""
    rate: Annotated[int, Meta(ge=1, le=10)] = 1
    """Locations a second on each."""
    region: str | None = None
    """Path of a region profile (relative to this file), whose floor all keep; None: no law."""

    def __post_init__(self) -> None:
        if self.model == "interval":
            if self.parameters is not None:
                raise ValueError('parameters: goes with model "analytic" or "packets"')
        else:
            for key in _INTERVAL_KEYS:
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: goes with model "interval"; here it is "{self.model}"')
        low, high = self.interval_s
        if low > high:
            raise ValueError(f"delay_s: {low:g}, {high:g}: expected the lower bound first")

    @property
    def interval_s(self) -> tuple[float, float]:
        """Bounds of the delay of model "interval"."""
        return DEFAULT_DELAY_S if self.delay_s is None else self.delay_s


def load_parameters(path: Path, air: AirSettings) -> ChannelParameters:
    """Read a parameter file; the scenario's rate must be allowed in it.

    Raises:
        ConfigError: names the file, the key and what is allowed.
    """
    parameters = channel_parameters.load(path)
    check_allowed(air, parameters)
    return parameters


def check_allowed(air: AirSettings, parameters: ChannelParameters) -> None:
    """Refuse a rate that the parameters do not allow on one of the transports.

    Raises:
        ConfigError: names the transport and what is allowed.
    """
    for transport in air.transports:
        check_rate(WIFI_BEACON if transport == WIFI_NAN else transport, air.rate, parameters)


RADIO_SPREAD_S = 0.1
"""A radio sends at its own time within this after its companion's tick (`PacketChannel`): the interval of the
highest rate, 10 a second. Companions that share a clock would else send in the same part of it."""


def channel_of(air: AirSettings, parameters: ChannelParameters | None) -> Channel:
    """The radio channel.

    Args:
        air: its `parameters` are taken as read.
        parameters: for "analytic" and "packets"; None: the paper's.
    """
    given = ChannelParameters() if parameters is None else parameters
    if air.model == "analytic":
        return AnalyticChannel(given)
    if air.model == "packets":
        return PacketChannel(given, RADIO_SPREAD_S)
    return SimpleChannel(delay_s=air.interval_s, loss=air.loss or 0.0, range_m=air.range_m)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options that choose the radio channel."""
    parser.add_argument("--channel", choices=get_args(Model), help="radio channel model (default: interval)")
    parser.add_argument(
        "--parameters", type=Path, metavar="FILE", help="channel parameters (TOML); default: the paper's"
    )


def with_options(
    air: AirSettings, parameters: ChannelParameters | None, arguments: argparse.Namespace
) -> tuple[AirSettings, ChannelParameters | None]:
    """What the options make of a scenario's air. Another model leaves nothing of the old one's keys.

    Raises:
        ConfigError: an option that does not go with the model, or a wrong parameter file.
    """
    if arguments.channel is not None and arguments.channel != air.model:
        air = AirSettings(model=arguments.channel, transports=air.transports, rate=air.rate)
        if air.model == "interval":
            parameters = None
    if arguments.parameters is not None:
        if air.model == "interval":
            raise ConfigError("--parameters: goes with --channel analytic or --channel packets")
        parameters = load_parameters(arguments.parameters, air)
    if arguments.delay is not None:
        if air.model != "interval":
            raise ConfigError(f'--delay: goes with --channel interval; this air is "{air.model}"')
        low, high = arguments.delay
        if not 0.0 <= low <= high <= MAX_DELAY_S:
            raise ConfigError(f"--delay: {low:g} {high:g}: allowed 0 <= LOW <= HIGH <= {MAX_DELAY_S:g}")
        air = msgspec.structs.replace(air, delay_s=(low, high))
    return air, parameters
