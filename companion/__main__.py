"""Entry point of the installed `companion` command."""

from __future__ import annotations

import sys

from companion.commands.entry_point import start


def main() -> int:
    """Run the command. Returns the exit code."""
    return start("companion.commands.cli")


if __name__ == "__main__":
    sys.exit(main())
