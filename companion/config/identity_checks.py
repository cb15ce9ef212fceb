"""Checks of the configured identities, as required by the region and the type of identity."""

from __future__ import annotations

from companion.config.sections import IdentityConfig, RemoteIdConfig
from companion.remote_id.identity import (
    ON_AIR_MAX,
    check_operator_id_eu,
    check_registration,
    check_serial,
    check_session,
    check_uuid,
    is_printable_ascii,
    public_operator_id,
    raw_bytes,
)
from companion.remote_id.messages import IdType
from companion.remote_id.region import Region


def check_identity(identity: IdentityConfig, remote_id: RemoteIdConfig, region: Region) -> list[str]:
    """Check UAS ID, registration, operator ID and Self ID for the region and the type of identity.

    Returns:
        What cannot be verified here: one sentence each, beginning with the configuration key.

    Raises:
        ValueError: names the configuration key, what is wrong and what is allowed.
    """
    notes: list[str] = []
    if identity.id_type > IdType.SPECIFIC_SESSION:
        raise ValueError(f"identity.id_type: {int(identity.id_type)}: allowed: 0 to 4")
    if identity.id_type is IdType.NONE and region.basic_id_period_s is not None:
        raise ValueError(f"identity.id_type: 0 means no identity; region {region.name!r} requires one")
    try:
        notes += _check_uas_id(identity, region)
    except ValueError as error:
        raise ValueError(f"identity.uas_id: {error}") from None
    if identity.registration_id is not None:
        try:
            check_registration(identity.registration_id)
        except ValueError as error:
            raise ValueError(f"identity.registration_id: {error}") from None
    try:
        notes += _check_operator_id(remote_id.operator_id, region)
    except ValueError as error:
        raise ValueError(f"remote_id.operator_id: {error}") from None
    if remote_id.self_id is not None and not is_printable_ascii(remote_id.self_id):
        raise ValueError(f"remote_id.self_id: {remote_id.self_id!r}: allowed: printable ASCII")
    return notes


def _check_uas_id(identity: IdentityConfig, region: Region) -> list[str]:
    text = identity.uas_id
    if len(text) > ON_AIR_MAX:
        raise ValueError(f"{text!r}: {len(text)} characters; allowed: up to {ON_AIR_MAX}")
    match identity.id_type:
        case IdType.UTM_ASSIGNED_UUID:
            check_uuid(raw_bytes(text))
        case IdType.SPECIFIC_SESSION:
            return check_session(raw_bytes(text))
        case IdType.SERIAL_NUMBER if region.serial_number == "cta-2063-a":
            check_serial(text)
        case IdType.CAA_REGISTRATION:
            check_registration(text)
        case _ if not is_printable_ascii(text):
            raise ValueError(f"{text!r}: allowed: printable ASCII, up to {ON_AIR_MAX} characters")
    if identity.id_type is IdType.SERIAL_NUMBER and region.serial_number == "any":
        try:
            check_serial(text)
        except ValueError as error:
            return [f"identity.uas_id: {error}; without a region it is sent as it is"]
    return []


def _check_operator_id(text: str | None, region: Region) -> list[str]:
    if text is None:
        if region.operator_id_required:
            return [
                f"remote_id.operator_id: not set; region {region.name!r} requires it, so the ground station "
                "must send it"
            ]
        return []
    if region.operator_id == "eu":
        if check_operator_id_eu(text) == "valid":
            return []
        return [
            f"remote_id.operator_id: {text!r} cannot be verified without its three secret characters: "
            f"append them as in {text}-xyz (they are never sent)"
        ]
    public = public_operator_id(text)
    if not is_printable_ascii(public):
        raise ValueError(f"{public!r}: allowed: printable ASCII")
    if len(public) > ON_AIR_MAX:
        raise ValueError(f"{len(public)} characters; allowed: up to {ON_AIR_MAX}")
    return []
