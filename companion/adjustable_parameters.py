"""The few numbers of a configuration that a ground station may change, each under a parameter name.

A setting overrides the configuration; None keeps the configured value. Each setting is checked against its
own range. All settings together must also pass the checks of the configuration itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec

from companion import config as configuration
from companion.avoidance.path import check_path
from companion.config import Config
from companion.errors import ConfigError
from companion.events import Settings

ENABLE = "DMUCA_ENABLE"
"""Parameter: 0 if the companion must neither take nor keep the vehicle, 1 if it acts as `flight.use` says."""
SWITCHED_OFF = f"switched off ({ENABLE} is 0)"
"""Text for the status and the pilot while it is 0."""


@dataclass(frozen=True, slots=True)
class _Number:
    """One adjustable number of the configuration."""

    section: str
    key: str
    """Key in the section, and field of `Settings`."""
    lowest: float
    highest: float

    def configured(self, config: Config) -> float:
        """The configured value."""
        value: float = getattr(getattr(config, self.section), self.key)
        return value


_NUMBERS = {
    "DMUCA_RADIUS": _Number("avoidance", "conflict_radius_m", 2.0, 50.0),
    "DMUCA_HORIZON": _Number("avoidance", "horizon_s", 5.0, 60.0),
    # Somebody is responsible for the configured speed, so it may only be lowered over a link.
    "DMUCA_SPD_MAX": _Number("limits", "max_speed_mps", 1.0, 0.0),
}
NAMES = (ENABLE, *_NUMBERS)
"""All parameter names in the order of their PARAM index, at most 16 characters each."""


def value_of(name: str, config: Config, settings: Settings) -> float:
    """Value of a parameter that is in effect now.

    Args:
        config: the configuration without settings.
    """
    if name == ENABLE:
        return float(settings.enable)
    number = _NUMBERS[name]
    value: float | None = getattr(settings, number.key)
    return number.configured(config) if value is None else value


def allowed(name: str, config: Config) -> tuple[float, float]:
    """Lowest and highest value that a parameter may be given. The configured value is always in this range.

    Args:
        config: the configuration without settings.
    """
    if name == ENABLE:
        return 0.0, 1.0
    number = _NUMBERS[name]
    configured = number.configured(config)
    return min(number.lowest, configured), max(number.highest, configured)


def changed(name: str, value: float, config: Config, settings: Settings) -> Settings:
    """Settings with one of them changed. Setting the configured value removes the setting.

    Args:
        value: new value. It may come from a 32-bit float, so only six digits are used.
        config: the configuration without settings.

    Raises:
        ConfigError: names the parameter and what is allowed.
    """
    value = _six(value)
    if name == ENABLE:
        if value not in (0.0, 1.0):
            raise ConfigError(f"{name}: {value:g}: allowed: 0 (watch only), 1 (as configured)")
        return msgspec.structs.replace(settings, enable=value == 1.0)
    number = _NUMBERS[name]
    configured = number.configured(config)
    lowest, highest = allowed(name, config)
    if value == _six(configured):
        new = msgspec.structs.replace(settings, **{number.key: None})
    elif lowest <= value <= highest:
        new = msgspec.structs.replace(settings, **{number.key: value})
    else:
        # NaN also ends here.
        raise ConfigError(f"{name}: {value:g}: allowed: {lowest:g} to {highest:g}")
    result = applied(config, new)
    configuration.check(result, f"{name} {value:g}")
    check_path(result, f"{name} {value:g}")
    return new


def checked(settings: Settings, config: Config) -> Settings:
    """Check settings that were made for an earlier configuration against this one.

    Raises:
        ConfigError: names the parameter and what is allowed.
    """
    result = Settings()
    for name in NAMES:
        result = changed(name, value_of(name, config, settings), config, result)
    return result


def applied(config: Config, settings: Settings) -> Config:
    """The configuration with the settings applied. `Settings.enable` is not part of it."""
    sections: dict[str, dict[str, float]] = {}
    for number in _NUMBERS.values():
        value: float | None = getattr(settings, number.key)
        if value is not None:
            sections.setdefault(number.section, {})[number.key] = value
    return msgspec.structs.replace(
        config,
        **{name: msgspec.structs.replace(getattr(config, name), **keys) for name, keys in sections.items()},
    )


def differences(config: Config, before: Settings, after: Settings) -> list[str]:
    """Changes between two settings, in words for the pilot."""
    values = {name: (value_of(name, config, before), value_of(name, config, after)) for name in NAMES}
    return [f"{name} {new:g}, was {old:g}" for name, (old, new) in values.items() if new != old]


def _six(value: float) -> float:
    return float(f"{value:.6g}")
