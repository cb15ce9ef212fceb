"""The command line: `companion run`, `init`, `check`, `status`, `display`, `bench-test`, `replay`,
`remote-id`.

`cli` parses the arguments and calls the subcommands, and `entry_point` holds what all commands of this
project share, such as exit codes and one-line errors. `check` is the preflight list, made of the `Finding`s
of `preflight.Preflight`; `status` shows the live state of a running flight; `listen` shows received aircraft
from a `heard_table.HeardTable`; `remote_id` encodes, decodes and checks messages. This room is the last but
`__main__` in `ROOMS` of tests/test_imports.py and may import every other room; within companion only
`__main__` may import it. Modules that load the compiler are imported only in the subcommands that need it.
Start reading at `cli.main`.
"""
