"""The command by hand: messages, frames and captures, back and forth; what is wrong is named."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from companion.commands.remote_id import message_json
from companion.remote_id.frames import build_nan_sync_beacon
from tests.companion.remote_id.conftest import Terminal

ADDRESS = "02:00:5e:10:20:30"
MESSAGE = '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}'
HEX = "520046494e38376173747264676531326b3800000000000000"


def test_encode_and_decode_are_each_others_inverse(terminal: Terminal) -> None:
    assert terminal.run("encode", stdin=f"{MESSAGE}\n\n") == 0
    assert terminal.out == [HEX]
    assert terminal.run("decode", stdin=f"{HEX}\n") == 0
    assert terminal.out == [MESSAGE]
    assert terminal.run("encode", "--pack", stdin=MESSAGE) == 0
    assert terminal.out == [f"f21901{HEX}"]


def test_every_example_of_the_help_is_encoded_and_comes_back(
    terminal: Terminal, capsys: pytest.CaptureFixture[str]
) -> None:
    examples = "\n".join(message_json.EXAMPLES)
    assert terminal.run("encode", stdin=examples) == 0
    assert [line[0] for line in terminal.out] == list("012345")
    encoded = terminal.out
    assert terminal.run("decode", stdin="\n".join(encoded)) == 0
    assert [json.loads(line)["type"] for line in terminal.out] == [
        json.loads(example)["type"] for example in message_json.EXAMPLES
    ]
    assert terminal.run("encode", stdin="\n".join(terminal.out)) == 0
    assert terminal.out == encoded
    with pytest.raises(SystemExit) as stop:
        terminal.run("encode", "--help")
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    assert all(example in shown for example in message_json.EXAMPLES)


@pytest.mark.parametrize("id_type", [3, 4])
def test_an_id_of_any_bytes_comes_back(terminal: Terminal, id_type: int) -> None:
    for start in range(0, 256, 20):
        raw = bytes(n % 256 for n in range(start, start + 20))
        message = f"02{id_type}2{raw.hex()}000000"
        assert terminal.run("decode", stdin=message) == 0
        (line,) = terminal.out
        assert line.isascii()
        assert terminal.run("encode", stdin=line) == 0
        assert terminal.out == [message]


def test_json_may_hold_its_characters_unescaped(terminal: Terminal) -> None:
    for text in ("é", "\\u00e9"):
        assert terminal.run("encode", stdin=f'{{"type":"SelfId","description_type":0,"text":"{text}"}}') == 0
        assert terminal.out == [f"3200e9{'00' * 22}"]


@pytest.mark.parametrize(
    ("action", "line"),
    [
        ("decode", "zz"),
        ("decode", "6200"),
        ("decode", "f21900"),
        ("decode", "00"),
        ("encode", "{"),
        ("encode", '{"a":' + "[" * 100_000),
        ("encode", '{"type":"Location","lat_deg":95.0,"lon_deg":0.0}'),
        ("encode", '{"type":"Location","latt_deg":9.0}'),
        ("encode", '{"type":"SelfId","description_type":0,"text":"漢"}'),
        ("encode", '{"type":"SelfId","description_type":1' + "0" * 400 + ',"text":""}'),
    ],
)
def test_a_bad_line_is_named_and_the_rest_goes_on(terminal: Terminal, action: str, line: str) -> None:
    good = HEX if action == "decode" else MESSAGE
    assert terminal.run(action, stdin=f"{line}\n{good}\n") == 1
    assert terminal.err[0].startswith("line 1: ")
    assert len(terminal.out) == 1


def test_of_a_torn_pack_the_sound_messages_are_printed_and_the_fault_told(terminal: Terminal) -> None:
    assert terminal.run("decode", stdin=f"f21902{HEX}{HEX[:10]}\n{HEX}") == 1
    assert terminal.out == [MESSAGE, MESSAGE]
    assert len(terminal.err) == 1
    assert terminal.err[0].startswith("line 1: ")
    assert "cut short" in terminal.err[0]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "not JSON: incomplete"),
        ("{'type':1}", "not JSON: object keys must be strings (byte 1)"),
        ("[]", f"[] is not a message; allowed: an object such as {message_json.EXAMPLES[3]}"),
        ('{"a":1}', "type: missing; allowed: BasicId, Location, Authentication, SelfId, System, OperatorId"),
        (
            '{"type":"Nope"}',
            'type: "Nope"; allowed: BasicId, Location, Authentication, SelfId, System, OperatorId',
        ),
        (
            '{"type":"OperatorId","foo":1}',
            'OperatorId: unknown key "foo"; allowed: operator_id_type, operator_id',
        ),
        (
            '{"type":"OperatorId","operator_id":"A"}',
            "OperatorId.operator_id_type: missing; allowed: a whole number",
        ),
        ('{"type":"Location","lat_deg":"x"}', 'Location.lat_deg: "x"; allowed: a number or null'),
        ('{"type":"Location","lat_deg":1e999}', "a number is too large"),
        (
            '{"type":"Location","height_type":2}',
            "Location.height_type: 2; allowed: 0 above takeoff, 1 above ground",
        ),
        (
            '{"type":"Authentication","auth_type":1,"page":0,"data":"%s"}' % ("#" * 99),
            f'Authentication.data: "{"#" * 39}...; allowed: base64 text',
        ),
        ('{"type":"Location","lat_deg":100}', "Location.lat_deg is 100; allowed: -90 to 90 degrees"),
        ('{"type":"Location","lon_deg":-181}', "Location.lon_deg is -181; allowed: -180 to 180 degrees"),
        (
            '{"type":"System","operator_lat_deg":91}',
            "System.operator_lat_deg is 91; allowed: -90 to 90 degrees",
        ),
        (
            '{"type":"System","operator_lat_deg":0}',
            "System.operator_lon_deg: missing; give it together with System.operator_lat_deg, or neither",
        ),
    ],
)
def test_what_a_message_may_not_hold_is_told_with_what_it_may(
    terminal: Terminal, line: str, words: str
) -> None:
    for form in ([], ["--pack"], ["--frame", "ble4"]):
        assert terminal.run("encode", *form, stdin=line) == 1
        assert [error.replace(".0;", ";") for error in terminal.err] == [f"line 1: {words}"]


def test_a_line_that_is_not_hexadecimal_is_told_in_words(terminal: Terminal) -> None:
    noise = "zz\x1b" + "y" * 100
    assert terminal.run("decode", stdin=f"{noise}\n0x52\n{HEX[:-1]}\n\n{HEX}\nno\nmore\nhere\n") == 1
    assert terminal.out == [MESSAGE]
    assert terminal.err == [
        f'line 1: not hexadecimal: "zz\\u001b{"y" * 31}...',
        'line 2: not hexadecimal: "0x52"',
        f'line 3: its hexadecimal digits are not in pairs: "{HEX[:39]}...',
        'line 6: not hexadecimal: "no"',
        'line 7: not hexadecimal: "more"',
        'line 8: not hexadecimal: "here"',
    ]


@pytest.mark.parametrize("data", [b"# A text\n\nof some\nlines\n" * 9, b"\x89PNG\n", b"a\0b"])
def test_what_is_neither_capture_nor_hexadecimal_is_told_in_one_line(
    terminal: Terminal, tmp_path: Path, data: bytes
) -> None:
    file = tmp_path / "file"
    file.write_bytes(data)
    for name, arguments in (("stdin", []), (str(file), [str(file)])):
        assert terminal.run("decode", *arguments, stdin=data) == 2
        words = f"{name}: neither a capture (pcap, pcapng) nor hexadecimal text"
        assert (terminal.out, terminal.err) == ([], [f"remote-id decode: {words}"])


def test_one_wrong_line_is_no_foreign_input(terminal: Terminal) -> None:
    assert terminal.run("decode", stdin="0x5200\n") == 1
    assert terminal.err == ['line 1: not hexadecimal: "0x5200"']


@pytest.mark.parametrize("action", ["decode", "encode"])
def test_no_input_at_all_is_said(terminal: Terminal, action: str) -> None:
    assert terminal.run(action, stdin=b"") == 1
    assert terminal.err == ["nothing to read: the input is empty"]


def test_on_a_terminal_one_end_of_input_ends_it() -> None:
    ours, theirs = pty.openpty()
    try:
        os.write(ours, b"\x04")
        ended = subprocess.run(
            [sys.executable, "-m", "companion.commands.cli", "remote-id", "decode"],
            stdin=theirs,
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
    finally:
        os.close(ours)
        os.close(theirs)
    assert (ended.returncode, ended.stderr) == (1, "nothing to read: the input is empty\n")


@pytest.mark.parametrize(
    "arguments", [["decode"], ["encode"], ["encode", "--pack"], ["encode", "--frame", "wifi"]]
)
def test_nothing_on_stdin_is_said(terminal: Terminal, arguments: list[str]) -> None:
    assert terminal.run(*arguments, stdin="\n \n") == 1
    assert (terminal.out, terminal.err) == ([], ["nothing to read in 2 lines"])


# ---------------------------------------------------------------- frames


@pytest.mark.parametrize(
    ("transport", "address", "sizes"),
    [
        ("ble4", None, [31, 31]),
        ("ble5", None, [59]),
        ("wifi", ADDRESS, [101]),
        ("nan", ADDRESS, [104]),
    ],
)
def test_whole_frames_both_ways(
    terminal: Terminal, transport: str, address: str | None, sizes: list[int]
) -> None:
    other = '{"type":"SelfId","description_type":0,"text":"survey"}'
    options = ["--frame", transport, "--counter", "7", *(["--address", address] if address else [])]
    assert terminal.run("encode", *options, stdin=f"{MESSAGE}\n{other}\n") == 0
    lines = terminal.out
    assert [len(line) // 2 for line in lines] == sizes
    assert terminal.run("decode", "--frame", transport, stdin="\n".join(lines)) == 0
    read = [json.loads(line) for line in terminal.out]
    assert {(f["transport"], f["address"], f["counter"]) for f in read} == {(transport, address, 7)}
    assert [message for f in read for message in f["messages"]] == [json.loads(MESSAGE), json.loads(other)]
    assert {tuple(f["faults"]) for f in read} == {()}


def test_a_frame_without_options_has_counter_0_and_nobodys_address(terminal: Terminal) -> None:
    assert terminal.run("encode", "--frame", "nan", stdin=MESSAGE) == 0
    assert terminal.run("decode", "--frame", "nan", stdin=terminal.out[0]) == 0
    frame = json.loads(terminal.out[0])
    assert (frame["counter"], frame["address"]) == (0, "02:00:00:00:00:01")


@pytest.mark.parametrize(
    ("transport", "line", "words"),
    [
        ("ble4", "020106", "no Remote ID"),
        ("wifi", build_nan_sync_beacon(ADDRESS).hex(), f"NAN synchronisation beacon of {ADDRESS}"),
        ("wifi", "80", "1 bytes"),
        ("ble5", f"1e16faff0d00{HEX[:20]}", "message of 10 bytes"),
        ("ble5", f"ff16faff0d00f21902{HEX}", "cut short"),
    ],
)
def test_a_frame_that_is_none_or_torn_is_named(
    terminal: Terminal, transport: str, line: str, words: str
) -> None:
    assert terminal.run("decode", "--frame", transport, stdin=line) == 1
    assert terminal.err[0].startswith("line 1: ")
    assert words in terminal.err[0]


def test_more_than_a_pack_holds_is_refused(terminal: Terminal) -> None:
    for form in (["--pack"], ["--frame", "wifi"]):
        assert terminal.run("encode", *form, stdin=f"{MESSAGE}\n" * 2) == 1
        assert terminal.out == []
        assert "2 OperatorId messages; allowed: 1" in terminal.err[0]


@pytest.mark.parametrize(
    "arguments",
    [
        ["encode", "--counter", "7"],
        ["encode", "--address", ADDRESS],
        ["encode", "--frame", "ble5", "--address", ADDRESS],
        ["decode", "no such file"],
        ["decode", "."],
    ],
)
def test_a_wrong_request_exits_2_in_one_line(terminal: Terminal, arguments: list[str]) -> None:
    assert terminal.run(*arguments, stdin=MESSAGE) == 2
    assert (terminal.out, len(terminal.err)) == ([], 1)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--frame", "smoke"],
        ["--frame", "ble5", "--pack"],
        ["--frame", "ble5", "--counter", "256"],
        ["--frame", "ble5", "--counter", "-1"],
        ["--frame", "wifi", "--address", "02:00"],
    ],
)
def test_a_wrong_option_exits_2(terminal: Terminal, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        terminal.run("encode", *arguments, stdin=MESSAGE)
    assert stop.value.code == 2
