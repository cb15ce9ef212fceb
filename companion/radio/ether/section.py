"""Configuration of the simulated radio."""

from __future__ import annotations

from typing import Self

from companion.address_forms import check_form
from companion.radio.section import RadioSection


class EtherRadio(RadioSection, frozen=True, tag="ether"):
    """Connection to the simulated radio channel (ether)."""

    driver = "companion.radio.ether.ether_radio:open_radio"
    address: str
    """HOST:PORT."""

    def check(self, name: str) -> None:
        """Check the form of the address."""
        check_form(self.address, ("HOST:PORT",), f"{name}.address")

    def uses(self) -> dict[str, str]:
        """The address: another radio of this aircraft there would hear everything twice."""
        return {"address": f"ether {self.address}"}

    def listening(self) -> Self:
        """The whole radio: the simulated air has room for many."""
        return self
