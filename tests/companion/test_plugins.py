"""Plug-ins are found by their entry points, and those that cannot be loaded are named."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from companion import config as configuration
from companion import plugins
from companion.errors import ConfigError
from companion.laws import LAWS, kind_of, plugin_of
from tests.support import plugged

ROOT = Path(__file__).parents[2]


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder for distributions on the search path."""
    monkeypatch.syspath_prepend(str(tmp_path))
    plugged.forget("one", "other")
    yield tmp_path
    plugged.forget("one", "other")


def test_a_plug_in_is_loaded_with_its_distribution(site):
    plugged.install(site, "one", "class Law: pass", {plugins.LAWS: {"mine": "one:Law"}})
    found = plugins.load(plugins.LAWS, "mine")
    assert str(found) == '"mine" (one:Law of one 1.0)'
    assert found.loaded.__name__ == "Law"
    assert plugins.load(plugins.LAWS, "mine") is found
    assert plugins.names(plugins.LAWS) == ["mine"]


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        ("import no_such_module", "ModuleNotFoundError: No module named 'no_such_module'"),
        ("class Other: pass", "AttributeError: module 'one' has no attribute 'Law'"),
        ("raise SystemExit(2)", "SystemExit: 2"),
        ("raise GeneratorExit('cancelled')", "GeneratorExit: cancelled"),
        ("def broken(:", "SyntaxError: invalid syntax"),
        ("class E(Exception):\n    def __str__(self): raise OSError\nraise E", "E: its text cannot be read"),
    ],
)
def test_one_that_cannot_be_imported_is_named_with_the_cause(site, source, cause):
    plugged.install(site, "one", source, {plugins.LAWS: {"mine": "one:Law"}})
    with pytest.raises(ConfigError) as refused:
        plugins.load(plugins.LAWS, "mine")
    words = f"'mine': the plug-in one:Law of one 1.0 (dmuca.laws) cannot be loaded: {cause}"
    assert str(refused.value).startswith(words)


def test_an_unknown_name_is_answered_with_those_that_are_there(site):
    plugged.install(site, "one", "class Law: pass", {plugins.LAWS: {"m": "one:Law", "b": "one:Law"}})
    with pytest.raises(ConfigError, match=r"'my': no plug-in of dmuca\.laws has this name; plug-ins: b, m"):
        plugins.load(plugins.LAWS, "my")
    with pytest.raises(ConfigError, match="plug-ins: none is installed"):
        plugins.load(plugins.RADIOS, "mine")


def test_two_distributions_of_one_name_are_refused(site):
    for name in ("one", "other"):
        plugged.install(site, name, "class Law: pass", {plugins.LAWS: {"mine": f"{name}:Law"}})
    with pytest.raises(
        ConfigError, match=r"several plug-ins.*one:Law of one 1\.0 and other:Law of other 1\.0"
    ):
        plugins.load(plugins.LAWS, "mine")


def test_an_object_of_a_module_in_the_current_folder_needs_no_distribution(tmp_path, monkeypatch):
    (tmp_path / "one.py").write_text("class Law: pass")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry not in ("", str(tmp_path))])
    before = list(sys.path)
    plugged.forget("one")
    found = plugin_of("one:Law")
    plugged.forget("one")
    assert str(found) == '"one:Law" (one:Law of the Python path)'
    assert found.loaded.__name__ == "Law"
    assert sys.path == before, "nothing else is looked for there"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such:Law", "cannot be loaded: ModuleNotFoundError: No module named 'no_such'"),
        ("json:Law", "cannot be loaded: AttributeError: module 'json' has no attribute 'Law'"),
        (":Law", "':Law' is unknown; allowed: dmuca, paper, none"),
        ("json:", "'json:' is unknown; allowed: dmuca, paper, none"),
        ("a b:Law", "'a b:Law' is unknown"),
    ],
)
def test_a_module_that_has_no_such_object_is_named(name, words):
    with pytest.raises(ConfigError) as refused:
        plugin_of(name)
    assert words in str(refused.value)


def test_a_law_of_our_own_cannot_be_replaced(site):
    plugged.install(site, "one", "class Law: pass", {plugins.LAWS: {"dmuca": "one:Law"}})
    assert plugin_of("dmuca") is None
    assert kind_of("dmuca") is LAWS["dmuca"]


def load(folder, law, more=""):
    file = folder / "my.toml"
    file.write_text(f'[identity]\nuas_id = "1596B0000DMUCA01"\n[avoidance]\nlaw = "{law}"\n{more}')
    return configuration.load(file)


def test_a_configuration_names_a_law_of_a_plug_in(site):
    plugged.laws(site, "one")
    made = load(
        site, "aside", '[flight]\nuse = "guard"\n[[radio]]\nbackend = "ether"\naddress = "127.0.0.1:15550"\n'
    )
    assert made.avoidance.law == "aside"
    (site / "again.toml").write_bytes(configuration.dump(made))
    assert configuration.load(site / "again.toml").avoidance.law == "aside"


def test_a_configuration_with_an_unknown_law_names_the_key_and_all_laws(site):
    plugged.laws(site, "one")
    with pytest.raises(ConfigError) as refused:
        load(site, "dmcua")
    text = str(refused.value)
    assert text.startswith(f"{site / 'my.toml'}: avoidance.law: 'dmcua' is unknown")
    assert "allowed: dmuca, paper, none, aside, " in text


def test_no_entry_point_is_looked_for_where_no_plug_in_is_named():
    """The core of a configuration without plug-ins reads no metadata of distributions."""
    code = (
        "from importlib import metadata\n"
        "def refuse(**_): raise AssertionError\n"
        "metadata.entry_points = refuse\n"
        "from pathlib import Path\n"
        "from companion import config\n"
        "from companion.core import Companion\n"
        "Companion(config.load(Path('config/companion.toml')))\n"
    )
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, env=environment)
