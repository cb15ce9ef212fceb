"""The `sitl-mocks` command."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Final

from companion.commands.entry_point import add_commands, parser_of, run_command

_EXAMPLES = """examples:
  sitl-mocks demo
  sitl-mocks demo --seeds 1-20 --delay 2 3 --json
  sitl-mocks serve --help
  sitl-mocks swarm --duration 120
"""


COMMANDS: Final = (
    (
        "demo",
        "sitl_mocks.encounters.demo",
        "simulate an encounter in virtual time, with and without avoidance",
    ),
    ("serve", "sitl_mocks.vehicle.real_time.server", "simulate one MAVLink vehicle on UDP or TCP"),
    ("ether", "sitl_mocks.air.server", "simulate the radio channel between aircraft, on UDP"),
    (
        "module",
        "sitl_mocks.remote_id_module.server",
        "simulate a Remote ID module (ArduRemoteID firmware) on UDP or a serial port",
    ),
    (
        "swarm",
        "sitl_mocks.encounters.swarm",
        "run vehicles, companions and the radio channel as processes, in real time",
    ),
    ("soak", "sitl_mocks.examinations.soak", "fly for hours with random faults, in virtual time"),
    (
        "takeover",
        "sitl_mocks.examinations.takeover.command",
        "test thousands of short cases in which a pilot takes over during a fault",
    ),
)
"""Name, module and words of help of each subcommand."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0 success, 1 a negative result, 2 wrong input."""
    parser = parser_of(
        "sitl-mocks",
        "Simulates vehicles, the radio channel and encounters, so that no hardware is needed.",
        _EXAMPLES,
    )
    add_commands(parser, COMMANDS, argv)
    return run_command(parser, argv)


if __name__ == "__main__":
    sys.exit(main())
