"""Diagrams in the Mermaid language on pages of the documentation."""

from __future__ import annotations

_BEGIN, _END = "```mermaid\n", "```\n"


def page_with(diagram: str, page: str) -> str:
    """Return the text of a page with its first diagram replaced."""
    before, _, rest = page.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return before + _BEGIN + diagram + _END + after
