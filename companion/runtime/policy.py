"""The policy file: read for the core (`companion.core`), and checked before flight."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from companion.atmc.actions import Action, able, legal
from companion.atmc.plugin_policy import plugin_policy, try_out
from companion.atmc.policy import MAX_BYTES, check_flyable, load
from companion.atmc.rule import FLYING_RULE
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


def without_choice(config: Config, can_send: Collection[str]) -> str | None:
    """Why the policy can choose nothing with radios that send on these transports, in words; None if it can
    choose, or if there is no policy that can be used.

    In flight it would look at work, but only the fall-back would be used.
    """
    try:
        actions = _actions(config)
    except ConfigError:
        return None  # `judge_policy` says why.
    if not actions or (legal(actions, config.region) & able(actions, can_send)).any():
        return None
    have = ", ".join(sorted(can_send)) or "nothing"
    return (
        f"none of its {len(actions)} actions is legal in region {config.region.name} and can be sent by the "
        f"radios ({have}); in flight only the fall-back is used"
    )


def _actions(config: Config) -> Sequence[Action]:
    """Actions of the configured policy; empty if there is none. Raises ConfigError if it cannot be used."""
    where = config.atmc.policy
    if where is None:
        return ()
    plugged = plugin_policy(where)
    if plugged is not None:
        return plugged.actions
    data = read_policy(config)
    return FLYING_RULE.actions if data is None else load(data, where).actions
