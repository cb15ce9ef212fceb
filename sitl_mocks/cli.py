"""The `sitl-mocks` command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from companion.commands.entry_point import parser_of, run_command
from sitl_mocks.air import server as ether_server
from sitl_mocks.encounters import demo, swarm
from sitl_mocks.examinations import soak, takeover
from sitl_mocks.remote_id_module import server as remote_id_module_server
from sitl_mocks.vehicle import server as vehicle_server

_EXAMPLES = """examples:
  sitl-mocks demo
  sitl-mocks demo --seeds 1-20 --delay 2 3 --json
  sitl-mocks serve --help
  sitl-mocks swarm --duration 120
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns the exit code: 0 success, 1 a negative result, 2 wrong input."""
    parser = parser_of(
        "sitl-mocks", "What stands in for hardware: vehicles, the air, whole encounters.", _EXAMPLES
    )
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in (
        ("demo", demo, "an encounter in virtual time, with and without avoidance"),
        ("serve", vehicle_server, "one MAVLink vehicle on UDP or TCP"),
        ("ether", ether_server, "the simulated air between aircraft, on UDP"),
        (
            "module",
            remote_id_module_server,
            "a Remote ID module (ArduRemoteID firmware) on UDP or a serial port",
        ),
        ("swarm", swarm, "vehicles, companions and air as processes, in real time"),
        ("soak", soak, "hours of flights with random troubles, in virtual time"),
        ("takeover", takeover, "pilots who take over while something goes wrong: thousands of short cases"),
    ):
        command = commands.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return run_command(parser, argv)


if __name__ == "__main__":
    sys.exit(main())
