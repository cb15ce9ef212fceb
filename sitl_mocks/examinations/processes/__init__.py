"""The router between a companion in its own process and the simulated vehicle, in real time.

`wire` routes the bytes, delays them as the modelled link does, and has them judged. It reaches companions
through `companion_ends` (UDP, TCP, serial) and learns from `decisions` when a command was decided.
`pilot_link` is the pilot's own link to the vehicle, and `stopped_process` stops and continues a process.
"""
