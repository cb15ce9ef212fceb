"""Ed25519 keys (RFC 8032): reading public keys, verifying, and the public key of a private one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from companion.errors import ConfigError

# Imported only where a key is used, which saves 8 MB on an aircraft without keys.
if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

SIGNATURE_SIZE: Final = 64


def verify(key: bytes, signature: bytes, data: bytes) -> bool:
    """Whether a signature is valid for this public key (32 bytes) and data. Bad forms are not valid."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(key).verify(signature, data)
    except (InvalidSignature, ValueError):
        return False
    return True


def public_bytes(key: Ed25519PrivateKey) -> bytes:
    """The 32 bytes of the public key."""
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


def public_key_hex(text: str, folder: Path) -> str:
    """Return a configured public key as 64 hex digits.

    It is given as hex digits, or as the path (relative to `folder`) of a PEM file.

    Raises:
        ConfigError: the text is neither. The error says what it is instead.
    """
    if is_hex_key(text):
        return text.lower()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_public_key

    path = folder / text
    try:
        key = load_pem_public_key(path.read_bytes())
    except (OSError, ValueError, UnsupportedAlgorithm) as error:
        raise ConfigError(
            f"{text!r}: neither 64 hex digits nor a PEM file of an Ed25519 public key: {error}"
        ) from error
    if not isinstance(key, Ed25519PublicKey):
        raise ConfigError(f"{text!r}: holds a {type(key).__name__}; an Ed25519 public key is needed")
    return key.public_bytes(Encoding.Raw, PublicFormat.Raw).hex()


def is_hex_key(text: str) -> bool:
    """Whether a text is a public key of 64 hex digits."""
    return len(text) == 64 and all(c in "0123456789abcdefABCDEF" for c in text)
