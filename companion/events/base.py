"""The two kinds of values that the core exchanges with everything around it: events and commands.

No class of an event or command has subclasses. Code that runs for each of them therefore compares types:
`isinstance` is five times as slow for a msgspec Struct that is of another type.
"""

from __future__ import annotations

import msgspec


class Event(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """An input of the core."""


class Command(msgspec.Struct, frozen=True, tag=True, kw_only=True, omit_defaults=True):
    """An output of the core."""
