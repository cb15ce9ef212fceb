"""Checks that identities are well formed before they go on the air.

- Serial number: ANSI/CTA-2063-A. Four characters of manufacturer code, one character for the length of the
  rest (1 to 9, A to F for 10 to 15), and the rest. Allowed are digits and capital letters without O and I.
- EU operator number: ASD-STAN EN 4709-002, Implementing Regulation (EU) 2019/947. Country (ISO 3166-1
  alpha-3), 12 lower-case letters and digits, one checksum character; then "-" and three secret characters,
  known only to the operator and the registry. The checksum is Luhn mod 36 over the 12 characters and the
  three secret ones, so it cannot be verified without the secret characters.
- CAA registration: ASTM F3411-22a, capital letters, digits and dots. Hyphens are accepted too.
- UTM-assigned UUID: RFC 9562, 16 bytes.
- Session ID: the first byte is its type, managed by ICAO: 1 a DRIP entity tag (RFC 9374, an IPv6 address of
  2001:30::/28), 2 an IEEE 1609.2 HashedId8.

No error text repeats a secret character, because other people read the logs.
"""

from __future__ import annotations

import re
from typing import Final, Literal

Verdict = Literal["valid", "cannot be verified"]

SERIAL_MAX: Final = 20
PUBLIC_LENGTH: Final = 16
"""Number of characters of an EU operator number that go on the air."""

_SERIAL_ALPHABET: Final = "0123456789ABCDEFGHJKLMNPQRSTUVWXYZ"
_SERIAL_HEAD: Final = 5
_LENGTHS: Final = {character: 1 + at for at, character in enumerate("123456789ABCDEF")}

_BASE_36: Final = "0123456789abcdefghijklmnopqrstuvwxyz"
_COUNTRY: Final = 3
_SECRET: Final = 3
# fmt: off
_EU_STATES: Final = frozenset((
    "AUT", "BEL", "BGR", "CYP", "CZE", "DEU", "DNK", "ESP", "EST", "FIN", "FRA", "GRC", "HRV", "HUN", "IRL",
    "ITA", "LTU", "LUX", "LVA", "MLT", "NLD", "POL", "PRT", "ROU", "SVK", "SVN", "SWE",
    "CHE", "ISL", "LIE", "NOR",
))
# fmt: on
"""Member states of the EU, and the four other states that take part in EASA."""
_NUMBER: Final = re.compile("[0-9A-Za-z]{11,}")
"""Beginning of a text that is meant as an EU operator number, possibly with mistakes."""

ON_AIR_MAX: Final = 20
_REGISTRATION: Final = re.compile("[0-9A-Z.-]+")
_UUID_BYTES: Final = 16
_SESSION_BYTES: Final = {1: 1 + 16, 2: 1 + 8}


def check_serial(text: str) -> None:
    """Check a serial number against ANSI/CTA-2063-A. Raises ValueError naming the wrong character."""
    for at, character in enumerate(text, start=1):
        if at != _SERIAL_HEAD and character not in _SERIAL_ALPHABET:
            raise ValueError(
                f"{text!r}: character {at} is {character!r}; CTA-2063-A allows digits and capital "
                "letters except O and I"
            )
    if len(text) <= _SERIAL_HEAD:
        raise ValueError(
            f"{text!r}: {len(text)} characters; CTA-2063-A requires 6 to {SERIAL_MAX}: four of manufacturer "
            "code, one of length, then the number"
        )
    length = _LENGTHS.get(text[_SERIAL_HEAD - 1])
    if length is None:
        raise ValueError(
            f"{text!r}: character 5 is {text[_SERIAL_HEAD - 1]!r}; by CTA-2063-A it "
            "is the number of characters that follow: 1 to 9, or A to F for 10 to 15"
        )
    if len(text) - _SERIAL_HEAD != length:
        raise ValueError(
            f"{text!r}: character 5, {text[_SERIAL_HEAD - 1]!r}, means by CTA-2063-A that "
            f"{length} characters follow, not {len(text) - _SERIAL_HEAD}"
        )


