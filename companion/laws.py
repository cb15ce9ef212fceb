"""All avoidance laws by name. A new law is added here; everything else about it is in its own file.

A name that is not here is that of a plug-in (`companion.plugins`).
"""

from __future__ import annotations

from dataclasses import dataclass

from companion import plugins
from companion.errors import ConfigError
from companion.plugins import Plugin


@dataclass(frozen=True, slots=True)
class LawKind:
    """What the configuration knows of one law. A configuration is read without loading any law, so the class
    is named here instead of imported."""

    made_by: str
    """The law's class, as "module:class": `companion.avoidance.law.Law` or a subclass."""
    avoids: bool = True
    """Whether the law avoids other aircraft."""
    keeps_fence: bool = False
    """Whether the law keeps a fence."""


LAWS: dict[str, LawKind] = {
    "dmuca": LawKind("companion.avoidance.law:Law", keeps_fence=True),
    "paper": LawKind("companion.avoidance.law:Law"),
    "none": LawKind("companion.avoidance.law:Law", avoids=False),
}
PLUGIN = LawKind("companion.avoidance.plugin_law:PluginLaw", keeps_fence=True)
"""Every law of a plug-in: `PluginLaw` keeps limits and fence for it."""


def kind_of(law: str) -> LawKind:
    """What the configuration knows of a law, which may be one of a plug-in."""
    return LAWS.get(law, PLUGIN)


def plugin_of(law: str) -> Plugin | None:
    """The plug-in that brings a law; None for a law of our own.

    Raises:
        ConfigError: there is no such law, or its plug-in cannot be loaded. The message begins with the name.
    """
    if law in LAWS:
        return None
    there = plugins.names(plugins.LAWS)
    if law not in there and not plugins.is_of_module(law):
        allowed = ", ".join([*LAWS, *there])
        raise ConfigError(f"{law!r} is unknown; allowed: {allowed}, a plug-in's law, or MODULE:CLASS")
    return plugins.load(plugins.LAWS, law)
