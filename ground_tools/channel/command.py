"""The command `ground-tools channel` and its subcommands."""

from __future__ import annotations

import argparse

from ground_tools.channel import compare, plot, table


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `ground-tools channel`; each sets `run`."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in (
        ("table", table, "print delay and loss of the fixed modes by size and rate"),
        ("plot", plot, "draw the same delays"),
        ("compare", compare, "compare the equations with a packet-by-packet simulation"),
    ):
        command = commands.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
