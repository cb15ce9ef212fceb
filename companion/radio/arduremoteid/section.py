"""Configuration of a module with ArduRemoteID firmware."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from companion.address_forms import LINK_FORMS, check_form, used_by
from companion.radio.section import RadioSection

ZERO_BYTE = "the module cuts identities at a zero byte, and this aircraft's holds one"


class ArduRemoteIdRadio(RadioSection, frozen=True, tag="arduremoteid"):
    """A module with ArduRemoteID firmware on its own MAVLink link."""

    driver = "companion.radio.arduremoteid.module_radio:open_radio"
    at_own_rates = "a module with ArduRemoteID"
    link: str
    """Link to the module, in the form of vehicle.link, such as serial:/dev/ttyACM0:57600."""
    system_id: Annotated[int, Meta(ge=1, le=255)] = 1
    """MAVLink system ID of the vehicle. The module adopts the first one that it hears."""

    def check(self, name: str) -> None:
        """Check the form of the link."""
        check_form(self.link, LINK_FORMS, f"{name}.link")

    def unfit_for(self, uas_id: str) -> str | None:
        """The firmware reads identities as text that ends with a zero byte."""
        return ZERO_BYTE if "\0" in uas_id else None

    def uses(self) -> dict[str, str]:
        """The link: a module on the vehicle's link would be sent what the gate has not seen."""
        used = used_by(self.link)
        return {} if used is None else {"link": used}

    def remark(self, system_id: int) -> str | None:
        """A warning if the module is configured with the system ID of another vehicle."""
        if self.system_id == system_id:
            return None
        return (
            f".system_id: {self.system_id}, but the vehicle is system {system_id}: the module adopts "
            "the first system id that it hears, and its ARM_STATUS then goes to vehicle "
            f"{self.system_id}"
        )
