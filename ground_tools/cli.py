"""The `ground-tools` command: its subcommands and their dispatch."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from companion.commands.entry_point import parser_of, run_command
from ground_tools import orca_check
from ground_tools.atmc.commands import command as atmc_command
from ground_tools.campaign import command as campaign_command
from ground_tools.channel import command as channel_command
from ground_tools.fly import command as fly_command
from ground_tools.inspect import command as inspect_command
from ground_tools.inspect.export import export
from ground_tools.inspect.report import picture
from ground_tools.paper import command as paper_command

_EXAMPLES = """examples:
  ground-tools inspect runs/20260101T000000Z-demo
  ground-tools export runs/20260101T000000Z-demo --csv tables --kml run.kml
  ground-tools picture runs/20260101T000000Z-demo --out demo.png
  ground-tools fly udpin://0.0.0.0:14550 --takeoff 30 --mission survey.plan --start --land
  ground-tools orca check cases.json
  ground-tools campaign run --generator S2 --aircraft 5 --seeds 1-1000
  ground-tools channel table --sides 500 --rates 9
  ground-tools paper all
  ground-tools atmc train --algorithm madqn --seeds 1-5
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0 for success, 1 for a negative result, 2 for wrong input."""
    parser = parser_of("ground-tools", "Desk tools: look at runs, check laws and radio models.", _EXAMPLES)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in (
        ("inspect", inspect_command, "a run or a telemetry log as a Rerun recording, or its summary"),
        ("export", export, "a run or a telemetry log as CSV, Parquet, KML, or a scenario to fly again"),
        ("picture", picture, "a run folder as one PNG"),
        ("fly", fly_command, "arm, take off, upload, start and land vehicles"),
        ("paper", paper_command, "the paper's figures, beside what it says of them"),
    ):
        command = commands.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    orca = commands.add_parser("orca", help="the avoidance kernels")
    check = orca.add_subparsers(title="commands", required=True, metavar="COMMAND").add_parser(
        "check", help="compare with an oracle's answers"
    )
    orca_check.add_arguments(check)
    check.set_defaults(run=orca_check.run)
    channel = commands.add_parser("channel", help="the radio channel model: tables and pictures")
    channel_command.add_arguments(channel)
    campaign = commands.add_parser("campaign", help="encounters flown by the thousand")
    campaign_command.add_arguments(campaign)
    atmc = commands.add_parser("atmc", help="policies that choose transports and rates: training")
    atmc_command.add_arguments(atmc)
    return run_command(parser, argv)


if __name__ == "__main__":
    sys.exit(main())
