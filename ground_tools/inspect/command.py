"""`ground-tools inspect RUN...`: runs as Rerun recordings, or as figures in words or JSON.

A run is a run folder, an event record, or the telemetry log (.tlog) of any MAVLink vehicle.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from companion.errors import ConfigError
from ground_tools.inspect import recording, summary
from ground_tools.inspect.read_run import Run, read_run
from ground_tools.inspect.timeline import together

EXAMPLE = "example: ground-tools inspect runs/20260101T000000Z-demo, then: rerun runs/.../inspect.rrd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `ground-tools inspect`."""
    parser.description = "Show what was flown, heard, predicted and decided in a run."
    parser.epilog = EXAMPLE
    parser.add_argument("run_folder", nargs="+", type=Path, metavar="RUN", help="run folder, or .tlog")
    parser.add_argument(
        "--together", action="store_true", help="all RUNs as one, every aircraft on one UTC time line"
    )
    parser.add_argument(
        "--save", type=Path, metavar="FILE.rrd", help="recording of one run (default: RUN/inspect.rrd)"
    )
    parser.add_argument("--summary", action="store_true", help="print the figures and write no recording")
    parser.add_argument(
        "--json", action="store_true", help="like --summary, one JSON object per run and line"
    )


def run(args: argparse.Namespace) -> int:
    """`ground-tools inspect`. Returns 0; 2 when one of several inputs could not be read.

    Raises:
        ConfigError: nothing that can be read, a file that cannot be written, or rerun is not installed.
    """
    figures_only = args.summary or args.json
    if args.save is not None and ((len(args.run_folder) > 1 and not args.together) or figures_only):
        raise ConfigError("--save: goes with one run, and not with --summary or --json")
    runs = read_all(args.run_folder)
    for one in [together(runs)] if args.together else runs:
        if args.json:
            print(json.dumps(summary.describe(one)))
            continue
        print(summary.text(summary.describe(one)))
        if not figures_only:
            path = args.save or one.recording
            recording.write(one, path)
            print(f"wrote {path}; open it with: rerun {path}")
    return 0 if len(runs) == len(args.run_folder) else 2


def read_all(paths: Sequence[Path]) -> list[Run]:
    """Every input that can be read; of several, what is wrong with the others goes to standard error.

    Raises:
        ConfigError: none can be read.
    """
    runs = []
    for path in paths:
        try:
            runs.append(read_run(path))
        except ConfigError as error:
            if len(paths) == 1:
                raise
            print(f"left out: {error}", file=sys.stderr)
    if not runs:
        raise ConfigError("none of these can be read")
    return runs
