"""What `ground-tools` runs when it is installed."""

from __future__ import annotations

import sys

from companion.commands.entry_point import start


def main() -> int:
    """Run the command. Returns the exit code."""
    return start("ground_tools.cli")


if __name__ == "__main__":
    sys.exit(main())
