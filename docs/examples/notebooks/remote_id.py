# %% [markdown]
# # Remote ID in ten lines
#
# A message of ASTM F3411 becomes bytes, then a frame of a transport, and a message again.

# %%
from companion.remote_id import Location, Status, build_beacon, encode, encode_pack

message = Location(status=Status.AIRBORNE, lat_deg=47.397, lon_deg=8.545, alt_geodetic_m=430.0, speed_mps=5.0)
pack = encode_pack([message])
beacon = build_beacon(pack, counter=7, address="02:00:00:00:00:01", ssid="drone")
print(len(encode(message)), len(pack), len(beacon))

# %% [markdown]
#     25 28 81
#
# What is received is untrusted: bytes that cannot be read raise `companion.errors.PeerDataError`, and
# nothing else.

# %%
from companion.remote_id import WIFI_BEACON, parse_frame, read_payload

frame = parse_frame(WIFI_BEACON, beacon)
(heard,) = read_payload(frame.payload).messages
print(frame.address, frame.counter, heard.lat_deg, heard.speed_mps)

# %% [markdown]
#     02:00:00:00:00:01 7 47.397 5.0
#
# A capture of many frames, as tshark and Wireshark write it, is read the same way. This one is made
# here: a header (link type 105, 802.11), and the beacon twice, the second time cut off in the middle.

# %%
import io
import struct

from companion.remote_id.captures.remote_id_frames import read_capture

capture = struct.pack("<IHHIIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 105)
for second, data in enumerate((beacon, beacon[:60])):
    capture += struct.pack("<IIII", 1_767_225_600 + second, 0, len(data), len(data)) + data
for captured in read_capture(io.BytesIO(capture), "made here"):
    print(captured.number, captured.kind.value, len(captured.messages), captured.faults)

# %% [markdown]
#     1 Remote ID 1 ()
#     2 Remote ID 0 ('pack of 1 messages cut short: 7 bytes hold 0',)
