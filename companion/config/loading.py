"""Reads a configuration file with the files that it names, and writes it again."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import msgspec
import tomli_w

from companion.config.checks import check
from companion.config.legs import level
from companion.config.sections import Config, IdentityConfig, SigningConfig, TrajectoryFile, names_file
from companion.errors import ConfigError, PeerDataError
from companion.geofence import load_fence
from companion.remote_id.drip.keys import public_key_hex
from companion.remote_id.drip.link import decode_endorsement
from companion.remote_id.identity import public_operator_id
from companion.remote_id.messages import IdType
from companion.remote_id.region import Region
from companion.shipped import named, names
from companion.toml_reader import decode_toml, without_none

T = TypeVar("T")

_RAW_IDS = (IdType.UTM_ASSIGNED_UUID, IdType.SPECIFIC_SESSION)
_KEY_DIGITS = re.compile("[0-9A-Fa-f]{64}")
_LINK_DIGITS = re.compile("[0-9A-Fa-f]{272}")


def load(path: Path) -> Config:
    """Read, check and resolve a configuration file.

    Raises:
        ConfigError: names the file, the key, what it holds and what is allowed.
    """
    config = decode_toml(path, Config)
    # systemd and the container name the folder in which the service may write.
    state = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    folder = str((Path(state or path.parent) / config.record.folder).absolute())
    config = msgspec.structs.replace(config, record=msgspec.structs.replace(config.record, folder=folder))
    if config.identity.id_type in _RAW_IDS:
        config = msgspec.structs.replace(config, identity=_raw_identity(config.identity, path))
    trajectory = config.flight.trajectory
    if config.path is not None:
        _check_times(config.path, f"{path}: path")
        config = msgspec.structs.replace(config, path=level(config.path))
    elif trajectory is not None and trajectory != "mission":
        config = msgspec.structs.replace(
            config, path=_beside(path, "flight.trajectory", trajectory, load_trajectory)
        )
    fence = config.limits.fence
    if fence is not None and fence != "vehicle" and not config.fence:
        config = msgspec.structs.replace(config, fence=_beside(path, "limits.fence", fence, load_fence))
    if config.remote_id.region is not None:
        config = _with_region(config, config.remote_id.region, path)
    if config.atmc.policy is not None and names_file(config.atmc.policy):
        # Not read here: a policy that cannot be read is no configuration error, the companion then flies with
        # a fixed set of transports.
        where = str(named(config.atmc.policy, "policies", ".safetensors", path.parent).absolute())
        config = msgspec.structs.replace(config, atmc=msgspec.structs.replace(config.atmc, policy=where))
    if config.vehicle.signing_key is not None:
        if _KEY_DIGITS.fullmatch(config.vehicle.signing_key):
            raise ConfigError(
                f"{path}: vehicle.signing_key: this is a key; write it to a file that only you can read, "
                "and give the path of that file here"
            )
        # Not read here: only the link may hold the key, and no record may contain it.
        where = str((path.parent / config.vehicle.signing_key).absolute())
        config = msgspec.structs.replace(
            config, vehicle=msgspec.structs.replace(config.vehicle, signing_key=where)
        )
    if config.remote_id.signing is not None:
        remote_id = msgspec.structs.replace(
            config.remote_id, signing=_signing(config.remote_id.signing, path)
        )
        config = msgspec.structs.replace(config, remote_id=remote_id)
    if config.traffic.keys or config.traffic.anchors:
        traffic = msgspec.structs.replace(
            config.traffic,
            keys={k: _public_key(text, f'keys."{k}"', path) for k, text in config.traffic.keys.items()},
            anchors={
                k: _public_key(text, f'anchors."{k}"', path) for k, text in config.traffic.anchors.items()
            },
        )
        config = msgspec.structs.replace(config, traffic=traffic)
    check(config, str(path))
    return config


def _with_region(config: Config, profile: str, path: Path) -> Config:
    """The configuration with the region's profile, which the file gives by its name or by a relative path."""
    try:
        region = decode_toml(named(profile, "regions", ".toml", path.parent), Region)
    except ConfigError as error:
        if isinstance(error.__cause__, FileNotFoundError | IsADirectoryError):
            raise ConfigError(
                f"{path}: remote_id.region: {profile!r}: no such profile; allowed: the path of a profile "
                f"relative to {path.name}, or one of {', '.join(names('regions', '.toml'))}"
            ) from error
        raise ConfigError(f"{path}: remote_id.region: {error}") from error
    remote_id = msgspec.structs.replace(config.remote_id, region=None)
    return msgspec.structs.replace(config, remote_id=remote_id, region=region)


