"""Remote ID on Wi-Fi with a Linux card: beacons by hostapd, injected frames, and monitor mode.

`wifi_radio.WifiTransport` implements `companion.radio.radio.Radio`. It uses `hostapd.HostapdControl`, which
sets the vendor element in the beacons of a running access point, and `packet_socket.PacketSocket`, which
sends and receives raw 802.11 frames on a monitor interface. The import rules are those of `companion.radio`
(`ROOMS` in tests/test_imports.py); these files need `errors`, `events` and `remote_id`. Start reading at
`wifi_radio`.
"""
