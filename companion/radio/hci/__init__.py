"""A Bluetooth controller, driven with raw HCI: sends BLE 4 and BLE 5 Long Range, and scans for both.

`hci_radio.HciTransport` implements `companion.radio.radio.Radio`; its thread opens a `channel.Channel` (Linux
user channel, UART or TCP) and runs an `HciSession` on it. The session (`session`) is a pure state machine:
`setup` probes and prepares the controller, `advertising.AdvertisingSet` sends frames one by one, and
`reports.Reassembler` joins received reports to whole frames. `packets` and `controller_events` hold the byte
formats of commands and events. The import rules are those of `companion.radio` (`ROOMS` in
tests/test_imports.py); the driver needs `errors`, `events` and `remote_id`. Start reading at `hci_radio`,
then `session`.
"""
