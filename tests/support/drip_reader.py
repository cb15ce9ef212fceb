"""An independent reader of DRIP, written from the text of the standards; it uses no code of `companion`.

Keccak-f[1600] and the sponge are those of FIPS 202, cSHAKE128 that of NIST SP 800-185 section 3, the identity
that of RFC 9374 section 3.5.2, and the messages those of draft-ietf-drip-auth-49 (RFC 9575). Only Ed25519
comes from a library.
"""

from __future__ import annotations

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

EPOCH = 1546300800
MASK = (1 << 64) - 1


def _rol(x: int, n: int) -> int:
    n %= 64
    return ((x << n) | (x >> (64 - n))) & MASK


def _round_constants() -> list[int]:
    register, constants = 1, []
    for _ in range(24):
        constant = 0
        for j in range(7):
            if register & 1:
                constant |= 1 << ((1 << j) - 1)
            register = (register << 1) ^ (0x171 if register & 0x80 else 0)
        constants.append(constant)
    return constants


_RC = _round_constants()


def keccak_f(a: list[list[int]]) -> list[list[int]]:
    """FIPS 202 section 3.3 on lanes a[x][y]."""
    for constant in _RC:
        c = [a[x][0] ^ a[x][1] ^ a[x][2] ^ a[x][3] ^ a[x][4] for x in range(5)]
        d = [c[(x - 1) % 5] ^ _rol(c[(x + 1) % 5], 1) for x in range(5)]
        a = [[a[x][y] ^ d[x] for y in range(5)] for x in range(5)]
        b = [[0] * 5 for _ in range(5)]
        x, y, lane = 1, 0, a[1][0]
        b[0][0] = a[0][0]
        for t in range(24):
            new_x, new_y = y, (2 * x + 3 * y) % 5
            b[new_x][new_y] = _rol(a[x][y], (t + 1) * (t + 2) // 2)
            x, y = new_x, new_y
        del lane
        a = [[b[x][y] ^ (~b[(x + 1) % 5][y] & MASK & b[(x + 2) % 5][y]) for y in range(5)] for x in range(5)]
        a[0][0] ^= constant
    return a


def sponge(data: bytes, suffix: int, size: int) -> bytes:
    """Keccak with rate 168 bytes; the output is at most one block here."""
    padded = bytearray(data) + bytes((suffix,))
    padded += bytes(-len(padded) % 168)
    padded[-1] |= 0x80
    state = [[0] * 5 for _ in range(5)]
    for start in range(0, len(padded), 168):
        block = padded[start : start + 168]
        for i in range(21):
            state[i % 5][i // 5] ^= int.from_bytes(block[8 * i : 8 * i + 8], "little")
        state = keccak_f(state)
    out = b"".join(state[i % 5][i // 5].to_bytes(8, "little") for i in range(21))
    return out[:size]


def _left_encode(x: int) -> bytes:
    body = x.to_bytes(max(1, (x.bit_length() + 7) // 8), "big")
    return bytes((len(body),)) + body


def cshake128(data: bytes, size: int, custom: bytes) -> bytes:
    """SP 800-185 section 3.3 with an empty function name."""
    head = _left_encode(0) + _left_encode(8 * len(custom)) + custom
    head = _left_encode(168) + head
    head += bytes(-len(head) % 168)
    return sponge(head + data, 0x04, size)


def det_is_of(det: bytes, key: bytes) -> bool:
    context = bytes.fromhex("00B5A69C795DF5D5F0087F56843F2C40")
    prefix = int.from_bytes(det, "big") >> 100
    return prefix == 0x2001003 and det[7] == 5 and cshake128(det[:8] + key, 8, context) == det[8:]


def message_hash(data: bytes) -> bytes:
    return cshake128(data, 8, b"Remote ID Auth Hash")


def is_signed(key: bytes, signature: bytes, data: bytes) -> bool:
    try:
        Ed25519PublicKey.from_public_bytes(key).verify(signature, data)
    except InvalidSignature:
        return False
    return True


def payload(pages: dict[int, bytes]) -> bytes | None:
    """Authentication data from page payloads of 23 bytes, with one page restored by XOR where possible."""
    pages = dict(pages)
    if 0 not in pages:
        return None
    last, length = pages[0][0], pages[0][1]
    missing = [n for n in range(last + 1) if n not in pages]
    needed = -(-(6 + length) // 23)
    has_parity = last + 1 > needed
    if len(missing) == 1 and has_parity and missing[0] != last:
        restored = bytes(23)
        for page in pages.values():
            restored = bytes(a ^ b for a, b in zip(restored, page, strict=True))
        pages[missing[0]] = restored
    if any(n not in pages for n in range(needed)):
        return None
    return b"".join(pages[n] for n in range(needed))[6 : 6 + length]


class Reader:
    """Receives the messages of one aircraft. `outcomes` holds the result for each Authentication message."""

    def __init__(self, anchors: dict[bytes, bytes]) -> None:
        self.anchors = anchors
        self.keys: dict[bytes, bytes] = {}
        self.seen: set[bytes] = set()
        self.locations: set[bytes] = set()
        """Hashes of Locations, or of packs with one."""
        self.pages: dict[int, bytes] = {}
        self.outcomes: list[str] = []
        self.proven: list[bytes] = []
        """Hash of each Location, or pack with one, that a Manifest covered."""

    def hear(self, raw: bytes, utc_s: float) -> None:
        """Process a message of 25 bytes (BLE 4), or a message pack."""
        if raw[0] >> 4 == 0xF:
            messages = [raw[3 + 25 * k : 28 + 25 * k] for k in range(raw[2])]
            if any(m[0] >> 4 == 1 for m in messages):
                self.locations.add(message_hash(raw))
            self.seen.add(message_hash(raw))
            pages = {m[1] & 15: m[2:] for m in messages if m[0] >> 4 == 2}
            if pages:
                self._take(pages, utc_s)
            return
        if raw[0] >> 4 != 2:
            self.seen.add(message_hash(raw))
            if raw[0] >> 4 == 1:
                self.locations.add(message_hash(raw))
            return
        if raw[1] & 15 == 0:
            self.pages = {}
        self.pages[raw[1] & 15] = raw[2:]
        if 0 in self.pages and raw[1] & 15 == self.pages[0][0]:
            self._take(self.pages, utc_s)

    def _take(self, pages: dict[int, bytes], utc_s: float) -> None:
        data = payload(pages)
        self.outcomes.append("incomplete" if data is None else self._read(data, utc_s))

    def _read(self, data: bytes, utc_s: float) -> str:
        kind, body = data[0], data[1:]
        begin, end = (EPOCH + int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
        signature, signed = body[-64:], body[:-64]
        if kind == 1:
            child, key, parent = body[8:24], body[24:56], body[56:72]
            if parent not in self.anchors:
                return "stranger's link"
            if not begin - 5 <= utc_s <= end or not det_is_of(child, key):
                return "bad link"
            if not is_signed(self.anchors[parent], signature, signed):
                return "bad link"
            self.keys[child] = key
            return "link"
        evidence, det = body[8:-80], body[-80:-64]
        if det not in self.keys:
            return "no key"
        if not is_signed(self.keys[det], signature, signed):
            return "bad signature"
        if not begin - 5 <= utc_s <= end:
            return "out of its window"
        if kind != 3:
            return "other"
        hashes = [evidence[k : k + 8] for k in range(0, len(evidence), 8)]
        if message_hash(hashes[0] + bytes(8) + b"".join(hashes[2:])) != hashes[1]:
            return "bad manifest"
        self.proven += [h for h in hashes[3:] if h in self.locations]
        return "manifest" if all(h in self.seen for h in hashes[3:]) else "manifest with unheard messages"
