"""The subcommands of `ground-tools atmc`.

`train` runs the training, `evaluate_command` measures a policy with the functions of `evaluate`,
`freeze_command` writes the policy file that flies, and `collect` gathers runs of the paper's algorithms in
one file, whose format is in `results`. `sweep` and `crosscheck` train with other settings and with another
library, and share `kept_runs`. `command` adds all of them to the command line. Modules that need PyTorch
are imported only when a subcommand runs. Start reading with `command`.
"""
