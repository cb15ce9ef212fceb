"""The remote-id command reads captures and files of hexadecimal text."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import dpkt
import pytest

from companion.commands import remote_id
from companion.remote_id.codec import encode_pack
from companion.remote_id.frames import build_beacon, build_nan_sync_beacon
from companion.remote_id.messages import BasicId, IdType, Location, SelfId, UaType
from tests.companion.remote_id.conftest import Terminal

ADDRESS = "02:00:5e:10:20:30"
MESSAGE = '{"type":"OperatorId","operator_id_type":0,"operator_id":"FIN87astrdge12k8"}'
HEX = "520046494e38376173747264676531326b3800000000000000"


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
