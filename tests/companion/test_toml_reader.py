"""Odd TOML is refused in one line that names the file and the key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from companion import config as configuration
from companion.errors import ConfigError

IDENTITY = '[identity]\nuas_id = "A1"\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "c.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("x = " + "[" * 20_000, "not valid TOML: nested too deeply", id="deep list"),
        pytest.param("a." * 20_000 + "a = 1\n", ": a key has more than 16 parts", id="deep key"),
        pytest.param(' "\\"" . ' * 16 + "a = 1\n", ": a key has more than 16 parts", id="deep quoted key"),
        pytest.param("[[" + "'a.b'." * 16 + "a]]\n", ": a key has more than 16 parts", id="deep table"),
        pytest.param("x = {y = 1, " + "a." * 16 + "a = 1}\n", ": a key has more than 16 parts", id="inline"),
        pytest.param(
            IDENTITY + "[limits]\nmax_speed_mps = " + "9" * 5_000, "not valid TOML: Exceeds", id="digits"
        ),
        pytest.param(
            IDENTITY + "[limits]\nmax_speed_mps = " + "9" * 400,
            "limits.max_speed_mps: number out of range",
            id="large number",
        ),
        pytest.param(IDENTITY + '"` - at `$.limits" = 1\n', "unknown field", id="signs in a key"),
        pytest.param(
            IDENTITY + '[flight]\ntrajectory = "a\\u0000b"\n',
            "flight.trajectory: contains the character NUL",
            id="NUL in a file name",
        ),
        pytest.param(
            IDENTITY + '[record]\nfolder = "a\\u0000b"\n',
            "record.folder: contains the character NUL",
            id="NUL in a folder",
        ),
        pytest.param("#" * 4_000_001, "more than 4,000,000 bytes", id="large file"),
    ],
)
def test_odd_toml_is_one_line_of_text_and_no_traceback(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(message)) as caught:
        configuration.load(write(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_text_may_have_any_number_of_dots(tmp_path: Path) -> None:
    folder = "a." * 20 + "a"
    loaded = configuration.load(write(tmp_path, f'{IDENTITY}[record]\nfolder = "{folder}" # {folder}\n'))
    assert loaded.record.folder == str(tmp_path / folder)


def test_a_file_written_on_windows_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_bytes(b"\xef\xbb\xbf" + IDENTITY.replace("\n", "\r\n").encode())
    assert configuration.load(path).identity.uas_id == "A1"
