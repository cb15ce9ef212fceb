"""`python -m tests.support.states`: writes the diagram of authority states into docs/authority.md."""

from __future__ import annotations

from pathlib import Path

from companion.authority.table import HOLDING, TRANSITIONS, State
from tests.support.diagrams import page_with

PAGE = Path(__file__).parents[2] / "docs" / "authority.md"


def diagram() -> str:
    """The states and transitions in the Mermaid language, with one arrow between two states."""
    causes: dict[tuple[State, State], list[str]] = {}
    for (state, trigger), following in TRANSITIONS.items():
        causes.setdefault((state, following), []).append(trigger.value)
    lines = ["stateDiagram-v2", f"    [*] --> {State.STANDBY.value}"]
    lines += [f"    {a.value} --> {b.value}: {', '.join(words)}" for (a, b), words in causes.items()]
    lines += ["    classDef ours font-weight:bold"]
    lines += [f"    class {state.value} ours" for state in State if state in HOLDING]
    return "\n".join(lines) + "\n"


def page_with_diagram(text: str) -> str:
    """The page with a new diagram."""
    return page_with(diagram(), text)


if __name__ == "__main__":
    PAGE.write_text(page_with_diagram(PAGE.read_text()))
