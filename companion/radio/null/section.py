"""Configuration of a radio that neither sends nor receives."""

from __future__ import annotations

from companion.radio.section import RadioSection


class NullRadio(RadioSection, frozen=True, tag="null"):
    """No radio."""

    driver = "companion.radio.null.null_radio:open_radio"

    @property
    def sends(self) -> bool:
        """Never."""
        return False
