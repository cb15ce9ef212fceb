"""The subcommands of `ground-tools atmc`."""

from __future__ import annotations

import argparse

from ground_tools.atmc.commands import collect, crosscheck, evaluate_command, freeze_command, sweep, train


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the subcommands of `ground-tools atmc`; each sets `run`. They import PyTorch only when they run."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in (
        ("train", train, "train a policy"),
        ("evaluate", evaluate_command, "compare a policy with the baselines"),
        ("freeze", freeze_command, "write the policy file for flight from a training run"),
        ("collect", collect, "measure runs of the paper's algorithms and collect them in one file"),
        ("sweep", sweep, "train the paper's algorithms with several settings and an equal budget"),
        ("crosscheck", crosscheck, "train learners of another library on the paper's task, and compare them"),
    ):
        command = commands.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
