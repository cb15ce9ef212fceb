"""Adaptive transmission mode configuration (ATMC): choice of the transports and rates of the own Remote ID.

The paper's ATMC algorithm trains a network on the ground; here the frozen policy runs on the aircraft and
decides, by default every 2 s, on which of BLE 4, BLE 5 and Wi-Fi the own Locations are sent, and how often.
`chooser.Chooser` is called by the core in every step. It asks a `choice.Mind`: a `policy.Policy`, or a
`rule.Rule`, which needs no network, or a `plugin_policy.PluginPolicy`. `senses.Senses` builds the observation
from tracks, and `observation` defines its columns for the aircraft and the trainer alike. `audible` limits
the choice while few aircraft are heard. Whatever is chosen, the broadcaster keeps the region's legal minimum.
This room may import the rooms before it in `ROOMS` of tests/test_imports.py. Start with `chooser.py`, then
`actions.py` and `policy.py`; docs/atmc.md and docs/atmc-policy.md give the results.
"""

from companion.atmc.actions import Action, able, legal, rates_of, transports_of
from companion.atmc.choice import Choice, Mind, Refused, Why
from companion.atmc.chooser import Chooser, chooser_of
from companion.atmc.policy import Policy, PolicyError, check_flyable
from companion.atmc.policy import load as load_policy
from companion.atmc.rule import Rule, fixed
from companion.atmc.senses import Seen, Senses

__all__ = [
    "Action",
    "Choice",
    "Chooser",
    "Mind",
    "Policy",
    "PolicyError",
    "Refused",
    "Rule",
    "Seen",
    "Senses",
    "Why",
    "able",
    "check_flyable",
    "chooser_of",
    "fixed",
    "legal",
    "load_policy",
    "rates_of",
    "transports_of",
]
