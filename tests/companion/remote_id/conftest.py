"""A terminal for the remote-id command."""

from __future__ import annotations

import argparse
import io

import pytest

from companion.commands import remote_id


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
