"""The chooser of transports for the own Remote ID. The core (`companion.core`) calls it in every step.

A policy, the rule or the fixed set decides at random phases. If it cannot decide (no policy at the start, an
observation outside its training, a result that is not a number, a radio that lost a transport), the chooser
takes the fixed legal set, logs the reason, and reports each kind of trouble to the pilot once. Nothing here
can violate the legal minimum: the broadcaster enforces it on every request.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from pathlib import PurePath
from typing import Final, Literal

import numpy as np

from companion.arrays import Bools
from companion.atmc.actions import TRANSPORTS, Action, able, legal, rates_of, transports_of
from companion.atmc.audible import CROWD, audible
from companion.atmc.choice import Mind, Refused
from companion.atmc.observation import random_phase
from companion.atmc.plugin_policy import plugin_policy
from companion.atmc.policy import PolicyError, check_flyable, load
from companion.atmc.rule import FIXED, FLYING_RULE, fixed
from companion.atmc.senses import Senses
from companion.broadcast.broadcaster import asked_rates
from companion.config import CHOOSER_WORDS, Config, policy_plugin
from companion.events import Command, RadioState, Say, Severity, TransportsChosen
from companion.ownship import Ownship
from companion.traffic.tracks import Traffic

By = Literal["policy", "rule", "fixed", "fallback"]
OLDEST_POSITION_S: Final = 5.0
"""Oldest own position from which distances to neighbours are computed."""
_SURE_AGAIN: Final = 5
"""Number of decisions in a row that the mind must make after a refusal before it is followed again. The last
of them is followed. This limits how often the transports switch between the mind and the fall-back."""


class Trouble(enum.Enum):
    """Reasons for the fall-back in addition to those of `choice.Why`."""

    NO_POLICY = "no_policy"
    NO_POSITION = "no_position"
    RADIO_LOST = "radio_lost"


class Chooser:
    """Chooses the transports of one aircraft.

    Args:
        mind: what decides; None if the configured policy cannot be used.
        by: what kind of `mind` decides, for the log.
        trouble: why `mind` is None, in words; None otherwise.
    """

    def __init__(self, config: Config, mind: Mind | None, by: By, trouble: str | None = None) -> None:
        self.by = by
        self.trouble = trouble
        """Why the configured policy cannot be used at all, in words; None if it can."""
        self._mind = mind
        self._region, self._configured = config.region, asked_rates(config)
        self._uas_id, self._period_s = config.identity.uas_id, config.atmc.period_s
        self._agent = config.atmc.agent or 0
        self._senses = Senses(config.identity.uas_id)
        self._numbers = {} if mind is None else {action: i for i, action in enumerate(mind.actions)}
        self._allowed: Bools = np.zeros(0, bool)
        self._allowed_of_few: Bools = np.zeros(0, bool)
        """What a policy may choose while few aircraft are heard."""
        self._can_send: tuple[str, ...] = ()
        self._action: Action | None = None
        self._doubts = 0
        """Decisions in a row that the mind still has to make before it is followed again; 0 while
        followed."""
        self._count = 0
        self._next_s: float | None = None
        self._logged: tuple[object, ...] | None = None
        self._told: set[enum.Enum] = set()

    def step(
        self, now_s: float, own: Ownship, traffic: Traffic, radio: RadioState, present: Mapping[str, int]
    ) -> tuple[dict[str, int] | None, list[Command]]:
        """Decide, if a decision is due, what to request from the broadcaster.

        Args:
            radio: what the radios can do.
            present: transports that are to be on the air now, with their Locations per second.

        Returns:
            Transports with their Locations per second, or None if nothing was decided; and commands for the
            log and the pilot.
        """
        if own.heartbeat is None or not radio.can_send:
            return None, []
        if radio.can_send != self._can_send:
            self._can_send = radio.can_send
            if self._mind is not None:
                actions = self._mind.actions
                self._allowed = legal(actions, self._region) & able(actions, self._can_send)
                self._allowed_of_few = audible(actions, self._allowed)
            lost = transports_of(self._action or (0, 0, 0)) - set(self._can_send)
            if self._mind is None:
                return self._fall_back(Trouble.NO_POLICY, self.trouble or "no policy is loaded")
            if lost:
                words = f"the radio can no longer send on {', '.join(sorted(lost))}"
                return self._fall_back(Trouble.RADIO_LOST, words)
        if self._mind is None or own.position is None:
            return None, []
        if self._next_s is None:
            self._plan(now_s)
        assert self._next_s is not None
        if now_s < self._next_s:
            return None, []
        self._plan(now_s)
        return self._decide(self._mind, now_s, own, traffic, present)

    def _plan(self, now_s: float) -> None:
        """Schedule the next decision at a random phase, so that aircraft do not decide at the same time."""
        self._next_s = now_s + self._period_s * (0.5 + random_phase(self._uas_id, self._count))
        self._count += 1

    def _decide(
        self, mind: Mind, now_s: float, own: Ownship, traffic: Traffic, present: Mapping[str, int]
    ) -> tuple[dict[str, int] | None, list[Command]]:
        age_s = own.age_s(now_s)
        if not age_s <= OLDEST_POSITION_S:
            return self._fall_back(Trouble.NO_POSITION, "own position is too old")
        seen = self._senses.look(now_s, own, traffic, present)
        ble4, ble5, wifi = (present.get(transport, 0) for transport in TRANSPORTS)
        current = self._numbers.get((ble4, ble5, wifi))
        few = self.by == "policy" and len(seen.rows) < CROWD
        allowed = self._allowed_of_few if few else self._allowed
        answer = mind.choose(seen.own, seen.rows, allowed, current, self._agent)
        if isinstance(answer, Refused):
            self._doubts = _SURE_AGAIN
            return self._fall_back(answer.why, answer.text)
        self._doubts = max(0, self._doubts - 1)
        if self._doubts:
            return None, []
        self._action = answer.action
        return rates_of(answer.action), self._tell(self.by, None, f"{len(seen.rows)} aircraft heard")

    def _fall_back(self, why: enum.Enum, words: str) -> tuple[dict[str, int] | None, list[Command]]:
        """Take the first fixed set that is legal and can be sent. If there is none, take the configured
        rates: the broadcaster sends what it can of them, and reports whether that is legal."""
        self._action = fixed(self._region, self._can_send)
        return self._rates(), self._tell("fallback", why, words)

    def _rates(self) -> dict[str, int]:
        """Rates to request from the broadcaster now."""
        return dict(self._configured) if self._action is None else rates_of(self._action)

    def _tell(self, by: By, why: enum.Enum | None, words: str) -> list[Command]:
        """Log entry if something changed, and a message to the pilot once for each kind of trouble."""
        rates = tuple(self._rates().items())
        commands: list[Command] = []
        if (rates, by, why) != self._logged:
            self._logged = (rates, by, why)
            commands.append(TransportsChosen(rates=rates, by=by, reason=words))
        if why is not None and why not in self._told:
            self._told.add(why)
            chosen = " + ".join(f"{transport} {rate}/s" for transport, rate in rates)
            if self._action is None:
                chosen += " (configured rates, as far as region and radio allow)"
            text = f"DMUCA: fallback transports, {words}; now {chosen}"
            commands.append(Say(severity=Severity.WARNING, text=text))
        return commands


def chooser_of(config: Config, policy: bytes | None) -> Chooser | None:
    """The chooser that the configuration requires; None if the transports stay as configured.

    Args:
        policy: content of the policy file; None if there is none, or if it could not be read.

    Raises:
        ConfigError: the policy is that of a plug-in that cannot be loaded.
    """
    wanted = config.atmc.policy
    if wanted in CHOOSER_WORDS:
        return Chooser(config, *((FLYING_RULE, "rule") if wanted == "rule" else (FIXED, "fixed")))
    if policy is None and wanted is None:
        return None
    if policy_plugin(wanted) is not None:
        try:
            return Chooser(config, plugin_policy(wanted), "policy")
        except PolicyError as error:
            return Chooser(config, None, "policy", f"policy {error}")
    name = PurePath(wanted or "policy").name
    if policy is None:
        return Chooser(config, None, "policy", f"policy {name} could not be read")
    try:
        found = load(policy, name)
        check_flyable(found, config.atmc.agent)
    except PolicyError as error:
        return Chooser(config, None, "policy", f"policy {error}")
    return Chooser(config, found, "policy")
