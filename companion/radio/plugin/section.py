"""Configuration of the radio of a plug-in."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from companion.radio.section import RadioSection


class PluginRadio(RadioSection, frozen=True, tag="plugin"):
    """A radio that another distribution brings."""

    driver = "companion.radio.plugin.plugin_radio:open_radio"
    name: Annotated[str, Meta(min_length=1)]
    """Name of an entry point of `dmuca.radios`."""
    options: dict[str, Any] = {}  # noqa: RUF012 (msgspec copies it)
    """What the plug-in is given. It checks its keys itself."""
