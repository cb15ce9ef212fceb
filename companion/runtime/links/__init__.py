"""Byte links to the autopilot (UDP, TCP, serial): non-blocking; they drop data rather than send it late.

`byte_link.Link` is the interface, with `Received` and `LinkTrouble`. `UdpLink`, `TcpLink` and `SerialLink`
implement it; the last two share `stream_link.StreamLink`. `open_link.open_link` makes a link from a string of
the configuration, and `kept_link.KeptLink` reopens a lost link for as long as the flight lasts. `claims`
keeps a second companion from the same vehicle. As part of `companion.runtime` these files may import every
room before it (`ROOMS` in tests/test_imports.py); only `no_vehicle`, which explains to the user why no
vehicle was found, and `udp_link`, which recognises an autopilot's heartbeat, need `autopilot`. Start reading
at `byte_link`, then `kept_link`.
"""
