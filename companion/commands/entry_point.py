"""Common code of the three commands: subcommands that return an exit code, and errors printed in one line."""

from __future__ import annotations

import argparse
import atexit
import errno
import importlib
import math
import os
import signal
import sys
import time
from collections.abc import Sequence
from types import FrameType
from typing import Final, NoReturn

from companion import __version__
from companion.errors import ConfigError, PeerDataError

_INTERRUPTS: Final = (signal.SIGINT, signal.SIGTERM)
_ONE_WISH_S: Final = 1.0
"""Signals within this time ask for the same end."""


def parser_of(name: str, description: str, examples: str) -> argparse.ArgumentParser:
    """Make the parser of a command with subcommands. Each of these must set `run`, the function to call."""
    parser = argparse.ArgumentParser(
        prog=name,
        description=description,
        epilog=examples,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dmuca {__version__}")
    return parser


def add_commands(
    parser: argparse.ArgumentParser, commands: Sequence[tuple[str, str, str]], argv: Sequence[str] | None
) -> None:
    """Add subcommands to a parser: name, module and words of help of each.

    Only the module that the command line names is imported, because all of them take a second or more. It has
    `add_arguments`, and `run` unless it adds subcommands of its own that set `run`.
    """
    given = sys.argv[1:] if argv is None else argv
    added = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in commands:
        command = added.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        if given and given[0] == name:
            chosen = importlib.import_module(module)
            command.set_defaults(run=getattr(chosen, "run", None))
            chosen.add_arguments(command)


def run_command(parser: argparse.ArgumentParser, argv: Sequence[str] | None) -> int:
    """Run the subcommand. Returns the exit code: 0 for success, 1 for a negative result, 2 for bad input."""
    _open_streams()
    arguments, unknown = parser.parse_known_args(argv)
    if unknown:
        _refuse(parser, sys.argv[1:] if argv is None else argv, unknown)
    try:
        code: int = arguments.run(arguments)
    except (ConfigError, PeerDataError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of our output has closed the pipe. Closing stderr keeps Python from complaining at exit.
        sys.stderr.close()
        return 1
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        print(f"{parser.prog}: output cannot be written: {error.strerror}", file=sys.stderr)
        # The rest of stdout cannot be written either, and Python would complain of that at exit.
        sys.stderr.close()
        return 1
    return code


def _refuse(parser: argparse.ArgumentParser, argv: Sequence[str], unknown: Sequence[str]) -> NoReturn:
    """End with an error about unknown arguments, and the usage of the subcommand that they were given to."""
    for word in argv:
        deeper = next((a for a in parser._actions if isinstance(a, argparse._SubParsersAction)), None)
        if deeper is None:
            break
        parser = deeper.choices.get(word, parser)
    parser.error(f"unrecognized arguments: {' '.join(unknown)}")


def start(module: str) -> int:
    """Import a command's module, which takes a second or more, and run its `main`.

    Ctrl-C and SIGTERM end both the import and `main` without a traceback. A parent that simply ended on
    SIGTERM would leave its workers behind. Returns the exit code.
    """
    _interrupt_on_signals()
    try:
        code: int = importlib.import_module(module).main()
    except KeyboardInterrupt:
        return 130
    return code


def _interrupt_on_signals() -> None:
    """Let Ctrl-C and SIGTERM raise KeyboardInterrupt, unless they are ignored.

    A supervisor may send both. The second one must not interrupt the clean-up after the first. A later one
    does, because the end may take too long.
    """
    interrupted_s = -math.inf

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted_s
        now_s = time.monotonic()
        if now_s - interrupted_s >= _ONE_WISH_S:
            interrupted_s = now_s
            raise KeyboardInterrupt

    for number in _INTERRUPTS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, interrupt)
    # What is registered first is called last. After it, Python itself would let a signal kill the process.
    atexit.register(_ignore_signals)


def _ignore_signals() -> None:
    for number in _INTERRUPTS:
        signal.signal(number, signal.SIG_IGN)


def _open_streams() -> None:
    """Open /dev/null in place of standard streams that were closed before the start, for example by `2>&-`.

    Otherwise the next file that is opened would take the free descriptor: a serial port would receive what is
    printed, and the watchdog would find no stderr.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # `open` takes the lowest free descriptor, which is this one.
            os.open(os.devnull, os.O_RDWR)
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)