def check_operator_id_eu(text: str) -> Verdict:
    """Check an EU operator number, complete ("FIN87astrdge12k8-xyz") or without its secret characters.

    Returns:
        "valid" if the checksum is correct, "cannot be verified" if the secret characters are missing.

    Raises:
        ValueError: the number is wrong. The text says what is wrong at which character.
    """
    public = text.partition("-")[0] if "-" in text else text[: max(_COUNTRY, _public_length(len(text)))]
    public = public[:PUBLIC_LENGTH]
    secret = text[len(public) :].removeprefix("-")
    if text[:_COUNTRY] not in _EU_STATES:
        raise ValueError(
            f"{public!r}: characters 1 to 3 are {text[:_COUNTRY]!r}; allowed: the country's three capital "
            "letters (ISO 3166-1), such as FIN, of an EU or EASA state"
        )
    for at, character in enumerate(public[_COUNTRY:], start=_COUNTRY + 1):
        if character not in _BASE_36:
            raise ValueError(
                f"{public!r}: character {at} is {character!r}; allowed: digits and lower-case letters"
            )
    if len(public) < PUBLIC_LENGTH:
        raise ValueError(
            f"{public!r}: {len(text.partition('-')[0])} characters; allowed: {PUBLIC_LENGTH}, then "
            "a hyphen and the three secret ones"
        )
    if text == public:
        return "cannot be verified"
    if len(secret) != _SECRET:
        raise ValueError(f"{public!r}: {len(secret)} secret characters follow; allowed: {_SECRET}")
    if any(character not in _BASE_36 for character in secret):
        raise ValueError(f"{public!r}: the secret characters after it must be digits and lower-case letters")
    if _luhn_36(public[_COUNTRY:-1] + secret) != public[-1]:
        raise ValueError(
            f"{public!r}: the checksum (character {PUBLIC_LENGTH}) does not fit the number and its secret "
            "characters: one of them is mistyped"
        )
    return "valid"


def public_operator_id(text: str) -> str:
    """Return the part of an operator number that may go on the air.

    This is the 16 public characters of an EU number, or the whole text of any other number. If a number
    begins like an EU one, in upper or lower case, everything after its public part is treated as secret, so
    that a mistyped number reveals nothing.
    """
    found = _NUMBER.match(text) if text[:_COUNTRY].upper() in _EU_STATES else None
    if found is None:
        return text
    number = found.group()
    return number if len(number) <= PUBLIC_LENGTH else number[: _public_length(len(number))]


def _public_length(length: int) -> int:
    """Length of the public part of a number without a hyphen; the number may be too short."""
    return length if length == PUBLIC_LENGTH else min(PUBLIC_LENGTH, length - _SECRET)


def check_registration(text: str) -> None:
    """Check a CAA registration against ASTM F3411-22a. Raises ValueError saying what is allowed."""
    if not _REGISTRATION.fullmatch(text):
        raise ValueError(f"{text!r}: a registration holds capital letters, digits, '.' and '-'")


def check_uuid(data: bytes) -> None:
    """Check a UTM-assigned UUID against RFC 9562. Raises ValueError naming the byte."""
    if len(data) != _UUID_BYTES:
        raise ValueError(f"{len(data)} bytes; a UUID has {_UUID_BYTES}")
    if data[8] & 0b1100_0000 != 0b1000_0000:
        raise ValueError(f"byte 9 of the UUID is 0x{data[8]:02x}; RFC 9562 requires 0x80 to 0xbf there")


def check_session(data: bytes) -> list[str]:
    """Check a specific session ID according to its type.

    Returns:
        One sentence for each thing that cannot be verified here.

    Raises:
        ValueError: the ID is wrong. The text names the byte.
    """
    kind = data[0] if data else 0
    if kind == 0:
        raise ValueError("byte 1, the type of session id, is missing or 0, which is reserved")
    length = _SESSION_BYTES.get(kind)
    if length is None:
        return [f"identity.uas_id: session id of type {kind}: its form is unknown and was not verified"]
    if len(data) != length:
        raise ValueError(f"{len(data)} bytes; a session id of type {kind} has {length}")
    if kind == 1 and (data[1:4] != b"\x20\x01\x00" or data[4] & 0xF0 != 0x30):
        raise ValueError(
            f"bytes 2 to 5 are {data[1:5].hex()}; a DRIP entity tag is an address of 2001:30::/28"
        )
    return []


def raw_bytes(text: str) -> bytes:
    """Return the bytes that `BasicId.uas_id` represents. Raises ValueError for a character beyond U+00FF."""
    try:
        return text.encode("latin-1")
    except UnicodeEncodeError as error:
        raise ValueError(
            f"character {error.start + 1} is beyond U+00FF; each character must be one byte"
        ) from None


def is_printable_ascii(text: str) -> bool:
    """Whether every character of a text is printable ASCII."""
    return text.isascii() and text.isprintable()


def _luhn_36(text: str) -> str:
    """Return the check character of Luhn mod 36.

    Every second value from the right is doubled, and its base-36 digits are added.
    """
    total = 0
    for at, character in enumerate(reversed(text)):
        value = _BASE_36.index(character) * (1 if at % 2 else 2)
        total += value // 36 + value % 36
    return _BASE_36[-total % 36]
