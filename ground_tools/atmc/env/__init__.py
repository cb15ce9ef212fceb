"""The environment in which ATMC policies are trained and measured, on PyTorch, for many fleets at once.

`environment.Env` joins a `world.World` (positions, motion, shadowing, load), a `channel.TorchChannel` (the
analytic channel equations) and an `objective.Objective` (what the fleet's actions cost). `deciders` defines
the `Decider` protocol with the baselines, and `search` is the centralised reference with full knowledge.
`paper_task` is the paper's task with its measurement, and `parallel_env` adapts the environment to
PettingZoo. Start reading with `environment`, then `objective`.
"""
