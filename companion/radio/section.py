"""Base of the configuration sections of radios. Each kind has its own in `section.py` of its folder."""

from __future__ import annotations

from typing import ClassVar, Self

import msgspec


class RadioSection(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="backend"
):
    """One [[radio]] of a configuration. The tag of a subclass is the value of its key `backend`.

    A configuration is read without loading any driver, so the driver is named here instead of imported.
    """

    driver: ClassVar[str]
    """Function that opens the radio, as "module:function". It takes the section and a `radio.RadioContext`,
    returns a `radio.Radio` and raises ConfigError."""
    at_own_rates: ClassVar[str | None] = None
    """Name of a radio that repeats messages at rates of its own, whatever rates are chosen in flight."""

    def check(self, name: str) -> None:
        """Check what the types of the keys do not.

        Args:
            name: file and section, for messages.

        Raises:
            ConfigError: names the key and what is allowed.
        """

    @property
    def sends(self) -> bool:
        """Whether the radio broadcasts at all, as far as the configuration tells."""
        return True

    def unfit_for(self, uas_id: str) -> str | None:
        """Why the radio cannot broadcast this identity, in words; None if it can."""
        return None

    def uses(self) -> dict[str, str]:
        """Devices and addresses that no other section may use, by key, in a form that compares equal."""
        return {}

    def listening(self) -> Self | None:
        """The listening part of the radio, for a program that only listens while another one sends; None if
        the radio has no such part."""
        return None

    def remark(self, system_id: int) -> str | None:
        """Warning of `companion check` about this vehicle; None if there is none. It begins with ".KEY: "."""
        return None
