"""Command-line options that `ground-tools channel table`, `plot` and `compare` share."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from companion.errors import ConfigError
from companion.shipped import given
from ground_tools.channel.fixed_modes import Settings
from sitl_mocks.channel.parameters import MODES, ChannelParameters, check_rate, load, max_rates

SIDES_M: Final = (100.0, 500.0, 1000.0, 3000.0, 5000.0, 10000.0)
"""Sides of the paper's squares. Its "100 m^2" is a square with a side of 100 m."""
UAVS: Final = 10
SAMPLES: Final = 1000
SEED: Final = 1
MAX_SEED: Final = 2**32 - 1
_USUAL_RATES: Final = 10
_MAX_SIDE_M: Final = 1e6
_MAX_SIGMA_DB: Final = 30.0
_MAX_SAMPLES: Final = 100_000
_MAX_UAVS: Final = 1000

LISTS = "Separate the items of a list by spaces or commas: --sides 100 500, --rates 1,5,9, --rates 1-10."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that select what is evaluated."""
    parser.add_argument(
        "--sides",
        nargs="+",
        metavar="M",
        help="sides of the squares in m (default: 100 500 1000 3000 5000 10000)",
    )
    parser.add_argument(
        "--rates",
        nargs="+",
        metavar="N",
        help="messages per GNSS period (default: 1-10, or up to a mode's max_rate if that is less)",
    )
    parser.add_argument(
        "--modes", nargs="+", metavar="MODE", help=f"modes out of {', '.join(MODES)} (default: all)"
    )
    parser.add_argument(
        "--sigma",
        nargs="+",
        metavar="DB",
        help="standard deviation of the shadowing; the paper's variance of 6 dB is 2.449 dB "
        "(default: that of the parameters; 0 in the paper's)",
    )
    parser.add_argument(
        "--uavs", type=int, default=UAVS, metavar="N", help="number of aircraft (default: 10)"
    )
    add_parameters(parser)
    add_sampling(parser)


def add_parameters(parser: argparse.ArgumentParser) -> None:
    """Add the option that names a parameter file."""
    parser.add_argument(
        "--parameters", type=given, metavar="FILE", help="channel parameters as TOML (default: the paper's)"
    )


def parameters_of(args: argparse.Namespace) -> ChannelParameters:
    """The channel parameters of the file, or the paper's without a file.

    Raises:
        ConfigError: the file is wrong; the message names the file, the key, its value and what is allowed.
    """
    return ChannelParameters() if args.parameters is None else load(args.parameters)


def add_sampling(parser: argparse.ArgumentParser) -> None:
    """Add the options of the Monte Carlo average."""
    parser.add_argument(
        "--samples",
        type=int,
        default=SAMPLES,
        metavar="N",
        help="random sets of positions for each side (default: 1000)",
    )
    add_seed(parser)


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add the option for the seed of the random draw."""
    parser.add_argument(
        "--seed", type=int, default=SEED, metavar="N", help="seed of the random draws (default: 1)"
    )


def settings_of(args: argparse.Namespace) -> Settings:
    """The settings that the options select.

    Raises:
        ConfigError: an option is wrong; the message names it, its value and what is allowed.
    """
    parameters = parameters_of(args)
    check_sampling(args.samples, args.seed)
    if not 2 <= args.uavs <= _MAX_UAVS:
        raise ConfigError(f"--uavs: {args.uavs} is out of range; allowed: 2 to {_MAX_UAVS}")
    modes = _modes(args.modes)
    sides = _numbers("--sides", args.sides, _MAX_SIDE_M, above=True) if args.sides else SIDES_M
    sigmas: tuple[float, ...] = (parameters.propagation.shadowing_sigma_db,)
    if args.sigma:
        sigmas = _numbers("--sigma", args.sigma, _MAX_SIGMA_DB)
    return Settings(
        parameters=parameters,
        sides_m=sides,
        rates=_rates(args.rates, modes, parameters),
        sigmas_db=sigmas,
        uavs=args.uavs,
        samples=args.samples,
        seed=args.seed,
    )


def check_sampling(samples: int, seed: int) -> None:
    """Check the number of samples and the seed.

    Raises:
        ConfigError: one of them is out of range; the message names the option, its value and what is allowed.
    """
    if not 2 <= samples <= _MAX_SAMPLES:
        raise ConfigError(f"--samples: {samples} is out of range; allowed: 2 to {_MAX_SAMPLES}")
    check_seed(seed)


def check_seed(seed: int) -> None:
    """Check the seed.

    Raises:
        ConfigError: the seed is out of range; the message names the option, its value and what is allowed.
    """
    if not 0 <= seed <= MAX_SEED:
        raise ConfigError(f"--seed: {seed} is out of range; allowed: 0 to {MAX_SEED}")


def make_folder(path: Path) -> None:
    """Create the folder of the option --out if it does not exist.

    Raises:
        ConfigError: the folder cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out: {path}: the folder cannot be created: {error.strerror}") from error


def _words(option: str, given: Iterable[str]) -> list[str]:
    """Split the arguments of a list option into its items."""
    words = [word.strip() for part in given for word in part.strip().strip(",").split(",")]
    if "" in words:
        raise ConfigError(f"{option}: {' '.join(given)!r}: an item of the list is empty. {LISTS}")
    return words


def _numbers(option: str, given: list[str], largest: float, *, above: bool = False) -> tuple[float, ...]:
    """Parse numbers from 0 (`above`: more than 0) to `largest`, and drop duplicates."""
    allowed = f"more than 0 and at most {largest:,.0f}" if above else f"0 to {largest:,.0f}"
    found = []
    for word in _words(option, given):
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not (0.0 < value <= largest if above else 0.0 <= value <= largest):
            raise ConfigError(f"{option}: {word} is not allowed; allowed: numbers, {allowed}")
        found.append(abs(value))  # -0 is 0
    return tuple(dict.fromkeys(found))


def _modes(given: list[str] | None) -> tuple[str, ...]:
    if given is None:
        return MODES
    words = _words("--modes", given)
    for word in words:
        if word not in MODES:
            raise ConfigError(f"--modes: {word} is unknown; allowed: {', '.join(MODES)}")
    return tuple(mode for mode in MODES if mode in words)


def _rates(
    given: list[str] | None, modes: tuple[str, ...], parameters: ChannelParameters
) -> dict[str, tuple[int, ...]]:
    """The rates of each mode, ascending."""
    if given is None:
        largest = dict(zip(MODES, max_rates(parameters), strict=True))
        return {mode: tuple(range(1, min(_USUAL_RATES, largest[mode]) + 1)) for mode in modes}
    rates: set[int] = set()
    for word in _words("--rates", given):
        span = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", word)
        if span is None:
            raise ConfigError(
                f"--rates: {word} is not allowed; allowed: whole numbers, and ranges such as 1-10"
            )
        low, high = int(span[1]), int(span[2] or span[1])
        if low > high:
            raise ConfigError(f"--rates: {word}: the range must rise, such as 1-10")
        for mode in modes:
            for rate in (low, high):
                try:
                    check_rate(mode, rate, parameters)
                except ConfigError as error:
                    raise ConfigError(f"--rates: {word}: {error}") from error
        rates.update(range(low, high + 1))
    return dict.fromkeys(modes, tuple(sorted(rates)))
