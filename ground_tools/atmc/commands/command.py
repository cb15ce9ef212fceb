"""`ground-tools atmc`: its subcommands."""

from __future__ import annotations

import argparse

from ground_tools.atmc.commands import collect, evaluate_command, freeze_command, train


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Subcommands of `ground-tools atmc`; each sets `run`. None loads PyTorch before it runs."""
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, module, words in (
        ("train", train, "train a policy"),
        ("evaluate", evaluate_command, "what a policy is worth, beside the baselines"),
        ("freeze", freeze_command, "the file that flies, from a training run"),
        ("collect", collect, "the paper's runs, measured and in one file"),
    ):
        command = commands.add_parser(name, help=words, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
