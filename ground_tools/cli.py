"""The `ground-tools` command: its subcommands and their dispatch."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

from companion.commands.entry_point import add_commands, parser_of, run_command

_EXAMPLES = """examples:
  ground-tools inspect runs/20260101T000000Z-demo
  ground-tools export runs/20260101T000000Z-demo --csv tables --kml run.kml
  ground-tools picture runs/20260101T000000Z-demo --out demo.png
  ground-tools fly udpin://0.0.0.0:14550 --takeoff 30 --mission survey.plan --start --land
  ground-tools orca check cases.json
  ground-tools campaign run --generator S2 --aircraft 5 --seeds 1-1000
  ground-tools city --density 10 --size 5 5 --transports policy
  ground-tools channel table --sides 500 --rates 9
  ground-tools paper all
  ground-tools atmc train --algorithm madqn --seeds 1-5
  ground-tools results verify
"""


COMMANDS: Final = (
    (
        "inspect",
        "ground_tools.inspect.command",
        "turn a run or a telemetry log into a Rerun recording, a report or a summary",
    ),
    (
        "export",
        "ground_tools.inspect.export.export",
        "write a run or a telemetry log as CSV, Parquet, KML, or as a scenario",
    ),
    ("picture", "ground_tools.inspect.report.picture", "draw a run as one PNG"),
    ("fly", "ground_tools.fly.command", "upload missions to vehicles; take off, start and land"),
    (
        "paper",
        "ground_tools.paper.command",
        "compute the paper's figures and compare them with its statements",
    ),
    ("orca", "ground_tools.orca_check", "check the avoidance kernels"),
    ("channel", "ground_tools.channel.command", "show delay and loss of the radio channel model"),
    ("campaign", "ground_tools.campaign.command", "fly thousands of simulated encounters"),
    ("city", "ground_tools.city.command", "fly thousands of aircraft over a city, each with law and radio"),
    (
        "atmc",
        "ground_tools.atmc.commands.command",
        "train and measure policies that choose transports and rates",
    ),
    ("results", "ground_tools.results.command", "tell which kept results today's software still makes"),
)
"""Name, module and help text of each subcommand."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0 for success, 1 for a negative result, 2 for wrong input."""
    parser = parser_of(
        "ground-tools",
        "Tools for the desk: analyse runs, fly campaigns, check the radio model, train policies.",
        _EXAMPLES,
    )
    add_commands(parser, COMMANDS, argv)
    return run_command(parser, argv)


if __name__ == "__main__":
    sys.exit(main())
