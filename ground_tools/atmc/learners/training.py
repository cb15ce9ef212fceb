"""One training run and its folder: configuration, manifest, metrics, checkpoint, TensorBoard events, policy.

    config.toml          all settings, including the defaults
    manifest.json        algorithm, seed, device, versions, commit
    metrics.csv          one row for each round
    events.out.tfevents* the same for TensorBoard
    checkpoint.pt        everything that the rest of the run depends on
    policy.safetensors   the policy of the best validation so far

A checkpoint is written every few rounds and when the run is stopped. A resumed run gives the same results as
an uninterrupted one, bit for bit on a CPU; only the times differ.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import Any

import msgspec
import tomli_w
import torch
from torch.utils.tensorboard import SummaryWriter

from companion.errors import ConfigError
from companion.runtime.record.recorder import create_run_folder, write_manifest
from companion.toml_reader import decode_toml, without_none
from ground_tools.atmc.env.torch_setup import set_up_torch
from ground_tools.atmc.learners.algorithms import ALGORITHMS
from ground_tools.atmc.learners.learner import Learner

_PREFIX = "validation_"


@dataclass(frozen=True, slots=True)
class Job:
    """Definition of one training run."""

    algorithm: str
    settings: Any
    seed: int
    device: str
    folder: Path
    resumed: bool = False


Report = Callable[[int, int, Mapping[str, float | None]], None]
"""Progress callback. It takes the number of rounds done, the total number, and the row of metrics.csv."""


def new_job(algorithm: str, settings: Any, seed: int, device: str, root: Path) -> Job:
    """Make the folder of a new run, with its configuration and manifest.

    Raises:
        ConfigError: The folder cannot be made.
    """
    folder = create_run_folder(root, f"{algorithm}-seed{seed}", time.time(), "--out")
    _write_settings(folder, settings)
    write_manifest(
        folder,
        "ground-tools atmc train",
        algorithm=algorithm,
        seed=seed,
        device=device,
        torch=metadata.version("torch"),
    )
    return Job(algorithm, settings, seed, device, folder)


def _write_settings(folder: Path, settings: Any) -> None:
    _replace(folder / "config.toml", tomli_w.dumps(without_none(msgspec.to_builtins(settings))).encode())


def resumed_job(folder: Path, device: str | None, episodes: int | None) -> Job:
    """Continue in the folder of an earlier run.

    Args:
        folder: The run folder.
        device: Device name; None for that of the earlier run.
        episodes: Total number of episodes; None for that of the earlier run.

    Raises:
        ConfigError: The folder is not a run folder, or it holds no checkpoint.
    """
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        algorithm, seed = str(manifest["algorithm"]), int(manifest["seed"])
        kind = type(ALGORITHMS[algorithm].parts().settings)
        device = device or str(manifest["device"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"--resume: {folder}: this is not the folder of a training run") from error
    if not (folder / "checkpoint.pt").exists():
        raise ConfigError(f"--resume: {folder}: checkpoint.pt is missing; the run ended before it wrote one")
    settings: Any = decode_toml(folder / "config.toml", kind)
    if episodes is not None:
        settings = msgspec.structs.replace(settings, episodes=episodes)
        _write_settings(folder, settings)
    return Job(algorithm, settings, seed, device, folder, resumed=True)


def device_of(name: str) -> torch.device:
    """The PyTorch device for the value of the option --device.

    Raises:
        ConfigError: This machine has no such device.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device: cuda: PyTorch finds no GPU on this machine; allowed: cpu")
    return torch.device(name)


def train(job: Job, report: Report) -> bool:
    """Train until the end, or until SIGINT or SIGTERM. On a signal, the current round is finished first.

    Returns:
        Whether the run reached its end.

    Raises:
        ConfigError: There is no such device, or a file of the earlier session cannot be read.
    """
    device = device_of(job.device)
    set_up_torch()
    run = _Run(job, ALGORITHMS[job.algorithm].parts().make(job.settings, job.seed, device))
    try:
        with _stop_asked() as stopped:
            while run.learner.done < run.learner.rounds and not stopped():
                report(run.learner.done + 1, run.learner.rounds, run.round())
        run.write_checkpoint()
    finally:
        run.close()
    return run.learner.done >= run.learner.rounds


