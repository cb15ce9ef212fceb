"""Decides what goes on the air, once for `companion check` and `companion run`, so that both agree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from companion.broadcast.broadcaster import asked_rates
from companion.broadcast.legal_floor import (
    MARGIN,
    Decided,
    keep_floor,
    longest_period_s,
    too_slow,
    whole_rates,
)
from companion.config import Config
from companion.errors import ConfigError
from companion.remote_id.region import Region
from companion.runtime.radios import Radios


@dataclass(frozen=True, slots=True)
class Prepared:
    """Result of `prepare`: the broadcast for which the radios are ready."""

    lines: tuple[str, ...]
    """Lines for the user: what goes on the air and why, and what is set on the radios."""
    legal: bool
    """Whether the region's law is kept and, if a radio is configured, something is broadcast."""
    sent: frozenset[str]
    """Transports that are broadcast."""


def prepare(config: Config, radios: Radios, *, armed: bool = False) -> Prepared:
    """Decide what goes on the air and prepare the radios for it.

    Radios that were opened without `sending` are only probed. If the radios only listen, nothing is raised
    for the law: the vehicle then needs a Remote ID module of its own, and the core (`companion.core`) waits
    for it.

    Args:
        armed: the vehicle may be in the air already. The radios are then prepared for what they can send,
            whether it is legal or not.

    Raises:
        ConfigError: a radio cannot be prepared; or flight.use is not "watch", the vehicle is not armed, and
            the radios that send cannot keep the region's law.
    """
    fly = config.flight.use != "watch" and not armed
    decided = keep_floor(asked_rates(config), config.region, radios.capabilities)
    if not decided.legal:
        if fly and radios.capabilities:
            raise ConfigError(f"remote_id: {decided.reason}")
        if not (armed and decided.rates):
            nothing = "nothing is broadcast, unless the vehicle has a Remote ID module of its own"
            return Prepared((f"remote ID: {nothing}: {decided.reason}",), False, frozenset())
    channel = radios.wifi_channel
    slow = too_slow(decided.rates, config.region, channel, config.flight.setpoint_rate_hz)
    if slow is not None and fly:
        raise ConfigError(f"remote_id: {slow}")
    lines = [f"remote ID: {_on_air(decided, config.region, channel)}"]
    if slow is not None:
        lines.append(f"remote ID: {slow}")
    lines += radios.configure(whole_rates(decided.rates, config.region, channel))
    sends = bool(decided.rates) or not config.has_radio
    return Prepared(tuple(lines), decided.legal and slow is None and sends, frozenset(decided.rates))


def opened(config: Config, say: Callable[[str], None], *, sending: bool) -> tuple[Radios, str | None]:
    """Open the radios and prepare them.

    Args:
        say: receives the lines of `Prepared`.
        sending: see `Radios`.

    Returns:
        The radios that could be opened, and why they cannot be used as configured (None if they can).
    """
    failed: list[str] = []
    radios = Radios(config, sending=sending, failed=failed.append)
    if not failed:
        try:
            for line in prepare(config, radios).lines:
                say(line)
        except ConfigError as error:
            failed.append(str(error))
    return radios, "; ".join(failed) or None


def _on_air(decided: Decided, region: Region, wifi_channel: int | None) -> str:
    """The transports with their actual rates, and the reasons for these."""
    rates, reasons = [], [decided.reason] if decided.reason else []
    for transport, rate in decided.rates.items():
        period_s = longest_period_s(region, transport, wifi_channel)
        if period_s is None or rate * MARGIN * period_s >= 1.0:
            rates.append(f"{transport} {rate}/s")
            continue
        rates.append(f"{transport} {1.0 / (MARGIN * period_s):.3g}/s")
        on_wifi = transport == "wifi" and wifi_channel is not None
        where = f" on channel {wifi_channel}" if on_wifi else ""
        because = "sent with a margin" if rate * period_s >= 1.0 else f"not {rate}/s"
        reasons.append(f"region {region.name} asks for {transport}{where} every {period_s:g} s, {because}")
    return (", ".join(rates) or "nothing") + (f" ({'; '.join(reasons)})" if reasons else "")
