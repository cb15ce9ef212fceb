"""The command by hand: messages, frames and captures, back and forth; what is wrong is named."""

from __future__ import annotations

import argparse
import io
import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import dpkt
import pytest

from companion.commands import remote_id
from companion.commands.remote_id import message_json
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import build_beacon, build_nan_sync_beacon
from companion.remote_id.messages import BasicId, IdType, Location, SelfId, UaType

ADDRESS = "02:00:5e:10:20:30"
MESSAGE = '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}'
HEX = "520046494e38376173747264676531326b3800000000000000"


class Terminal:
    """Runs the command; holds what it wrote last."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch = monkeypatch
        self._capsys = capsys
        self.out: list[str] = []
        self.err: list[str] = []

    def run(self, *arguments: str, stdin: str | bytes = "") -> int:
        """Bytes come as from a pipe."""
        text = (
            io.StringIO(stdin)
            if isinstance(stdin, str)
            else io.TextIOWrapper(io.BufferedReader(io.BytesIO(stdin)))
        )
        self._monkeypatch.setattr("sys.stdin", text)
        parser = argparse.ArgumentParser()
        remote_id.add_arguments(parser.add_subparsers(required=True))
        args = parser.parse_args(arguments)
        status: int = args.run(args)
        captured = self._capsys.readouterr()
        self.out, self.err = captured.out.splitlines(), captured.err.splitlines()
        return status


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Terminal:
    return Terminal(monkeypatch, capsys)


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


# ---------------------------------------------------------------- files


def capture(path: Path, *frames: bytes, link_type: int = 105) -> Path:
    with path.open("wb") as stream:
        writer = dpkt.pcap.Writer(stream, linktype=link_type)
        for number, frame in enumerate(frames):
            writer.writepkt(frame, ts=1_700_000_000.5 + number)
    return path


TEXT = SelfId(description_type=0, text="survey")
SESSION = BasicId(id_type=IdType.SPECIFIC_SESSION, ua_type=UaType.GLIDER, uas_id="\x01\x80ÿ")
BEACON = build_beacon(encode_pack((SESSION, TEXT)), 7, ADDRESS)
ACK = b"\xd4\x00\x00\x00" + bytes(6)


@pytest.mark.parametrize("name", ["flight.pcap", "flight"])
def test_a_capture_gives_a_line_for_each_remote_id_frame_and_a_summary(
    terminal: Terminal, tmp_path: Path, name: str
) -> None:
    file = capture(tmp_path / name, BEACON, ACK, build_nan_sync_beacon(ADDRESS), b"\x80", BEACON)
    assert terminal.run("decode", str(file)) == 0
    frames = [json.loads(line) for line in terminal.out]
    assert frames[0] == {
        "file": str(file),
        "frame": 1,
        "time_utc_s": 1_700_000_000.5,
        "transport": "wifi",
        "address": ADDRESS,
        "rssi_dbm": None,
        "counter": 7,
        "messages": [
            {"type": "BasicId", "id_type": 4, "ua_type": 6, "uas_id": "\x01\x80ÿ"},
            {"type": "SelfId", "description_type": 0, "text": "survey"},
        ],
        "faults": [],
    }
    assert [frame["frame"] for frame in frames] == [1, 5]
    assert terminal.err == [
        f"{file}: 5 frames: 2 Remote ID, 1 NAN synchronisation beacon, 1 foreign, 0 bad CRC, 1 broken"
    ]


def test_a_capture_on_stdin_is_read_as_one(terminal: Terminal, tmp_path: Path) -> None:
    data = capture(tmp_path / "flight.pcap", BEACON, ACK).read_bytes()
    assert terminal.run("decode", stdin=data) == 0
    (frame,) = map(json.loads, terminal.out)
    assert (frame["file"], frame["frame"], frame["address"]) == ("stdin", 1, ADDRESS)
    assert terminal.err[0].startswith("stdin: 2 frames: 1 Remote ID")
    assert terminal.run("decode", "--frame", "wifi", stdin=data) == 2
    assert "stdin: --frame is for hexadecimal" in terminal.err[0]


def test_a_reader_that_has_had_enough_is_no_fault_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Closed(io.StringIO):
        def flush(self) -> None:
            raise BrokenPipeError

    text = tmp_path / "messages.hex"
    text.write_text(HEX)
    for file in (capture(tmp_path / "flight.pcap", BEACON), text):
        with monkeypatch.context() as patch:
            patch.setattr("sys.stdout", Closed())
            parser = argparse.ArgumentParser()
            remote_id.add_arguments(parser.add_subparsers(required=True))
            args = parser.parse_args(["decode", str(file)])
            with pytest.raises(BrokenPipeError):  # the command line ends quietly on it
                args.run(args)
        assert capsys.readouterr().err == ""


def test_a_fault_in_a_captured_frame_exits_1(terminal: Terminal, tmp_path: Path) -> None:
    file = capture(tmp_path / "flight.pcap", BEACON[:-10])
    assert terminal.run("decode", str(file)) == 1
    frame = json.loads(terminal.out[0])
    assert [message["type"] for message in frame["messages"]] == ["BasicId"]
    assert "cut short" in frame["faults"][0]


def test_a_capture_that_ends_early_gives_what_was_whole(terminal: Terminal, tmp_path: Path) -> None:
    file = capture(tmp_path / "flight.pcap", BEACON, BEACON)
    file.write_bytes(file.read_bytes()[:-1])
    assert terminal.run("decode", str(file)) == 1
    assert len(terminal.out) == 1
    assert terminal.err[0].startswith(f"{file}: packet 2, at byte ")
    assert "1 frames" in terminal.err[1]


def test_a_foreign_file_exits_2(terminal: Terminal, tmp_path: Path) -> None:
    text = tmp_path / "text.pcap"
    text.write_text(HEX)
    assert terminal.run("decode", str(text)) == 2
    assert terminal.err == [
        f"remote-id decode: {text}: starts with {HEX[:4].encode().hex()}; expected a capture, pcap or pcapng"
    ]
    wired = capture(tmp_path / "wired.pcap", BEACON, link_type=1)
    assert terminal.run("decode", str(wired)) == 2
    assert f"{wired}: packet 1 has link type 1" in terminal.err[0]
    assert terminal.run("decode", "--frame", "wifi", str(capture(tmp_path / "a.pcap", BEACON))) == 2


def test_files_of_hexadecimal_are_read_and_their_lines_named(terminal: Terminal, tmp_path: Path) -> None:
    """With the byte order mark and the line ends that editors leave."""
    one, two, none = tmp_path / "one.txt", tmp_path / "two.hex", tmp_path / "none"
    one.write_bytes(b"\xef\xbb\xbf" + HEX.encode() + b"\r\n\xff\r\n")
    two.write_text(f"{HEX}\n")
    none.write_text("")
    assert terminal.run("decode", str(one), str(two), str(none)) == 1
    assert terminal.out == [MESSAGE, MESSAGE]
    assert terminal.err[0].startswith(f"{one}: line 2: ")
    assert terminal.err[1] == f"{none}: nothing to read: the input is empty"
    assert terminal.run("decode", str(two)) == 0
    two.write_text(BEACON.hex())
    assert terminal.run("decode", "--frame", "wifi", str(two)) == 0
    assert json.loads(terminal.out[0])["address"] == ADDRESS


def test_an_unknown_location_is_a_message_like_any_other(terminal: Terminal) -> None:
    assert terminal.run("decode", stdin=encode_pack((Location(),)).hex()) == 0
    assert terminal.out == ['{"type":"Location"}']
