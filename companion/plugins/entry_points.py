"""Plug-ins: laws, policies, radios and firmwares of other distributions, found by their entry points.

A plug-in is looked up only by its name, so that a configuration that names none scans nothing. It is loaded
when the configuration is checked. What is loaded once stays loaded, so that nothing is imported in flight.
A name such as `mine:Law` is an object of a module instead, which needs no distribution.
docs/plug-ins.md describes each kind.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import Any, Final

from companion.errors import ConfigError

LAWS: Final = "dmuca.laws"
POLICIES: Final = "dmuca.policies"
RADIOS: Final = "dmuca.radios"
FIRMWARES: Final = "dmuca.firmwares"
GROUPS: Final = (LAWS, POLICIES, RADIOS, FIRMWARES)
"""Groups of entry points."""
_OF_MODULE: Final = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
_PATH: Final = "the Python path"
"""Given as the distribution of a plug-in that is named by its module."""
_WORDS: Final = 160
"""Most characters that a message quotes from an exception."""


@dataclass(frozen=True, slots=True)
class Plugin:
    """One plug-in that was loaded."""

    name: str
    value: str
    """What its entry point names, as "module:object"."""
    distribution: str
    """Name and version of the distribution that brings it."""
    loaded: Any
    """The object of that name. It is untrusted: whoever calls it checks what it returns."""

    def __str__(self) -> str:
        return f'"{self.name}" ({self.value} of {self.distribution})'


@cache
def load(group: str, name: str) -> Plugin:
    """Load a plug-in, or return the one that was loaded before.

    Args:
        group: one of `GROUPS`.
        name: name of an entry point, or "module:object". Such a module is looked for where Python looks, and
            last in the current folder.

    Raises:
        ConfigError: there is no such plug-in, several distributions bring one of this name, or it cannot be
            imported. The message names the distribution, the entry point and the cause.
    """
    found = metadata.entry_points(group=group, name=name)
    places = {(_named(entry), entry.value): entry for entry in found}
    if not places and is_of_module(name):
        places = {(_PATH, name): metadata.EntryPoint(name, name, group)}
    if not places:
        there = ", ".join(names(group)) or "none is installed"
        raise ConfigError(f"{name!r}: no plug-in of {group} has this name; plug-ins: {there}")
    if len(places) > 1:
        listed = " and ".join(f"{value} of {distribution}" for distribution, value in sorted(places))
        raise ConfigError(f"{name!r}: several plug-ins of {group} have this name: {listed}; keep one of them")
    ((distribution, value), entry) = places.popitem()
    here = [""] if distribution == _PATH else []
    sys.path += here
    try:
        loaded = entry.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever its modules do when they are imported
        raise ConfigError(
            f"{name!r}: the plug-in {value} of {distribution} ({group}) cannot be loaded: {cause(error)}"
        ) from error
    finally:
        if here:
            del sys.path[len(sys.path) - 1 - sys.path[::-1].index("")]
    return Plugin(name, value, distribution, loaded)


def is_of_module(name: str) -> bool:
    """Whether a name has the form "module:object". The object need not exist."""
    return _OF_MODULE.fullmatch(name) is not None


def names(group: str) -> list[str]:
    """Names of the installed plug-ins of a group, sorted. Scans the metadata of all distributions."""
    return sorted({entry.name for entry in metadata.entry_points(group=group)})


def cause(error: BaseException) -> str:
    """Type and text of an exception that a plug-in raised, in one short line."""
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = "its text cannot be read"
    return f"{type(error).__name__}: {text}"[:_WORDS].rstrip(": ")


def _named(entry: metadata.EntryPoint) -> str:
    brought = entry.dist
    return "an unknown distribution" if brought is None else f"{brought.name} {brought.version}"
