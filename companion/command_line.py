"""What the three commands share: subcommands that return an exit code, and errors in one line."""

from __future__ import annotations

import argparse
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
    return code
