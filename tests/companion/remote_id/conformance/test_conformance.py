"""The reference vectors hold, an altered vector is noticed, and the command says so."""

from __future__ import annotations

import argparse
import copy
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.commands import remote_id
from companion.errors import ConfigError
from companion.remote_id.conformance.vectors import check_file, check_vectors

VECTORS = Path(__file__).resolve().parents[3] / "data" / "vectors.json.gz"
Content = dict[str, Any]
KINDS = {
    "basic_id": 58,
    "location": 151,
    "auth": 71,
    "self_id": 61,
    "system": 93,
    "operator_id": 62,
    "message_pack": 59,
    "decode": 81,
    "ble_legacy_adv_data": 20,
    "ble_extended_adv_data": 20,
    "wifi_beacon_frame": 25,
    "wifi_nan_action_frame": 15,
    "wifi_nan_sync_beacon_frame": 15,
}
"""How many vectors of each type the file holds."""


@pytest.fixture(scope="module")
def content() -> Content:
    loaded: Content = json.loads(gzip.decompress(VECTORS.read_bytes()))
    return loaded


def run(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    remote_id.add_arguments(parser.add_subparsers(required=True))
    args = parser.parse_args(arguments)
    status: int = args.run(args)
    return status


def test_every_vector_holds() -> None:
    report = check_file(VECTORS)
    assert report.differences == []
    assert report.checked == KINDS


def one(content: Content, name: str) -> Content:
    """A file of a single vector, free to be altered."""
    group = next(g for g in content["vectors"].values() for v in g if v["id"] == name)
    return {"vectors": {"only": [copy.deepcopy(next(v for v in group if v["id"] == name))]}}


def first(content: Content, group: str, **wanted: Any) -> str:
    """The first vector of a group with these values."""
    vectors = content["vectors"][group]
    name: str = next(v["id"] for v in vectors if all(v.get(key) == value for key, value in wanted.items()))
    return name


def test_every_changed_number_and_bit_is_noticed(content: Content) -> None:
    """One wrong nibble of a vector's bytes, or one wrong decoded value, never passes."""
    missed = []
    groups = ("basic_id", "location", "auth", "self_id", "system", "operator_id")
    for group in groups:
        for kind in ("typical", "edge", "off_grid"):
            for vector in [v for v in content["vectors"][group] if v["kind"] == kind and v["accepted"]][:6]:
                for name, value in vector["decoded"].items():
                    altered = copy.deepcopy(vector)
                    altered["decoded"][name] = value + 1 if not isinstance(value, str) else value + "41"
                    if not check_vectors({"vectors": {"x": [altered]}}).differences:
                        missed.append((vector["id"], name))
                for nibble in range(50):
                    altered = copy.deepcopy(vector)
                    digit = f"{int(vector['hex'][nibble], 16) ^ 1:x}"
                    altered["hex"] = vector["hex"][:nibble] + digit + vector["hex"][nibble + 1 :]
                    if not check_vectors({"vectors": {"x": [altered]}}).differences:
                        missed.append((vector["id"], nibble))
    assert missed == []


def test_every_changed_nibble_of_a_frame_is_noticed(content: Content) -> None:
    missed = []
    for kind in sorted({vector["type"] for vector in content["vectors"]["transport"]}):
        vector = next(v for v in content["vectors"]["transport"] if v["type"] == kind)
        for name in [key for key in ("hex", "message_hex", "pack_hex", "mac") if key in vector]:
            for nibble in range(len(vector[name])):
                altered = copy.deepcopy(vector)
                digit = f"{int(vector[name][nibble], 16) ^ 1:x}"
                altered[name] = vector[name][:nibble] + digit + vector[name][nibble + 1 :]
                if not check_vectors({"vectors": {"x": [altered]}}).differences:
                    missed.append((kind, name, nibble))
    assert missed == []


ALTERATIONS: list[tuple[str, dict[str, Any], Callable[[Content], None]]] = [
    ("location", {"accepted": False}, lambda v: v.update(accepted=True)),
    ("location", {"accepted": True}, lambda v: v.update(accepted=False)),
    ("location", {"kind": "off_grid"}, lambda v: v["input"].update(altitude_geo_m=3000.25)),
    ("location", {"kind": "typical"}, lambda v: v["input"].update(latitude_deg=1.0)),
    ("auth", {"accepted": False}, lambda v: v.update(accepted=True)),
    ("message_pack", {"accepted": False}, lambda v: v.update(accepted=True)),
    ("message_pack", {"accepted": True}, lambda v: v.update(accepted=False)),
    ("message_pack", {"accepted": True}, lambda v: v["messages"].reverse()),
    ("message_pack", {"accepted": True}, lambda v: v["decoded_messages"].pop()),
    ("message_pack", {"accepted": True}, lambda v: v.update(hex=v["hex"][:-2] + "77")),
    ("location", {"kind": "over_limit"}, lambda v: v.update(hex="12" + "00" * 24)),
    (
        "location",
        {"kind": "typical"},
        lambda v: v["input"].update(altitude_geo_m=v["input"]["altitude_geo_m"] + 0.2),
    ),
    (
        "system",
        {"kind": "typical"},
        lambda v: v["input"].update(area_radius_m=v["input"]["area_radius_m"] + 1),
    ),
    ("location", {"kind": "edge"}, lambda v: v["input"].update(direction_deg=0.25)),
    ("message_pack", {"kind": "over_limit"}, lambda v: v.update(hex="f21900")),
    ("message_pack", {"single_message_size": 24}, lambda v: v.update(accepted=True)),
    ("message_pack", {"accepted": True}, lambda v: v.update(hex=None)),
    ("message_pack", {"kind": "over_limit"}, lambda v: v["messages"][0].update(hex="12" + "00" * 24)),
    ("message_pack", {"kind": "over_limit"}, lambda v: v["messages"][0]["input"].update(status=16)),
    ("decode", {"kind": "reject"}, lambda v: v.update(accepted=True)),
    ("decode", {"kind": "reject"}, lambda v: v.update(hex="32" + v["hex"][2:])),
    ("decode", {"kind": "version"}, lambda v: v.update(accepted=False)),
    ("decode", {"kind": "version"}, lambda v: v.update(message_type="system")),
    ("decode", {"kind": "version"}, lambda v: v.update(hex="6" + v["hex"][1:])),
    ("transport", {"type": "ble_legacy_adv_data"}, lambda v: v.update(counter=v["counter"] ^ 1)),
    ("transport", {"type": "ble_extended_adv_data"}, lambda v: v.update(hex=v["hex"][:-2])),
    ("transport", {"type": "wifi_beacon_frame"}, lambda v: v.update(mac="000000000000")),
    ("transport", {"type": "wifi_beacon_frame"}, lambda v: v.update(type="smoke_signal")),
    ("transport", {"type": "wifi_nan_action_frame"}, lambda v: v.update(counter=v["counter"] ^ 1)),
    ("transport", {"type": "wifi_nan_action_frame"}, lambda v: v.update(mac="0000000000")),
    ("transport", {"type": "wifi_nan_sync_beacon_frame"}, lambda v: v.update(mac="000000000000")),
    ("transport", {"type": "wifi_nan_sync_beacon_frame"}, lambda v: v.update(hex=v["hex"][:-2])),
    ("transport", {"type": "wifi_nan_sync_beacon_frame"}, lambda v: v.update(hex=v["hex"][:60])),
]


@pytest.mark.parametrize(("group", "wanted", "alter"), ALTERATIONS)
def test_an_altered_vector_is_noticed(
    content: Content, group: str, wanted: dict[str, Any], alter: Callable[[Content], None]
) -> None:
    name = first(content, group, **wanted)
    altered = one(content, name)
    assert check_vectors(altered).differences == []
    alter(altered["vectors"]["only"][0])
    differences = check_vectors(altered).differences
    assert differences
    assert all(line.startswith(f"{name}: ") for line in differences)


@pytest.mark.parametrize("change", [lambda text: "f1" + text[2:], lambda text: text + "00"])
def test_a_pack_that_would_be_sent_otherwise_is_noticed(
    content: Content, change: Callable[[str], str]
) -> None:
    """Another version in its header, or a byte more behind it."""
    altered = one(content, first(content, "message_pack", accepted=True))
    vector = altered["vectors"]["only"][0]
    vector["hex"] = change(vector["hex"])
    assert any(": encoded as" in line for line in check_vectors(altered).differences)


@pytest.mark.parametrize(
    ("group", "wanted", "alter", "words"),
    [
        ("basic_id", {"kind": "typical"}, lambda v: v.pop("type"), "'type'"),
        ("basic_id", {"kind": "edge"}, lambda v: v["input"].update(uas_id="X"), "'uas_id'"),
        ("message_pack", {"accepted": True}, lambda v: v["messages"][0].pop("input"), "expected"),
        ("message_pack", {"accepted": True}, lambda v: v.pop("hex"), "'hex'"),
        (
            "decode",
            {"note": "random location bytes, reserved bits included"},
            lambda v: v["decoded"].pop("longitude_deg"),  # its latitude is 111 degrees
            "'longitude_deg'",
        ),
    ],
)
def test_a_vector_that_lacks_a_part_is_named(
    content: Content, group: str, wanted: dict[str, Any], alter: Callable[[Content], object], words: str
) -> None:
    name = first(content, group, **wanted)
    altered = one(content, name)
    alter(altered["vectors"]["only"][0])
    with pytest.raises(ConfigError, match=f"vector {name}: .*{words}"):
        check_vectors(altered)


def test_a_vector_without_a_name_is_found_by_its_place(content: Content) -> None:
    nameless = one(content, "auth-000")
    nameless["vectors"]["only"].append({"type": "auth"})
    with pytest.raises(ConfigError, match="vector 1 of 'only': field 'id'"):
        check_vectors(nameless)


def test_hexadecimal_may_be_in_capitals(content: Content) -> None:
    def capitals(value: Any, name: str = "") -> Any:
        if isinstance(value, dict):
            return {key: capitals(item, key) for key, item in value.items()}
        if isinstance(value, list):
            return [capitals(item, name) for item in value]
        return value.upper() if isinstance(value, str) and (name.endswith("hex") or name == "mac") else value

    assert check_vectors(capitals(content)).differences == []


def test_an_unsound_authentication_page_is_left_out_of_a_pack_as_in_the_reference() -> None:
    text = bytes((0x32, 1)) + b"survey".ljust(23, b"\0")
    page = bytes((0x22, 0x10, 16)) + bytes(22)
    decoded = [{"type": "self_id", "fields": {"description_type": 1, "description": "survey"}}]

    def differences(*parts: bytes, size: int = 25) -> list[str]:
        pack = bytes((0xF2, size, len(parts))) + b"".join(parts)
        vector = {"id": "a", "type": "decode", "accepted": True, "hex": pack.hex()}
        told = decoded if text in parts else []
        return check_vectors({"vectors": {"x": [{**vector, "decoded_messages": told}]}}).differences

    assert differences(page, text) == differences(text, page, page) == differences(page) == []
    assert differences(text, page, size=24)
    assert differences(text, *[page] * 9)
    assert differences(text, text, page)


def test_off_the_grid_one_step_is_allowed_and_two_are_not(content: Content) -> None:
    file = one(content, first(content, "location", kind="off_grid"))
    vector = file["vectors"]["only"][0]
    start = vector["decoded"]["altitude_geo_m"]
    for off, differs in ((0.0, False), (0.5, False), (1.0, True), (-1.0, True)):
        vector["input"]["altitude_geo_m"] = start + off
        assert bool(check_vectors(file).differences) is differs
    vector["input"]["altitude_geo_m"] = start + 0.5
    vector["on_grid"] = True
    assert check_vectors(file).differences


@pytest.mark.parametrize(
    "content",
    [
        [],
        {},
        {"vectors": []},
        {"vectors": {}},
        {"vectors": {"location": 3}},
        {"vectors": {"location": [3]}},
        {"vectors": {"location": [{"id": "a"}]}},
        {"vectors": {"location": [{"id": "a", "type": "location"}]}},
        {"vectors": {"location": [{"id": "a", "type": "location", "accepted": True, "input": {}}]}},
        {"vectors": {"decode": [{"id": "a", "type": "decode", "accepted": True, "hex": "xx"}]}},
        {"vectors": {"decode": [{"id": "a", "type": "decode", "accepted": "yes", "hex": "12"}]}},
    ],
)
def test_what_is_no_vector_file_is_refused(content: object) -> None:
    with pytest.raises(ConfigError):
        check_vectors(content)


def test_check_exits_by_what_it_found(
    tmp_path: Path, content: Content, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", str(VECTORS)) == 0
    assert "731 vectors checked" in capsys.readouterr().out

    name = first(content, "system", kind="typical")
    altered = one(content, name)
    altered["vectors"]["only"][0]["decoded"]["area_count"] += 1
    file = tmp_path / "altered.json"
    file.write_text(json.dumps(altered))
    assert run("check", str(file)) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{name}: ")
    assert "area_count" in lines[0]

    huge = json.dumps(altered).replace('"area_count": ', '"area_count": ' + "9" * 400)
    for text in ("", "{", "[1]", '{"vectors": {}}', huge):
        file.write_text(text)
        assert run("check", str(file)) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
    torn = tmp_path / "torn.json.gz"
    torn.write_bytes(VECTORS.read_bytes()[:5000])
    for path in (torn, tmp_path, tmp_path / "absent.json"):
        assert run("check", str(path)) == 2


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_check_names_a_damaged_vector_of_every_type(
    kind: str, tmp_path: Path, content: Content, capsys: pytest.CaptureFixture[str]
) -> None:
    """Among all the others, the one whose bytes differ in one bit."""
    altered = copy.deepcopy(content)
    vectors = [v for group in altered["vectors"].values() for v in group]
    vector = next(v for v in vectors if v["type"] == kind and v.get("hex") and v.get("accepted", True))
    vector["hex"] = vector["hex"][:8] + f"{int(vector['hex'][8], 16) ^ 1:x}" + vector["hex"][9:]
    file = tmp_path / "damaged.json"
    file.write_text(json.dumps(altered))
    assert run("check", str(file)) == 1
    *differences, summary = capsys.readouterr().out.splitlines()
    assert differences
    assert {line.split(":")[0] for line in differences} == {vector["id"]}
    assert "731 vectors checked" in summary
    assert f"{len(differences)} differences" in summary
