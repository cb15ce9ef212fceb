"""The simulated radio: real Remote ID frames to and from the simulated air, over UDP on loopback.

`ether_radio.EtherTransport` implements `companion.radio.radio.Radio`. `datagrams` defines the protocol
between the simulated air and its clients, with one type for each datagram (`Join`, `Leave`, `Send`, `Heard`,
`Welcome`). The import rules are those of `companion.radio` (`ROOMS` in tests/test_imports.py); the driver
needs `errors`, `events` and `remote_id`. Start reading at `datagrams`, whose docstring has the byte format.
"""
