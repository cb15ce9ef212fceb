"""Tries out the plug-ins that a configuration names before a flight, and describes them to the user."""

from __future__ import annotations

from companion.atmc.plugin_policy import plugin_policy
from companion.avoidance.plugin_law import try_out
from companion.config import Config
from companion.errors import ConfigError
from companion.laws import plugin_of
from companion.runtime.policy import judge_policy


def judge_plugins(config: Config) -> list[str]:
    """Lines that tell the user which plug-ins fly; none if the configuration names none.

    Raises:
        ConfigError: one of them cannot be loaded, or fails when it is tried out.
    """
    if plugin_policy(config.atmc.policy) is not None:
        judge_policy(config)
    law = plugin_of(config.avoidance.law)
    if law is None:
        return []
    try:
        try_out(config.avoidance, config.limits)
    except ConfigError as error:
        raise ConfigError(f"avoidance.law: {error}") from error
    return [f"plug-in: aircraft are avoided by the law {law}; limits and fence are kept for it"]
