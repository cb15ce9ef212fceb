"""Training and evaluation of policies for adaptive transmission mode configuration (ATMC).

A policy chooses on which transports an aircraft sends its Remote ID, and at which rates. `env` is the
simulated environment with the analytic channel model and the objectives. `learners` holds the training
algorithms: the paper's (MADQN-ATMC, MADDPG, IAC) and the set network that flies. `commands` holds the
subcommands of `ground-tools atmc`: train, evaluate, freeze and collect. The result is a frozen policy file,
which `companion.atmc` loads on the aircraft without PyTorch. Start reading with `env.environment.Env`, then
`learners.flying_policy`; docs/atmc.md reports the results.
"""
