"""The kernels' cache, and a computer that has none."""

from __future__ import annotations

import subprocess
import sys

import pytest

from companion.avoidance.kernels import compiled, programs
from companion.avoidance.kernels.vectors import Vector
from companion.runtime.warm import warm_up


def test_the_second_process_loads_what_the_first_compiled_without_the_compiler_s_libraries():
    warm_up()  # by now it is in the cache
    code = (
        "import sys; from companion.runtime.warm import *; warm_up();"
        "print(was_compiled(), 'numba.np.npyimpl' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "False False\n"


def test_a_process_that_loads_some_compiles_the_others():
    warm_up()
    code = (
        "from companion.runtime.warm import *; warm_up(); print(was_compiled());"
        "from companion.avoidance.kernels import programs;"
        "from companion.avoidance.kernels.vectors import Vector;"
        "from companion.avoidance.kernels.compiled import compiled;"
        "print(compiled(lambda p: programs.half_space(p, p, 3.0, 5.0, 1.0))(Vector(10.0, 0.0, 0.0))[1])"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    before, length = done.stdout.split()
    assert before == "False"
    assert float(length) == programs.half_space(*2 * [Vector(10.0, 0.0, 0.0)], 3.0, 5.0, 1.0)[1]


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
        "from companion.avoidance.kernels.compiled import LoadingCache\n"
        "@njit(cache=True, _nrt=False)\ndef part(x):\n    return x + 1\n"
        "@njit(cache=True, _nrt=False)\ndef whole(x):\n    return part(x) + 1\n"
        "for function in part, whole:\n    function._cache = LoadingCache(function.py_func)\n"
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
