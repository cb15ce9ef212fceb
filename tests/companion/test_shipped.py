"""Where the files that come with the software are found."""

from pathlib import Path

import pytest

from companion import config as configuration
from companion import shipped
from companion.errors import ConfigError
from sitl_mocks.encounters import scenario_file

ROOT = Path(__file__).parents[2]
IDENTITY = '[identity]\nuas_id = "1596B0000DMUCA01"\n'


def test_in_a_checkout_they_are_its_folders():
    assert shipped.CHECKOUT == ROOT
    assert shipped.shipped("config/regions/us.toml") == ROOT / "config/regions/us.toml"


def test_in_an_installed_copy_they_are_in_the_package_dmuca(monkeypatch):
    monkeypatch.setattr(shipped, "CHECKOUT", None)
    assert shipped.shipped("results/atmc") == ROOT / "dmuca/results/atmc"


def test_a_file_of_the_current_folder_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "config/regions/us.toml"
    assert shipped.given(name) == ROOT / name
    (tmp_path / "config/regions").mkdir(parents=True)
    (tmp_path / name).touch()
    assert shipped.given(name) == Path(name)


@pytest.mark.parametrize(
    "text", ["", "us.toml", "config/none.toml", "config/../config/fence.toml", "tests/conftest.py", "/config"]
)
def test_other_names_stay_as_they_are(tmp_path, monkeypatch, text):
    monkeypatch.chdir(tmp_path)
    assert shipped.given(text) == Path(text)


def test_a_shipped_scenario_is_named_without_folder_and_ending(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shipped.given("head_on", "scenarios") == ROOT / "config/scenarios/head_on.toml"
    assert shipped.given("head_off", "scenarios") == Path("head_off")
    assert (
        shipped.given("config/scenarios/head_on.toml", "scenarios") == ROOT / "config/scenarios/head_on.toml"
    )
    (tmp_path / "head_on").touch()
    assert shipped.given("head_on", "scenarios") == Path("head_on"), "a file of that name comes first"


def test_a_configuration_may_name_a_profile_and_a_policy_that_are_shipped(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(IDENTITY + '[remote_id]\nregion = "us"\n[atmc]\npolicy = "atmc"\n')
    config = configuration.load(path)
    assert config.region.name == "us"
    assert config.atmc.policy == str(ROOT / "config/policies/atmc.safetensors")
    (tmp_path / "us").write_text('name = "mine"\n')
    assert configuration.load(path).region.name == "mine", "a file of that name beside it comes first"


def test_a_scenario_may_name_them_too(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        'geometry = "S2"\n[air]\nmodel = "packets"\nparameters = "standard"\nregion = "eu"\n'
        '[atmc]\npolicy = "atmc"\n'
    )
    scenario = scenario_file.load(path)
    assert scenario.region.name == "eu"
    assert scenario.channel is not None
    path.write_text('geometry = "S2"\n[air]\nregion = "../regions/eu"\n')
    with pytest.raises(ConfigError, match="cannot be read"):
        scenario_file.load(path)


def test_a_missing_package_is_installed_by_the_command_for_this_copy(monkeypatch):
    assert shipped.how_to_install("rerun", "inspect").endswith("in the checkout: pip install -e '.[inspect]'")
    monkeypatch.setattr(shipped, "CHECKOUT", None)
    assert shipped.how_to_install("rerun", "inspect").endswith("run: pip install 'dmuca[inspect]'")
