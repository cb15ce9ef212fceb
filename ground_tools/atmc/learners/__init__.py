"""The algorithms that train ATMC policies, and the training loop.

`learner.Learner` is the interface of an algorithm, `algorithms.ALGORITHMS` is the table of all algorithms,
and `training.train` runs one of them and writes its run folder. `madqn`, `maddpg` and `iac` are the
algorithms of the paper; they share `paper_learner`, they use the flat networks of `flat`, and the first two
use the replay buffer of `replay_buffer`. `flying_policy` trains the set network of `set_network`, which
flies. Start reading with `learner` and `training`, then one algorithm, such as `madqn`.
"""
