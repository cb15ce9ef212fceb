"""What `companion` runs when it is installed."""

from __future__ import annotations

import sys

from companion.command_line import start


def main() -> int:
    """Run the command. Returns the exit code."""
    return start("companion.cli")


if __name__ == "__main__":
    sys.exit(main())
