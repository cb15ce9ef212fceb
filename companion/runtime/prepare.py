"""What goes on the air, decided once for `companion check` and `companion run`: they cannot differ."""

from __future__ import annotations

from dataclasses import dataclass

from companion.broadcast.broadcaster import asked_rates
from companion.broadcast.legal_floor import Decided, keep_floor, longest_period_s, too_slow, whole_rates
from companion.config import Config
from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.runtime.radios import Radios


@dataclass(frozen=True, slots=True)
class Prepared:
    """The broadcast of radios that are ready for it."""

    lines: tuple[str, ...]
    """For the user: what goes on the air and why, and what is set on the radios."""
    legal: bool
    """The law is kept and, where there is a radio, something goes out."""


def prepare(config: Config, radios: Radios) -> Prepared:
    """Decide what goes on the air and prepare the radios for it; those that are not sending are only asked
    whether they could be.

    Raises:
        ConfigError: a radio cannot be prepared; or `use` is not "watch" and the region's law cannot be kept
            by what sends. With radios that only listen the vehicle must have a module of its own; the heart
            waits for it.
    """
    fly = config.flight.use != "watch"
    decided = keep_floor(asked_rates(config), config.region, radios.capabilities)
    if not decided.legal:
        if fly and radios.capabilities:
            raise ConfigError(f"remote_id: {decided.reason}")
        nothing = "nothing is broadcast, unless the vehicle has a Remote ID module of its own"
        return Prepared((f"remote ID: {nothing}: {decided.reason}",), legal=False)
    channel = radios.wifi_channel
    slow = too_slow(decided.rates, config.region, channel, config.flight.setpoint_rate_hz)
    if slow is not None and fly:
        raise ConfigError(f"remote_id: {slow}")
    lines = [f"remote ID: {_on_air(decided, config.region, channel)}"]
    if slow is not None:
        lines.append(f"remote ID: {slow}")
    lines += radios.configure(whole_rates(decided.rates, config.region, channel))
    sends = bool(decided.rates) or not config.has_radio
    return Prepared(tuple(lines), legal=slow is None and sends)


def _on_air(decided: Decided, region: Region, wifi_channel: int | None) -> str:
    """Transports with the rates that go out, and why these."""
    rates, reasons = [], [decided.reason] if decided.reason else []
    for transport, rate in decided.rates.items():
        period_s = longest_period_s(region, transport, wifi_channel)
        if period_s is None or rate * period_s >= 1.0:
            rates.append(f"{transport} {rate}/s")
            continue
        rates.append(f"{transport} at least {1.0 / period_s:g}/s")
        where = f" on channel {wifi_channel}" if transport == "wifi" else ""
        reasons.append(f"region {region.name} asks for {transport}{where} every {period_s:g} s, not {rate}/s")
    return (", ".join(rates) or "nothing") + (f" ({'; '.join(reasons)})" if reasons else "")
