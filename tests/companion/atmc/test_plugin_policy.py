"""The policy of a plug-in chooses transports in flight; what it does wrong leads to the fall-back."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion import config as configuration
from companion.atmc.actions import SET_ACTIONS, legal
from companion.atmc.audible import audible
from companion.atmc.choice import Choice, Refused, Why
from companion.atmc.networks import PolicyError
from companion.atmc.observation import NEIGHBOUR_COLUMNS, OWN_COLUMNS
from companion.atmc.plugin_policy import plugin_policy, try_out
from companion.config import AtmcConfig
from companion.core import Companion
from companion.errors import ConfigError
from companion.events import RadioState, Say, TransportsChosen
from companion.remote_id.region import Region
from companion.runtime.policy import judge_policy, read_policy
from tests.support import plugged

ALL = RadioState(can_send=("ble4", "ble5", "nan", "wifi"))
US = Region(name="us", transport_sets=(("wifi",), ("ble4", "ble5")), location_period_s=1.0)


@pytest.fixture(autouse=True)
def site(tmp_path, monkeypatch):
    """The policies of `plugged.POLICIES`."""
    yield from plugged.installed(tmp_path, monkeypatch, "plugged_policies", plugged.policies)


@pytest.fixture
def watching(make_bench):
    """Builds an aircraft that watches, whose transports a policy chooses."""

    def build(policy):
        made = make_bench(use="watch")
        config = msgspec.structs.replace(made.core.config, region=US, atmc=AtmcConfig(policy=policy))
        bench = type(made)(Companion(config))
        bench.extra = [ALL]
        bench.step(200)
        return bench

    return build


def chosen(bench):
    return [c for _, c in bench.log if isinstance(c, TransportsChosen)]


def ask(name, allowed=None):
    policy = plugin_policy(f"plugin:{name}")
    can = np.ones(len(policy.actions), bool) if allowed is None else allowed
    return policy.choose(np.zeros(len(OWN_COLUMNS)), np.zeros((0, len(NEIGHBOUR_COLUMNS))), can, None)


def test_its_choice_goes_on_the_air(watching):
    (first, *more) = chosen(watching("plugin:far"))
    assert (first.by, dict(first.rates)) == ("policy", {"wifi": 4})
    assert not more


def test_an_action_that_is_not_legal_or_hardly_audible_is_not_offered_to_it(watching):
    first = chosen(watching("plugin:first"))[0]
    expected = SET_ACTIONS[int(np.flatnonzero(audible(SET_ACTIONS, legal(SET_ACTIONS, US)))[0])]
    assert dict(first.rates) == {t: r for t, r in zip(("ble4", "ble5", "wifi"), expected, strict=True) if r}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "lost",
            "(plugged_policies:Lost of plugged_policies 1.0) failed: KeyError: 'weights'",
        ),
        ("half", "failed: TypeError"),
        ("cancelled", "failed: GeneratorExit: cancelled"),
        ("beyond", "chose 9999, which is not allowed"),
        ("forbidden", "chose 0, which is not allowed"),
    ],
)
def test_what_it_does_wrong_leads_to_the_fall_back_and_the_pilot_is_told(watching, name, words):
    bench = watching(f"plugin:{name}")
    found = chosen(bench)
    assert [one.by for one in found] == ["fallback"]
    assert words in found[0].reason
    told = [c.text for _, c in bench.log if isinstance(c, Say) and "fallback transports" in c.text]
    assert len(told) == 1
    assert words in told[0]


def test_answers_are_checked():
    assert ask("far") == Choice(0, (0, 0, 4))
    assert ask("far", np.array([False, True])).why is Why.BROKEN
    assert ask("far", np.zeros(2, bool)) == Refused(
        Why.NOTHING_ALLOWED, "no set of transports is legal and can be sent"
    )


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        ("fast", "actions: (0, 0, 11) is not three rates of 0 to 10, one of them above 0"),
        ("silent", "actions: (0, 0, 0) is not three rates"),
        ("twice", "actions: there is none, or one is listed twice"),
        ("bare", "AttributeError: 'Bare' object has no attribute 'actions'"),
    ],
)
def test_one_without_proper_actions_makes_no_policy(name, cause, make_bench):
    with pytest.raises(PolicyError) as refused:
        plugin_policy(f"plugin:{name}")
    assert cause in str(refused.value)
    config = msgspec.structs.replace(make_bench().core.config, atmc=AtmcConfig(policy=f"plugin:{name}"))
    with pytest.raises(ConfigError, match="makes no policy"):
        judge_policy(config)


def test_it_is_tried_out_on_the_ground():
    assert try_out(plugin_policy("plugin:far"), US) == 2
    with pytest.raises(PolicyError, match="failed: KeyError"):
        try_out(plugin_policy("plugin:lost"), US)
    only = Region(name="nan", transport_sets=(("nan",),))
    with pytest.raises(PolicyError, match="none of its actions is legal in region nan"):
        try_out(plugin_policy("plugin:far"), only)


def test_a_configuration_names_it(site):
    file = site / "my.toml"
    file.write_text('[identity]\nuas_id = "1596B0000DMUCA01"\n[atmc]\npolicy = "plugin:far"\n')
    made = configuration.load(file)
    assert made.atmc.policy == "plugin:far"
    assert read_policy(made) is None
    assert 'chosen by the policy "far" (plugged_policies:Far of' in judge_policy(made)[0]
    file.write_text('[identity]\nuas_id = "1596B0000DMUCA01"\n[atmc]\npolicy = "plugin:gone"\n')
    with pytest.raises(ConfigError, match=r"my\.toml: atmc\.policy: 'gone': no plug-in of dmuca\.policies"):
        configuration.load(file)
