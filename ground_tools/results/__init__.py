"""Provenance of the kept results, and whether the present software still makes them.

Every file in `results` and every policy has a file `NAME.made.json` beside it, which names the command that
made it and holds a digest of the code and data that decide its content (`ground_tools.common.provenance`).
`ground_tools.common.sources` finds that code by following imports. `kept` lists the files with their sources
and with a function that makes a sample of each again, and `command` is `ground-tools results`.
"""
