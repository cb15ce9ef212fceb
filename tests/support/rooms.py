"""`python -m tests.support.rooms`: writes the diagram of companion's rooms into docs/architecture.md.

An arrow goes from a room to each room that it imports. Arrows that follow from others are left out.
"""

from __future__ import annotations

from pathlib import Path

from tests.support.diagrams import page_with
from tests.test_imports import ROOMS, ROOT, module_name, modules, rooms_of

PAGE = ROOT / "docs" / "architecture.md"


def imports() -> dict[str, set[str]]:
    """The rooms that each room imports."""
    found: dict[str, set[str]] = {room: set() for room in ROOMS}
    for path in sorted((ROOT / "companion").rglob("*.py")):
        own = rooms_of(module_name(path))
        if own is not None:
            found[own] |= {room for name in modules(path) if (room := rooms_of(name)) in found} - {own}
    return found


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The transitive reduction of the graph: without arrows that follow from others."""
    reached: dict[str, set[str]] = {}
    for room in ROOMS:
        reached[room] = graph[room].union(*(reached[other] for other in graph[room]))
    return {room: {o for o in to if not any(o in reached[p] for p in to)} for room, to in graph.items()}


def diagram() -> str:
    """The rooms and their arrows in the Mermaid language."""
    lines = ["graph TD"]
    for room, others in reduced(imports()).items():
        lines += [f"    {room} --> {other}" for other in sorted(others)]
    return "\n".join(lines).replace("__main__", "main") + "\n"


def page_with_diagram(text: str) -> str:
    """The page with a new diagram."""
    return page_with(diagram(), text)


def main(page: Path = PAGE) -> None:
    """Write a new diagram into the page."""
    page.write_text(page_with_diagram(page.read_text()))


if __name__ == "__main__":
    main()
