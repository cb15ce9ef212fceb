"""The kernels' cache, and a computer that has none."""

from __future__ import annotations

import subprocess
import sys

import pytest

from companion.avoidance.kernels import compiled
from companion.runtime.warm import warm_up


def test_the_second_process_loads_what_the_first_compiled():
    warm_up()  # by now it is in the cache
    code = "from companion.runtime.warm import *; warm_up(); print(was_compiled())"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "False\n"


def test_a_user_without_any_folder_compiles_anew(monkeypatch):
    def without_a_folder(*, cache, **_options):
        if cache:
            raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")
        return lambda function: ("compiled", function)

    monkeypatch.setattr(compiled, "njit", without_a_folder)
    monkeypatch.setattr(compiled, "FUNCTIONS", [])
    assert compiled.compiled(len) == ("compiled", len)


DAMAGED = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import pieces
from companion.runtime.warm import past_the_cache
if sys.argv[2] == "full":
    def full(*_):
        raise OSError(28, "No space left on device")
    pieces.whole._cache._cache_file._open_for_write = full
    pieces.part._cache._cache_file._open_for_write = full
values = []
past_the_cache(lambda: values.append(pieces.whole(1)), vars(pieces).values())
print(values)
"""


@pytest.mark.parametrize("what", ["full", "empty index", "empty code"])
def test_a_cache_that_cannot_be_used_keeps_nobody_on_the_ground(tmp_path, what, monkeypatch):
    (tmp_path / "pieces.py").write_text(
        "from numba import njit\n"
        "@njit(cache=True)\ndef part(x):\n    return x + 1\n"
        "@njit(cache=True)\ndef whole(x):\n    return part(x) + 1\n"
    )
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def compiles(how):
        arguments = [sys.executable, "-c", DAMAGED, str(tmp_path), how]
        return subprocess.run(arguments, capture_output=True, text=True)

    if what != "full":
        compiles("sound")
        damaged = list((tmp_path / "cache").rglob("*.nbi" if what == "empty index" else "*.nbc"))
        assert len(damaged) >= 2
        for path in damaged:
            path.write_bytes(b"")
    done = compiles(what)
    assert (done.returncode, done.stdout) == (0, "[3]\n"), done.stderr