def _raw_identity(identity: IdentityConfig, path: Path) -> IdentityConfig:
    try:
        raw = bytes.fromhex(identity.uas_id.replace("-", "")).decode("latin-1")
    except ValueError as error:
        raise ConfigError(
            f"{path}: identity.uas_id: {identity.uas_id!r}: with id_type {int(identity.id_type)} it must "
            "be hexadecimal digits, two for each byte, such as 123e4567-e89b-42d3-a456-426614174000"
        ) from error
    return msgspec.structs.replace(identity, uas_id=raw)


def _public_key(text: str, key: str, path: Path) -> str:
    try:
        return public_key_hex(text, path.parent)
    except ConfigError as error:
        raise ConfigError(f"{path}: traffic.{key}: {error}") from error


def _signing(signing: SigningConfig, path: Path) -> SigningConfig:
    """The signing section with its links read and the path of its key made absolute. The key is not read."""
    links = []
    for number, text in enumerate(signing.links):
        try:
            digits = text if _LINK_DIGITS.fullmatch(text) else (path.parent / text).read_text("ascii").strip()
            links.append(decode_endorsement(bytes.fromhex(digits)).encode().hex())
        except (OSError, ValueError, PeerDataError) as error:
            raise ConfigError(
                f"{path}: remote_id.signing.links[{number}]: {text!r}: neither the 272 hex digits of an "
                f"endorsement nor a file with them: {error}"
            ) from error
    where = str((path.parent / signing.key).absolute())
    return msgspec.structs.replace(signing, key=where, links=tuple(links))


def _beside(path: Path, key: str, file: str, read: Callable[[Path], T]) -> T:
    """Read a file that a key of the configuration at `path` names. Errors also name that key."""
    try:
        return read(path.parent / file)
    except ConfigError as error:
        raise ConfigError(f"{path}: {key}: {error}") from error


def load_trajectory(path: Path) -> TrajectoryFile:
    """Read and check a trajectory file.

    Raises:
        ConfigError: names the file and the waypoint.
    """
    trajectory = decode_toml(path, TrajectoryFile)
    _check_times(trajectory, str(path))
    return level(trajectory)


def _check_times(trajectory: TrajectoryFile, name: str) -> None:
    for number, (a, b) in enumerate(itertools.pairwise(trajectory.waypoint), start=1):
        if b.t_s <= a.t_s:
            raise ConfigError(
                f"{name}: waypoint[{number}].t_s: {b.t_s:g} s is not after the one before it ({a.t_s:g} s)"
            )


def public(config: Config) -> Config:
    """The configuration as it may be recorded: without the secret characters of the operator ID."""
    secret = config.remote_id.operator_id
    if secret is None:
        return config
    remote_id = msgspec.structs.replace(config.remote_id, operator_id=public_operator_id(secret))
    return msgspec.structs.replace(config, remote_id=remote_id)


def dump(config: Config) -> bytes:
    """The public configuration as TOML that needs no other trajectory, fence or region file; `load` reads it
    back."""
    plain = without_none(msgspec.to_builtins(public(config)))
    if config.identity.id_type in _RAW_IDS:
        plain["identity"]["uas_id"] = config.identity.uas_id.encode("latin-1").hex()
    return tomli_w.dumps(plain).encode()
