"""Serial numbers, operator numbers and session ids: every wrong one is refused, and no secret gets out."""

from __future__ import annotations

import contextlib
import re
import string
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import IdentityConfig, RemoteIdConfig, check_identity
from companion.remote_id.identity import check_operator_id_eu, check_serial, public_operator_id
from companion.remote_id.messages import IdType
from companion.remote_id.region import Region

SERIAL = "1596B0000DMUCA01"
WHOLE = "FIN87astrdge12k8-xyz"
PUBLISHED = [WHOLE, "BGRpxs4wvrvpbp63-duz"]
"""Examples of EASA and of the Bulgarian civil aviation authority."""
SERIAL_ALPHABET = "0123456789ABCDEFGHJKLMNPQRSTUVWXYZ"
BASE_36 = string.digits + string.ascii_lowercase
EU = Region(
    name="eu",
    serial_number="cta-2063-a",
    operator_id="eu",
    operator_id_required=True,
    basic_id_period_s=3.0,
)

stable = settings(derandomize=True, deadline=None)


@st.composite
def serials(draw: st.DrawFn) -> str:
    code = draw(st.text(SERIAL_ALPHABET, min_size=4, max_size=4))
    number = draw(st.text(SERIAL_ALPHABET, min_size=1, max_size=15))
    return code + "123456789ABCDEF"[len(number) - 1] + number


# ---------------------------------------------------------------- serial numbers


@pytest.mark.parametrize("text", [SERIAL, "1581F6N8A23B2ML3Y3KR", "MFR1C123456789ABC", "ABCD1X"])
def test_a_serial_number_by_cta_2063_a_is_taken(text: str) -> None:
    check_serial(text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "0 characters"),
        ("1596B", "5 characters"),
        ("15", "2 characters"),
        ("1596b0000DMUCA01", "character 5 is 'b'"),
        ("159 B0000DMUCA01", "character 4 is ' '"),
        ("O596B0000DMUCA01", "character 1 is 'O'"),
        ("1596B0000DMUCAI1", "character 15 is 'I'"),
        ("1596B0000DMUCa01", "character 14 is 'a'"),
        ("1596B0000DMUCÄ01", "character 14 is 'Ä'"),
        ("15960", "5 characters"),
        ("159600", "character 5 is '0'; by CTA-2063-A it is"),
        ("1596G0000DMUCA01", "character 5 is 'G'"),
        ("1596A0000DMUCA01", "character 5, 'A', means by CTA-2063-A that 10 characters follow, not 11"),
        ("1596F0000DMUCA01", "15 characters follow, not 11"),
        ("1596F0000DMUCA0123456", "15 characters follow, not 16"),
    ],
)
def test_a_wrong_serial_number_is_refused_where_it_is_wrong(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        check_serial(text)


@given(serials())
@stable
def test_every_serial_number_that_keeps_the_rule_is_taken(text: str) -> None:
    check_serial(text)
    assert len(text) <= 20


@given(serials(), st.data())
@stable
def test_a_serial_number_of_any_other_length_or_character_is_refused(text: str, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(text) - 1))
    with pytest.raises(ValueError):
        check_serial(text[:cut])
    with pytest.raises(ValueError):
        check_serial(text + data.draw(st.text(SERIAL_ALPHABET, min_size=1)))
    at = data.draw(st.integers(0, len(text) - 1))
    wrong = data.draw(st.characters().filter(lambda c: c not in SERIAL_ALPHABET))
    with pytest.raises(ValueError):
        check_serial(text[:at] + wrong + text[at + 1 :])


@given(st.text(max_size=30))
@stable
def test_any_text_is_taken_or_refused_by_value_error(text: str) -> None:
    for check in (check_serial, check_operator_id_eu):
        with contextlib.suppress(ValueError):
            check(text)


# ---------------------------------------------------------------- EU operator numbers


@pytest.mark.parametrize("text", PUBLISHED)
def test_published_operator_numbers_are_valid(text: str) -> None:
    assert check_operator_id_eu(text) == "valid"
    assert check_operator_id_eu(text.replace("-", "")) == "valid"
    assert check_operator_id_eu(text[:16]) == "cannot be verified"
    assert public_operator_id(text) == text[:16]


@pytest.mark.parametrize("text", PUBLISHED)
def test_any_one_wrong_character_is_caught(text: str) -> None:
    for at in [*range(3, 16), *range(17, 20)]:
        for other in set(BASE_36) - {text[at]}:
            with pytest.raises(ValueError, match="checksum"):
                check_operator_id_eu(text[:at] + other + text[at + 1 :])


