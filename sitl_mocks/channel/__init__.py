"""Models of the Remote ID radio channel for the simulated air.

Two models share the parameters (`parameters.ChannelParameters`) and the link budget (`link_budget.Links`) and
nothing else. The equations of the paper are in `equations`; the packet-level simulation against which they
are checked is in `packets`. `air.Channel` is the interface that the simulated air uses: frames go in as
`Transmission`, and results come out as `Outcome`. It has three implementations: `simple.SimpleChannel`,
`equations.air_analytic.AnalyticChannel` and `packets.air_packets.PacketChannel`. Start reading with `air.py`
and `parameters.py`; docs/channel.md compares the two models.
"""

from sitl_mocks.channel.air import Channel, Outcome, Transmission
from sitl_mocks.channel.equations.air_analytic import AnalyticChannel
from sitl_mocks.channel.equations.analytic import Analytic, Evaluation, Fleet, fixed_mode, system_delay_s
from sitl_mocks.channel.link_budget import Links, all_links, draw_positions, near_links, ranges_m
from sitl_mocks.channel.packets.air_packets import PacketChannel
from sitl_mocks.channel.packets.simulation import simulate
from sitl_mocks.channel.parameters import ChannelParameters
from sitl_mocks.channel.parameters import load as load_parameters
from sitl_mocks.channel.simple import SimpleChannel

__all__ = [
    "Analytic",
    "AnalyticChannel",
    "Channel",
    "ChannelParameters",
    "Evaluation",
    "Fleet",
    "Links",
    "Outcome",
    "PacketChannel",
    "SimpleChannel",
    "Transmission",
    "all_links",
    "draw_positions",
    "fixed_mode",
    "load_parameters",
    "near_links",
    "ranges_m",
    "simulate",
    "system_delay_s",
]
