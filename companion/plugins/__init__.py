"""Plug-ins of other distributions: `load` finds one by its group and name. Start with `entry_points`."""

from companion.plugins.entry_points import (
    FIRMWARES,
    GROUPS,
    LAWS,
    POLICIES,
    RADIOS,
    Plugin,
    cause,
    is_of_module,
    load,
    names,
)

__all__ = [
    "FIRMWARES",
    "GROUPS",
    "LAWS",
    "POLICIES",
    "RADIOS",
    "Plugin",
    "cause",
    "is_of_module",
    "load",
    "names",
]
