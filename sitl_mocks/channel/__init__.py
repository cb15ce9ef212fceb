"""Models of the Remote ID radio channel for the simulated air.

Two models share the parameters (`parameters.ChannelParameters`) and the link budget (`link_budget.Links`) and
nothing else. The equations of the paper are in `equations`; the packet-level simulation against which they
are checked is in `packets`. `air.Channel` is the interface that the simulated air uses: frames go in as
`Transmission`, and results come out as `Outcome`. It has three implementations: `simple.SimpleChannel`,
`equations.air_analytic.AnalyticChannel` and `packets.air_packets.PacketChannel`. Start reading with `air.py`
and `parameters.py`; docs/channel.md compares the two models.
"""
