"""Tables and pictures of the radio channel model: the command `ground-tools channel`.

The models themselves are in `sitl_mocks.channel`: the paper's equations and a packet-by-packet simulator.
`fixed_modes` averages the equations over random environments in which every aircraft uses one mode at one
rate; its main types are `Settings` and `Row`. `table` and `plot` show these rows. `comparison` defines the
cases in which the equations are compared with the simulator, `compare` runs them, and `compare_plot` draws
them. `options` reads the command-line options that the subcommands share, and `command` registers the
subcommands. Start reading with `fixed_modes.evaluate`. docs/channel.md describes the models and the results.
"""
