"""What is said never holds up who says it."""

from __future__ import annotations

import threading

import pytest

from companion.runtime.status.console import Voice


def test_lines_come_out_in_order():
    lines = []
    voice = Voice(lines.append)
    for number in range(100):
        voice.say(str(number))
    voice.close()
    assert lines == [str(number) for number in range(100)]
    assert voice.dropped == 0


def test_a_stopped_terminal_holds_up_nothing(monkeypatch):
    monkeypatch.setattr("companion.runtime.status.console._PATIENCE_S", 0.05)
    go_on = threading.Event()
    lines = []

    def stopped(line):
        go_on.wait()
        lines.append(line)

    voice = Voice(stopped)
    for number in range(1_000):
        voice.say(str(number))
    voice.close()
    assert lines == []
    assert 790 <= voice.dropped <= 800
    go_on.set()


@pytest.mark.parametrize("error", [BrokenPipeError(32, "Broken pipe"), ValueError("closed file")])
def test_a_broken_pipe_raises_nothing(error):
    def broken(_line):
        raise error

    voice = Voice(broken)
    for _ in range(10):
        voice.say("line")
    voice.close()
    assert voice.dropped == 10


def test_a_strangers_name_does_not_steer_the_terminal():
    lines = []
    voice = Voice(lines.append)
    voice.say("avoiding: conflict with \x1b[2J\x07EVIL\u202e\nOK: all well")
    voice.close()
    assert lines == ["avoiding: conflict with ?[2J?EVIL??OK: all well"]
