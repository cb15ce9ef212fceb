"""The air of a scenario: radio channel and its parameters, from a file's [air] and from command options."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from companion.errors import ConfigError
from companion.remote_id.region import TransportName
from companion.remote_id.transports import WIFI_BEACON, WIFI_NAN
from companion.shipped import given
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
    """The [air] of a scenario: what the aircraft send, and the radio channel between them."""

    model: Model = "interval"
    """Radio channel model. "interval": fixed bounds of delay, loss and range. "analytic": the channel
    equations for every frame. "packets": simulation of every packet on the air."""
    parameters: str | None = None
    """Path of a parameter file (relative to the scenario's file) for "analytic" and "packets". None: the
    paper's parameters."""
    delay_s: tuple[Delay, Delay] | None = None
    """Bounds of the delay, which is drawn uniformly for each message and receiver; 0 to 1 s if left out. Only
    for "interval"."""
    loss: Annotated[float, Meta(ge=0, le=1)] | None = None
    """Loss probability, only for "interval". None: nothing is lost."""
    range_m: Annotated[float, Meta(gt=0, le=1e6)] | None = None
    """Largest distance at which frames are heard, only for "interval". None: unlimited."""
    transports: Annotated[tuple[TransportName, ...], Meta(min_length=1, max_length=4)] = ("wifi",)
    """Transports on which every aircraft sends at the same time.

    If [atmc] has a `policy`, they are used until its first choice.
    """
    rate: Annotated[int, Meta(ge=1, le=10)] = 1
    """Locations per second on each transport."""
    region: str | None = None
    """Path of a region profile (relative to the scenario's file) whose legal minimum all aircraft keep. None:
    no legal rules."""

    def __post_init__(self) -> None:
        if self.model == "interval":
            if self.parameters is not None:
                raise ValueError('parameters: allowed only with model "analytic" or "packets"')
        else:
            for key in _INTERVAL_KEYS:
                if getattr(self, key) is not None:
                    raise ValueError(f'{key}: allowed only with model "interval"; here it is "{self.model}"')
        low, high = self.interval_s
        if low > high:
            raise ValueError(f"delay_s: {low:g}, {high:g}: the lower bound must come first")

    @property
    def interval_s(self) -> tuple[float, float]:
        """Bounds of the delay of the model "interval" (s)."""
        return DEFAULT_DELAY_S if self.delay_s is None else self.delay_s


def load_parameters(path: Path, air: AirSettings) -> ChannelParameters:
    """Read a parameter file and check that it allows the scenario's rate.

    Raises:
        ConfigError: with the file, the key and what is allowed.
    """
    parameters = channel_parameters.load(path)
    check_allowed(air, parameters)
    return parameters


def check_allowed(air: AirSettings, parameters: ChannelParameters) -> None:
    """Check that the parameters allow the rate on all transports.

    Raises:
        ConfigError: with the transport and what is allowed.
    """
    for transport in air.transports:
        check_rate(WIFI_BEACON if transport == WIFI_NAN else transport, air.rate, parameters)


RADIO_SPREAD_S = 0.1
"""Time after its companion's tick within which a radio sends, each radio at its own offset (`PacketChannel`).
It is the interval of the highest rate, 10 per second. Without it, companions that share a clock would send in
the same part of the interval."""


def channel_of(air: AirSettings, parameters: ChannelParameters | None) -> Channel:
    """Make the radio channel.

    Args:
        air: the settings. Its `parameters` path is not read here.
        parameters: for "analytic" and "packets". None: the paper's parameters.
    """
    given = ChannelParameters() if parameters is None else parameters
    if air.model == "analytic":
        return AnalyticChannel(given)
    if air.model == "packets":
        return PacketChannel(given, RADIO_SPREAD_S)
    return SimpleChannel(delay_s=air.interval_s, loss=air.loss or 0.0, range_m=air.range_m)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that select the radio channel."""
    parser.add_argument("--channel", choices=get_args(Model), help="radio channel model (default: interval)")
    parser.add_argument(
        "--parameters",
        type=given,
        metavar="FILE",
        help="channel parameters (TOML); default: those of the paper",
    )


def with_options(
    air: AirSettings, parameters: ChannelParameters | None, arguments: argparse.Namespace
) -> tuple[AirSettings, ChannelParameters | None]:
    """Apply the command options to a scenario's air. A change of the model drops the keys of the old model.

    Raises:
        ConfigError: an option is not allowed with the model, or the parameter file is wrong.
    """
    if arguments.channel is not None and arguments.channel != air.model:
        air = AirSettings(model=arguments.channel, transports=air.transports, rate=air.rate)
        if air.model == "interval":
            parameters = None
    if arguments.parameters is not None:
        if air.model == "interval":
            raise ConfigError("--parameters: allowed only with --channel analytic or --channel packets")
        parameters = load_parameters(arguments.parameters, air)
    if arguments.delay is not None:
        if air.model != "interval":
            raise ConfigError(
                f'--delay: allowed only with --channel interval; the channel model is "{air.model}"'
            )
        low, high = arguments.delay
        if not 0.0 <= low <= high <= MAX_DELAY_S:
            raise ConfigError(
                f"--delay: {low:g} {high:g} is out of range; allowed: 0 <= LOW <= HIGH <= {MAX_DELAY_S:g}"
            )
        air = msgspec.structs.replace(air, delay_s=(low, high))
    return air, parameters
