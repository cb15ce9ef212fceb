"""What the three commands share: subcommands that return an exit code, and errors in one line."""

from __future__ import annotations

import argparse
import errno
import importlib
import os
import sys
from collections.abc import Sequence

from companion import __version__
from companion.errors import ConfigError, PeerDataError


def parser_of(name: str, description: str, examples: str) -> argparse.ArgumentParser:
    """A parser for a command with subcommands; each of those sets `run`."""
    parser = argparse.ArgumentParser(
        prog=name,
        description=description,
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dmuca {__version__}")
    return parser


def run_command(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> int:
    """Run the subcommand. Returns the exit code: 0 good, 1 the answer is no, 2 wrong input."""
    _open_streams()
    arguments = parser.parse_args(argv)
    try:
        code: int = arguments.run(arguments)
    except (ConfigError, PeerDataError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # Whoever read our output has had enough; nothing more can be said to them.
        sys.stderr.close()
        return 1
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        print(f"{parser.prog}: output cannot be written: {error.strerror}", file=sys.stderr)
        # What is left in stdout cannot be written either, which Python would complain of.
        sys.stderr.close()
        return 1
    return code


def start(module: str) -> int:
    """Import a command's module, which takes a second or more, and run its `main`. Returns the exit code;
    Ctrl-C ends the one as quietly as the other."""
    try:
        code: int = importlib.import_module(module).main()
    except KeyboardInterrupt:
        return 130
    return code


def _open_streams() -> None:
    """Stand in for standard streams that were closed before the start, as by `2>&-`: the next file that is
    opened would take their number, a serial port get what is printed, and the watchdog find no stderr."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number, which is this one.
            os.open(os.devnull, os.O_RDWR)
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)
