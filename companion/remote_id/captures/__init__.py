"""Reads Remote ID from capture files (pcap and pcapng) of Bluetooth LE and Wi-Fi.

`remote_id_frames.read_capture` yields `CapturedFrame`s for every frame of the file. Below it, `capture_file`
reads the packets, `ble_link` gets advertising data from Bluetooth LE packets, and `radiotap` reads the header
of captured 802.11 frames. The import rules are those of `companion.remote_id` (`ROOMS` in
tests/test_imports.py). Start reading at `remote_id_frames`.
"""
