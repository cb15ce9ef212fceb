"""docs/gate.md describes the same rules that the gate judges by."""

from __future__ import annotations

import re
from pathlib import Path

from companion.gate import rules

PAGE = Path(__file__).parents[3] / "docs" / "gate.md"


def test_the_page_has_all_rules_in_order():
    rows = re.findall(r"^\| (\d+) \| (\w+) \| \S", PAGE.read_text(), re.MULTILINE)
    assert rows == [(str(rule.number), rule.value.name) for rule in rules.Rule]
    assert [rule.number for rule in rules.Rule] == list(range(1, 15))


def test_what_a_broken_rule_ends():
    assert str(rules.Rule.FENCE) == "gate rule 13 (fence)"
    others = {rule.value.name: rule.ends for rule in rules.Rule if rule.ends != "fault"}
    assert others == {"current": "nothing", "authority": "authority", "age": "nothing"}