class _Run:
    """A run in progress, and its files."""

    def __init__(self, job: Job, learner: Learner) -> None:
        self._job, self.learner = job, learner
        self._algorithm = ALGORITHMS[job.algorithm]
        self._best, self._earlier_s = math.inf, 0.0
        if job.resumed:
            self._read_checkpoint()
        self._metrics = _Metrics(job.folder / "metrics.csv", learner.done)
        self._board = SummaryWriter(str(job.folder), purge_step=learner.done + 1)
        self._began_s = time.monotonic()

    def round(self) -> dict[str, float | None]:
        """Train for one round and write its results to the files. Returns the row of metrics.csv."""
        learner = self.learner
        row: dict[str, float | None] = {"episode": 0, **learner.train()}
        row["episode"] = learner.done
        if learner.done % self._algorithm.validate_every == 0 or learner.done == learner.rounds:
            row |= {_PREFIX + key: value for key, value in self._validate().items()}
        row["seconds"] = self._seconds()
        self._metrics.add(row)
        for key, value in row.items():
            if value is not None and math.isfinite(value):
                self._board.add_scalar(key.replace("_uav", "/uav"), value, learner.done)
        if learner.done % self._algorithm.checkpoint_every == 0:
            self.write_checkpoint()
        return row

    def _validate(self) -> dict[str, float]:
        """Validate the policy, and save it if it is the best so far."""
        found = self.learner.validate()
        if found["score"] < self._best:
            self._best = found["score"]
            name = f"{self._job.algorithm}, seed {self._job.seed}"
            _replace(self._job.folder / "policy.safetensors", self.learner.frozen(name, found))
        return found

    def write_checkpoint(self) -> None:
        """Write the complete state, replacing the previous checkpoint."""
        self._metrics.flush()
        state = {"learner": self.learner.state(), "best": self._best, "seconds": self._seconds()}
        memory = self._job.folder / "checkpoint.pt.new"
        torch.save(state, memory)
        os.replace(memory, self._job.folder / "checkpoint.pt")

    def _read_checkpoint(self) -> None:
        path = self._job.folder / "checkpoint.pt"
        try:
            state = torch.load(path, map_location="cpu", weights_only=True)
            self.learner.load(state["learner"])
        except Exception as error:  # PyTorch raises many kinds for a damaged file or other settings.
            raise ConfigError(f"--resume: {path}: cannot be read with this configuration: {error}") from error
        self._best, self._earlier_s = state["best"], state["seconds"]

    def _seconds(self) -> float:
        """Working time so far, in all sessions."""
        return self._earlier_s + time.monotonic() - self._began_s

    def close(self) -> None:
        """Flush and close the files."""
        self._metrics.flush()
        self._board.close()


class _Metrics:
    """The file metrics.csv. When a run is resumed, rows after its checkpoint are removed.

    Validation runs in some rounds only. Its columns are the last ones, and the file is rewritten when they
    first appear.
    """

    def __init__(self, path: Path, done: int) -> None:
        self._path = path
        self._rows: list[dict[str, Any]] = []
        if done and path.exists():
            try:
                with path.open(newline="") as file:
                    self._rows = [row for row in csv.DictReader(file) if int(row["episode"]) <= done]
            except (OSError, ValueError, KeyError) as error:
                raise ConfigError(
                    f"--resume: {path}: this is not the metrics file of a run: {error}"
                ) from error
        self._columns: list[str] = list(self._rows[0]) if self._rows else []
        if self._rows:
            self._write_all()

    def add(self, row: Mapping[str, float | None]) -> None:
        """Add a row."""
        self._rows.append(dict(row))
        new = [key for key in row if key not in self._columns]
        if new:
            self._columns += new
            self._write_all()
        else:
            with self._path.open("a", newline="") as file:
                csv.DictWriter(file, self._columns).writerow(row)

    def flush(self) -> None:
        """Sync the file to disk; all rows are in it already."""
        if self._path.exists():
            with self._path.open("a") as file:
                os.fsync(file.fileno())

    def _write_all(self) -> None:
        text = io.StringIO()
        writer = csv.DictWriter(text, self._columns)
        writer.writeheader()
        writer.writerows(self._rows)
        _replace(self._path, text.getvalue().encode())


def _replace(path: Path, data: bytes) -> None:
    """Replace a file atomically: a reader finds the old file or the new one."""
    new = path.with_name(path.name + ".new")
    new.write_bytes(data)
    os.replace(new, path)


@contextmanager
def _stop_asked() -> Iterator[Callable[[], bool]]:
    """Yield a function that returns whether SIGINT (Ctrl-C) or SIGTERM was received.

    The first signal restores its previous handler, so a second one ends the process.
    """
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked.is_set
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(number, before[signal.Signals(number)])

    for number in before:
        signal.signal(number, ask)
    try:
        yield asked.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