@given(st.text(BASE_36, min_size=12, max_size=12), st.text(BASE_36, min_size=3, max_size=3))
@stable
def test_one_checksum_character_fits_and_no_other(number: str, secret: str) -> None:
    fitting = []
    for checksum in BASE_36:
        try:
            fitting.append(check_operator_id_eu(f"DEU{number}{checksum}-{secret}"))
        except ValueError:
            continue
    assert fitting == ["valid"]


@given(st.sampled_from(PUBLISHED), st.integers(0, 19), st.characters().filter(lambda c: c not in BASE_36))
@stable
def test_any_other_character_is_refused(text: str, at: int, wrong: str) -> None:
    if wrong == text[at]:
        return
    with pytest.raises(ValueError):
        check_operator_id_eu(text[:at] + wrong + text[at + 1 :])


@pytest.mark.parametrize("length", [n for n in range(20) if n != 16])
def test_any_other_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError):
        check_operator_id_eu(WHOLE[:length])
    with pytest.raises(ValueError):
        check_operator_id_eu(WHOLE + "a" * (length + 1))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("USA87astrdge12k8-xyz", "characters 1 to 3 are 'USA'"),
        ("fin87astrdge12k8-xyz", "characters 1 to 3 are 'fin'"),
        ("FIN87aStrdge12k8-xyz", "character 7 is 'S'"),
        ("FIN87astrdge12", "14 characters; allowed: 16"),
        ("FIN87astrdge12k8-", "0 secret characters"),
        ("FIN87astrdge12k8-xy", "2 secret characters"),
        ("FIN87astrdge12k8-XYZ", "digits and lower-case letters"),
        ("FIN87astrdge12k9-xyz", "does not fit"),
    ],
)
def test_a_wrong_operator_number_is_refused_in_words(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        check_operator_id_eu(text)


@pytest.mark.parametrize("secrets", [("abc", "9q0"), ("ABC", "QU-"), ("a", "7"), ("", ""), ("abcd", "ABCD")])
@pytest.mark.parametrize("number", ["FIN87astrdge12k8-", "FIN87astrdge12-", "FRANCE-"])
def test_no_error_text_depends_on_the_secret(number: str, secrets: tuple[str, str]) -> None:
    texts = set()
    for secret in secrets:
        with pytest.raises(ValueError) as refusal:
            check_operator_id_eu(number + secret)
        texts.add(str(refusal.value))
    assert len(texts) == 1


@pytest.mark.parametrize("number", ["FIN", "FIN87astrdge", "FIN87astrdge12", "FIN87astrdge12k"])
def test_no_error_text_holds_the_secret_of_a_short_number_without_a_hyphen(number: str) -> None:
    texts = set()
    for secret in ("abc", "9q0", "XYZ"):
        with pytest.raises(ValueError) as refusal:
            check_operator_id_eu(number + secret)
        texts.add(str(refusal.value))
    assert len(texts) == 1


@pytest.mark.parametrize(
    ("text", "public"),
    [
        (WHOLE, "FIN87astrdge12k8"),
        ("FIN87astrdge12k8xyz", "FIN87astrdge12k8"),
        ("FIN87astrdge12k8", "FIN87astrdge12k8"),
        ("fin87astrdge12k8-xyz", "fin87astrdge12k8"),
        ("FIN87ASTRDGE12K8-XYZ", "FIN87ASTRDGE12K8"),
        ("FIN87astrdge12k8-xy", "FIN87astrdge12k8"),
        ("FIN87astrdge12k8-xyz9", "FIN87astrdge12k8"),
        ("FIN87astrdge12-xyz", "FIN87astrdge12"),
        ("FIN87astrdge12k8 xyz", "FIN87astrdge12k8"),
        ("FIN87astrdge12k8_xyz", "FIN87astrdge12k8"),
        ("FIN87astrdge12kxyz", "FIN87astrdge12k"),
        ("FIN87astrdge12xyz", "FIN87astrdge12"),
        ("FIN87astrdge12k8wxyz", "FIN87astrdge12k8"),
        ("FRA-RP-123456789012", "FRA-RP-123456789012"),
        ("GBR-OP-123ABCD", "GBR-OP-123ABCD"),
        ("FA3PILOT123", "FA3PILOT123"),
        ("USA1234567890123-456", "USA1234567890123-456"),
        ("", ""),
    ],
)
def test_only_the_public_part_goes_on_the_air(text: str, public: str) -> None:
    assert public_operator_id(text) == public
    assert public_operator_id(public) == public


# ---------------------------------------------------------------- a configuration


def notes(region: Region = EU, operator_id: str | None = WHOLE, **identity: Any) -> list[str]:
    return check_identity(
        IdentityConfig(**({"uas_id": SERIAL} | identity)), RemoteIdConfig(operator_id=operator_id), region
    )


def test_a_sound_identity_needs_no_words() -> None:
    assert notes() == []
    assert notes(Region(), None) == []


def test_what_cannot_be_verified_is_said() -> None:
    (note,) = notes(operator_id=WHOLE[:16])
    assert note.startswith("remote_id.operator_id: 'FIN87astrdge12k8' cannot be verified")
    (note,) = notes(operator_id=None)
    assert note.startswith("remote_id.operator_id: not set")
    (note,) = notes(Region(), None, uas_id="DRONE1")
    assert note.startswith("identity.uas_id: 'DRONE1': character 3 is 'O'")
    assert note.endswith("without a region it is sent as it is")
    (note,) = notes(uas_id="\x07abc", id_type=IdType.SPECIFIC_SESSION)
    assert note.startswith("identity.uas_id: session id of type 7")


DET = bytes.fromhex("01 2001 0030 0000 0000 0000 0000 0000 0001").decode("latin-1")
UUID = bytes.fromhex("123e4567e89b12d3a456426614174000").decode("latin-1")


@pytest.mark.parametrize(
    ("id_type", "uas_id"),
    [
        (IdType.SPECIFIC_SESSION, DET),
        (IdType.SPECIFIC_SESSION, "\x0212345678"),
        (IdType.UTM_ASSIGNED_UUID, UUID),
        (IdType.CAA_REGISTRATION, "HB.1A2B3C"),
        (IdType.CAA_REGISTRATION, "JU322627C69E"),
    ],
)
def test_every_kind_of_identity_can_be_sound(id_type: IdType, uas_id: str) -> None:
    assert notes(id_type=id_type, uas_id=uas_id) == []


@pytest.mark.parametrize(
    ("identity", "says"),
    [
        ({"uas_id": "A1"}, "identity.uas_id: 'A1': 2 characters"),
        ({"uas_id": "", "id_type": IdType.SPECIFIC_SESSION}, "identity.uas_id: byte 1"),
        ({"uas_id": "A1", "id_type": IdType.NONE}, "identity.id_type: 0"),
        ({"uas_id": "A1", "id_type": IdType(9)}, "identity.id_type: 9: allowed: 0 to 4"),
        (
            {"region": Region(), "uas_id": "Ä", "id_type": IdType.NONE},
            "identity.uas_id: 'Ä': allowed: printable ASCII",
        ),
        ({"uas_id": "hb.1", "id_type": IdType.CAA_REGISTRATION}, "identity.uas_id: 'hb.1'"),
        ({"registration_id": "ju3"}, "identity.registration_id: 'ju3'"),
        ({"uas_id": UUID[:15], "id_type": IdType.UTM_ASSIGNED_UUID}, "15 bytes; a UUID has 16"),
        ({"uas_id": "x" * 16, "id_type": IdType.UTM_ASSIGNED_UUID}, "byte 9 of the UUID is 0x78"),
        ({"uas_id": "Ж" * 16, "id_type": IdType.UTM_ASSIGNED_UUID}, "character 1 is beyond U+00FF"),
        ({"uas_id": "\0" + UUID, "id_type": IdType.SPECIFIC_SESSION}, "byte 1, the type of session id"),
        ({"uas_id": DET[:16], "id_type": IdType.SPECIFIC_SESSION}, "16 bytes; a session id of type 1 has 17"),
        ({"uas_id": "\x01" + UUID, "id_type": IdType.SPECIFIC_SESSION}, "bytes 2 to 5 are 123e4567"),
        ({"operator_id": "FIN87astrdge12k9-xyz"}, "remote_id.operator_id: 'FIN87astrdge12k9'"),
        (
            {"region": Region(), "operator_id": "x" * 21},
            "remote_id.operator_id: 21 characters; allowed: up to 20",
        ),
        ({"region": Region(), "operator_id": "Jörg"}, "remote_id.operator_id: 'Jörg': allowed: printable"),
    ],
)
def test_a_wrong_identity_is_refused_by_its_key(identity: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=re.escape(says)):
        notes(**identity)


def test_a_text_about_the_flight_must_be_sendable() -> None:
    with pytest.raises(ValueError, match=re.escape("remote_id.self_id: 'Übung': allowed: printable ASCII")):
        check_identity(IdentityConfig(uas_id="A1"), RemoteIdConfig(self_id="Übung"), Region())
