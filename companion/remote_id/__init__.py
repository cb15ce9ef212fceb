"""Remote ID messages (ASTM F3411-22a) and all their byte formats, without sockets or clocks.

`messages` holds the message types in SI units (`BasicId`, `Location`, `System`, ...). `codec` converts
messages and packs to payloads and back, on top of `wire_messages` and `wire_values`; `frames` converts
payloads to the frames of each transport; `mavlink` converts messages to MAVLink payloads. `authentication`
signs and verifies, `identity` checks identities, and `region.Region` is what a region's law requires of a
broadcast. The subfolders read capture files (`captures`) and check the codec against reference vectors
(`conformance`). This room may import `errors`, `toml_reader` and `geometry` (`ROOMS` in
tests/test_imports.py). Start reading at `messages`, then `codec`.
"""
