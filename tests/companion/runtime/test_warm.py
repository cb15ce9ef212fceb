"""The kernels' cache, and a computer that has none."""

from __future__ import annotations

import subprocess
import sys

from companion.avoidance import compiled
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
    assert compiled.compiled(len) == ("compiled", len)
