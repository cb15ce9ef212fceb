"""A small part of the campaign of hostile programs, and the errors that its oracle finds."""

from __future__ import annotations

import pytest

from companion.gate.gate import Gate
from companion.gate.rules import Rule
from tests.companion.gate.hostile import campaign as hostile
from tests.companion.gate.hostile.system_history import SystemHistory
from tests.companion.gate.hostile.weakened import (
    LACKING,
    CountsRepeatedAnswers,
    HearsNoSilence,
    IgnoresBacklogs,
    ReliesOnMixedLinks,
    TakesOvertakenModes,
    Weakened,
)


def test_no_rule_is_broken():
    block = hostile.run_block(seed=1, first=0, count=250, commands=100)
    assert block.broken == []
    assert block.commands > 25_000
    assert block.setpoints > 4_000
    assert block.requests > 300
    assert block.slowed > 10
    assert block.near > 5
    assert set(block.refused) == {rule.value.name for rule in Rule}


def test_a_gate_that_only_passes_everything_on_is_the_gate():
    plain, passed = (hostile.run_block(2, 0, 10, 100, make) for make in (hostile.Gate, Weakened))
    assert plain == passed


def is_found(gate, rule):
    """Whether one of 400 histories breaks the rule."""
    blocks = (hostile.run_block(1, first, 10, 100, gate) for first in range(0, 400, 10))
    return any(rule in {name for _, name, _ in block.broken} for block in blocks)


@pytest.mark.parametrize("rule", list(Rule), ids=lambda rule: rule.value.name)
def test_a_gate_that_lacks_a_rule_is_found(rule):
    assert is_found(LACKING[rule.value.name], rule.value.name)


@pytest.mark.parametrize(
    ("weak", "rule"),
    [(HearsNoSilence, "current"), (ReliesOnMixedLinks, "current"), (TakesOvertakenModes, "authority")],
)
def test_a_gate_that_trusts_what_it_hears_too_much_is_found(weak, rule):
    assert is_found(weak, rule)


def test_no_rule_is_broken_through_a_whole_companion():
    block = hostile.run_block(1, 0, 120, 100, kind=SystemHistory)
    assert block.broken == []
    assert block.commands > 12_000
    assert block.setpoints > 1_500
    assert block.requests > 80
    assert set(block.refused) == {rule.value.name for rule in Rule}


@pytest.mark.parametrize(("weak", "number"), [(CountsRepeatedAnswers, 597), (IgnoresBacklogs, 292)])
def test_a_companion_that_tells_its_gate_something_wrong_is_found(weak, number):
    def found(gate):
        return {name for _, name, _ in hostile.run_block(1, number, 1, 100, gate, SystemHistory).broken}

    assert found(weak) == {"current"}
    assert found(Gate) == set()


def test_without_any_gate_every_rule_is_broken():
    class NoGate(Weakened):
        def release(self, data, now_s):
            return data

    found = {name for _, name, _ in hostile.run_block(1, 0, 300, 30, NoGate).broken}
    assert {"whole", "kind", "target", "use", "current", "mode"} <= found


def test_a_history_comes_back_the_same():
    assert hostile.run_block(3, 7, 2, 100) == hostile.run_block(3, 7, 2, 100)
    assert hostile.run_block(3, 7, 2, 100) != hostile.run_block(4, 7, 2, 100)


def test_the_command_gives_a_verdict(capsys, monkeypatch):
    assert hostile.main(["--histories", "4", "--commands", "20", "--jobs", "1"]) == 0
    assert "no rule broken" in capsys.readouterr().out
    monkeypatch.setattr(
        hostile,
        "run_block",
        lambda *_, **__: hostile.Block(histories=1, commands=1, broken=[(9, "age", "old")]),
    )
    assert hostile.main(["--history", "9"]) == 1
    assert "BROKEN: history 9: age: old" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        hostile.main(["--histories", "0"])
