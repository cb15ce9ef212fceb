"""docs/gate.md prints the rules that are judged."""

from __future__ import annotations

from pathlib import Path

from companion.gate import rules

PAGE = Path(__file__).parents[3] / "docs" / "gate.md"


def test_the_page_prints_the_table():
    assert rules.table() in PAGE.read_text()


def test_the_table_has_all_rules_in_order():
    assert [rule.number for rule in rules.Rule] == list(range(1, 15))
    assert rules.table().count("\n") == 15
    assert str(rules.Rule.FENCE) == "gate rule 13 (fence)"
    others = {rule.value.name: rule.ends for rule in rules.Rule if rule.ends != "fault"}
    assert others == {"current": "nothing", "authority": "authority", "age": "nothing"}
