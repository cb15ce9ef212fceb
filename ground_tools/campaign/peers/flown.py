"""Resolves the name of a law: the companion's, one of `laws`, a plug-in's, or `omniscient`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import msgspec

from companion import plugins
from companion.avoidance import kernels
from companion.config import AvoidanceConfig
from companion.errors import ConfigError
from companion.laws import plugin_of
from companion.plugins import Plugin
from ground_tools.campaign.peers import laws, omniscient
from ground_tools.campaign.peers.orca import Orca

OWN = "dmuca"
"""Name of the companion's own law."""


@dataclass(frozen=True, slots=True)
class Flown:
    """The law and the settings that a name refers to."""

    avoidance: AvoidanceConfig
    """Configuration of the companion's law. A peer law uses the parts that apply to it."""
    peer: tuple[laws.Peer, laws.Parameters] | None = None
    """The peer law, with its parameters, that flies instead of the companion's; None: the companion's law
    flies."""
    changed: dict[str, float] = field(default_factory=dict)
    """Changed numbers of the companion's law, by field of `kernels.Settings`."""
    planned: bool = False
    """Whether everything is planned before the flight (`omniscient`)."""
    plugin: Plugin | None = None
    """The plug-in that `avoidance` names. It flies in Python, with the companion's own tracks (`twins`)."""

    def settings_row(self, own: kernels.Settings, avoids: bool) -> list[float]:
        """The row of one aircraft in the table of settings of `flight.fly`.

        Args:
            own: settings of the companion's law for this aircraft.
            avoids: False: the aircraft flies its path only.
        """
        if avoids:  # an intruder flies as with the unchanged law
            own = own._replace(**self.changed)
        if self.planned:
            return list(own._replace(law=kernels.NONE))
        if self.peer is None:
            return list(own if avoids else own._replace(law=kernels.NONE))
        _, parameters = self.peer
        if isinstance(parameters, Orca):
            own = own._replace(growth=parameters.growth)
        return [*own._replace(law=kernels.NONE), 1.0 if avoids else 0.0, *parameters]


def flown_by(law: str, companions: Mapping[str, AvoidanceConfig]) -> Flown:
    """Resolve a law's name.

    Args:
        companions: the laws of the companion.

    Raises:
        ConfigError: there is no such law, or it has no such parameter.
    """
    if law in companions:
        return Flown(companions[law])
    if law == omniscient.NAME:
        return Flown(companions[OWN], planned=True)
    name = law.partition(":")[0]
    if name not in laws.PEERS and name != OWN:
        there = plugins.names(plugins.LAWS)
        if law not in there and not plugins.is_of_module(law):
            allowed = ", ".join([*companions, *laws.PEERS, omniscient.NAME, *there])
            raise ConfigError(
                f"--law: {name} is unknown; allowed: {allowed}, a plug-in's law, or MODULE:CLASS"
            )
        try:
            plugin = plugin_of(law)
        except ConfigError as error:
            raise ConfigError(f"--law: {error}") from error
        return Flown(msgspec.structs.replace(companions[OWN], law=law), plugin=plugin)
    try:
        if name == OWN:
            return Flown(companions[OWN], changed=laws.varied(law))
        peer = laws.of(law)
    except ValueError as error:
        raise ConfigError(f"--law: {error}") from error
    if (why := missing(law)) is not None:
        raise ConfigError(f"--law: {why}")
    return Flown(companions[OWN], peer=peer)


def missing(law: str) -> str | None:
    """What a peer law needs that is not there, as text; None if it can be flown."""
    peer = laws.PEERS.get(law.partition(":")[0])
    if peer is None or peer.needs is None:
        return None
    try:
        peer.needs()
    except ConfigError as error:
        return str(error)
    return None


def brought(law: str) -> str | None:
    """Digest of what a peer law brings from outside this project; None if that is nothing.

    Raises:
        ConfigError: it is not there.
    """
    peer = laws.PEERS.get(law.partition(":")[0])
    return None if peer is None or peer.needs is None else peer.needs()
