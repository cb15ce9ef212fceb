"""The reader of encounter models: accepted files, and the error messages for others."""

from __future__ import annotations

import numpy as np
import pytest

from companion.errors import ConfigError
from ground_tools.campaign.encounters.model import CLIMB, LAYER, SPEED, parse, read
from tests.support.encounter_models import NAMES, TINY, model_of

TEXT = TINY.read_text()
LABELS = '"L", "v", "\\dot v", "\\dot h", "\\dot \\psi" \n'


def test_the_numbers_are_where_the_format_says():
    model = read(TINY)
    assert [v.label for v in model.initial] == ["L", "v", r"\dot v", r"\dot h", r"\dot \psi"]
    speed = model.initial[model.at(SPEED)]
    assert (speed.bins, speed.parents, speed.strides) == (3, (0,), (1,))
    np.testing.assert_array_equal(speed.counts, [[1, 6, 3], [0, 2, 8]])
    faster = model.next[5]
    assert faster is not None
    assert (faster.parents, faster.strides) == ((1, 2), (1, 3))  # the first parent is the fastest
    np.testing.assert_array_equal(faster.counts[2 * 3 + 1], [1, 3, 6])  # v in bin 2 of 3, \dot v in bin 3
    assert model.next[:5] == (None,) * 5
    assert model.next_order == ((5, 2), (6, 3), (7, 4))
    assert model.bounds(CLIMB) == (-1000.0, -300.0, 300.0, 1000.0)
    assert model.zero_bins == (None, None, 1, 1, 1)
    assert model.resample_rates == (0.0, 0.0, 0.1, 0.2, 0.3)
    assert model.index("G") is None


def test_the_model_is_the_same_without_trailing_blanks_and_with_other_line_ends():
    wanted = parse(TEXT, "tiny", "")
    for text in (TEXT.replace(" \n", "\n"), TEXT.replace("\n", "\r\n"), f"\n{TEXT}\n\n"):
        found = parse(text, "tiny", "")
        assert found.boundaries == wanted.boundaries
        assert all(
            np.array_equal(a.counts, b.counts) for a, b in zip(found.initial, wanted.initial, strict=True)
        )


@pytest.mark.parametrize("name", NAMES)
def test_published_models(name):
    model = model_of(name)
    assert model.initial[model.at(LAYER)].bins == 4
    assert model.initial[model.at(SPEED)].bins == 8
    # The counts of one variable are sums of the next one's, so the file was split at the right places.
    for i, variable in enumerate(model.initial):
        assert variable.counts.sum() == model.initial[0].counts.sum(), i
    for variable in model.next:
        assert variable is None or variable.counts.sum() > 0.0


def changed(before: str, after: str) -> str:
    assert TEXT.count(before) == 1, before
    return TEXT.replace(before, after)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "there is no section labels_initial"),
        (f"1 2\n{TEXT}", "line 1: text before the first section"),
        (changed("# r_initial", "# q_initial"), "line 9: section 'q_initial' is not known; allowed: labels"),
        (changed("# r_initial", "# G_initial"), "line 9: section G_initial is there twice, first in line 3"),
        (changed("# r_initial\n2 3 3 3 3 \n", "# r_initial\n"), "line 9: section r_initial is empty"),
        (changed(LABELS, '"L", "v"\n'), "line 2: variables L, v; allowed: L, v, "),
        (changed(LABELS, LABELS.replace("v", "L", 1)), "line 2: variables L, L, "),
        (changed('"\\dot h(t+1)"', '"\\dot h(t+2)"'), r"line 14: variables .*; allowed: L, v, "),
        (changed("0 1 0 1 0 \n0 0 1 0 1 \n0 0 0 0 0 \n", "0 1 0 1 0 \n0 0 1 0 1 \n"),
         "line 3: 4 lines; allowed: 5, one for each variable"),
        (changed("0 1 0 1 0 \n", "0 1 0 2 0 \n"), "line 4: allowed: 0 and 1"),
        (changed("0 1 0 1 0 \n", "0 1 0 1 \n"), "line 4: 4 numbers; allowed: 5"),
        (changed("0 1 0 1 0 \n0 0 1 0 1 \n", "0 1 0 1 0 \n1 0 1 0 1 \n"), "line 3: the graph has a circle"),
        (changed("2 3 3 3 3 \n# N", "2 0 3 3 3 \n# N"), "line 10: allowed: whole numbers of bins from 1"),
        (changed("2 3 3 3 3 \n# N", "2 1000000 3 3 3 \n# N"), "line 10: allowed: whole numbers"),
        (changed("2 3 3 3 3 \n# N", "2 3 3 3 3 \n3\n# N"), "line 11: one line too many"),
        (changed("30 10 1 6 3", "30 10 1 6"), "line 12: 31 numbers; allowed: 32"),
        (changed("30 10 1 6 3", "30 10 1 -6 3"), "line 12: number 4 is -6; allowed: counts from 0"),
        (changed("30 10 1 6 3", "30 10 1 six 3"), "line 12: number 4 is 'six'; allowed: finite numbers"),
        (changed("30 10 1 6 3", "30 10 1 nan 3"), "line 12: number 4 is 'nan'; allowed: finite numbers"),
        (changed("30 10 1 6 3", "0 0 1 6 3"), "line 12: no counts of L; allowed: at least one above 0"),
        (changed("2 3 3 3 3 3 3 3", "2 3 3 3 3 3 3 4"), r"line 25: numbers of bins .*; allowed: those of"),
        (changed("8 2 0 6 3 1", "8 2 0 6 3"), "line 27: 71 numbers; allowed: 72"),
        (changed("0 40 80 120", "0 40 80"), "line 30: 3 numbers; allowed: 4"),
        (changed("0 40 80 120", "0 80 40 120"), "line 30: allowed: rising boundaries"),
        (changed("0 40 80 120", "-1 40 80 120"), "line 30: allowed: boundaries of v from 0"),
        (changed("0 40 80 120", "*"), "line 30: \\* for v; allowed: the boundaries of its bins"),
        (changed("0 0 0.1 0.2 0.3", "0 0 0.1 0.2 1.3"), "line 35: allowed: rates from 0 to 1"),
        (changed("# resample_rates", ""), "there is no section|line 34: "),
    ],
)  # fmt: skip
def test_bad_input_is_named(text, said, tmp_path):
    path = tmp_path / "model.txt"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said) as error:
        read(path)
    assert str(error.value).startswith(f"--model: {path}: ")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read(tmp_path / "none.txt")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        read(tmp_path)
    path = tmp_path / "model.txt"
    path.write_bytes(b"# labels_initial\n\xff\n")
    with pytest.raises(ConfigError, match="byte 17: not allowed; allowed: ASCII text"):
        read(path)


def test_every_cut_of_a_file_is_refused_or_read(tmp_path):
    """A file that ends too early is never read as a model with fewer numbers."""
    whole = TEXT.rstrip()
    for end in range(0, len(whole) - 2, 7):
        with pytest.raises(ValueError, match=r"line|there is no section"):
            parse(whole[:end], "cut", "")
