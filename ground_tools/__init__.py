"""Desk tools that run on the ground, behind the `ground-tools` command.

They show and export recorded runs (`inspect`), fly vehicles over MAVSDK (`fly`), fly encounters by the
thousand (`campaign`), compute the radio channel model (`channel`), train and evaluate policies that choose
transports and rates (`atmc`), and recompute the paper's figures (`paper`). `orca_check` compares the
avoidance kernels with an oracle, and `common` holds helpers that the tools share. None of this code flies; it
uses the flight software in `companion` and the simulators in `sitl_mocks`. Start reading with `cli`, which
lists all subcommands.
"""
