"""The policy file: read for the core (`companion.core`), and checked before flight."""

from __future__ import annotations

from pathlib import Path

from companion.atmc.actions import legal
from companion.atmc.plugin_policy import plugin_policy, try_out
from companion.atmc.policy import MAX_BYTES, check_flyable, load
from companion.config import CHOOSER_WORDS, Config, names_file
from companion.errors import ConfigError

RUN_FILE = "policy.safetensors"
"""Name of the policy file in a run folder."""


def read_policy(config: Config) -> bytes | None:
    """Content of the configured policy file, even if it is damaged; None if no file is configured.

    Raises:
        ConfigError: the file cannot be read.
    """
    where = config.atmc.policy
    if where is None or not names_file(where):
        return None
    try:
        with Path(where).open("rb") as file:
            return file.read(MAX_BYTES + 1)  # one byte more than allowed: enough to refuse a larger file
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a file name"
        raise ConfigError(
            f"atmc.policy: {where}: cannot be read: {reason}; allowed: the path of a policy file, relative "
            f"to the configuration, or {' or '.join(CHOOSER_WORDS)}"
        ) from error


def judge_policy(config: Config) -> list[str]:
    """Lines that tell the user what chooses the transports; empty if `atmc.policy` is not set.

    Raises:
        ConfigError: the policy cannot be read, is damaged, cannot be flown, or has no action that is legal in
            the configured region.
    """
    where = config.atmc.policy
    if where is None:
        return []
    own = dict.fromkeys(radio.at_own_rates for radio in config.radio if radio.at_own_rates)
    lines = [
        f"atmc: {name} repeats messages at its own rates; the choice affects other radios only"
        for name in own
    ]
    plugged = plugin_policy(where)
    if plugged is not None:
        allowed = try_out(plugged, config.region)
        text = (
            f"atmc: transports are chosen by the policy {plugged.plugin}; {allowed} of {len(plugged.actions)}"
        )
        return [f"{text} actions are legal in region {config.region.name}", *lines]
    data = read_policy(config)
    if data is None:
        return [f'atmc: transports are chosen by the built-in policy "{where}"', *lines]
    policy = load(data, f"atmc.policy: {where}")
    check_flyable(policy, config.atmc.agent)
    m = policy.metadata
    allowed = int(legal(policy.actions, config.region).sum())
    if not allowed:
        raise ConfigError(
            f"atmc.policy: {where}: none of its actions is legal in region {config.region.name}"
        )
    return [
        f'atmc: transports are chosen by policy "{m.name}" ({m.objective}), up to {m.neighbours} neighbours; '
        f"{allowed} of {len(m.actions)} actions are legal in region {config.region.name}",
        *lines,
    ]
