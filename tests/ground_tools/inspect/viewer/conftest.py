"""One recording, written and read back once for all tests that use it."""

from pathlib import Path

import pytest

from ground_tools.inspect.read.read_run import read_run
from ground_tools.inspect.viewer import recording
from tests.ground_tools.inspect.viewer.reading import Read


@pytest.fixture(scope="module")
def saved(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "inspect.rrd"
    recording.write(read_run(built), path)
    return path


@pytest.fixture(scope="module")
def found(saved: Path) -> Read:
    return Read(saved)
