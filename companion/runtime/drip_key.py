"""Makes and reads private keys for DRIP, and opens the signer that a configuration asks for."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from companion.broadcast.signer import Signer
from companion.config import Config
from companion.errors import ConfigError
from companion.remote_id.drip.det import Det, det_of, make_det
from companion.remote_id.drip.hashes import HASH_SIZE
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import decode_endorsement
from companion.remote_id.messages import IdType
from companion.runtime.signing_key import private_bytes

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey


def make_key(path: Path, raa: int, hda: int) -> Ed25519PrivateKey:
    """Make a private key and write it to a new file that only its owner may read.

    A key whose DET ends with a zero byte is discarded, because a Basic ID cannot tell that byte from padding.

    Raises:
        ConfigError: the file exists, or cannot be written.
        ValueError: an authority is out of range.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    while True:
        key = Ed25519PrivateKey.generate()
        if make_det(public_bytes(key), raa, hda).data[-1]:
            break
    text = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(text)
    except FileExistsError as error:
        raise ConfigError(f"{path}: exists; a key is never overwritten") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return key


def read_private_key(path: Path, key: str) -> Ed25519PrivateKey:
    """Read a private key from a PEM file.

    Args:
        key: key of the configuration, or option, that names the file.

    Raises:
        ConfigError: the file cannot be read, is accessible to others than its owner, or holds no Ed25519 key.
            No error text repeats the content of the file.
    """
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    data = private_bytes(path, key)
    try:
        loaded = load_pem_private_key(data, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise ConfigError(f"{key}: {path}: not the PEM file of a private key without a password") from None
    if not isinstance(loaded, Ed25519PrivateKey):
        raise ConfigError(f"{key}: {path}: holds a {type(loaded).__name__}; an Ed25519 key is needed")
    return loaded


def open_signer(config: Config) -> Signer | None:
    """The signer of a configuration; None if it asks for none.

    Raises:
        ConfigError: the key cannot be read, or does not fit the identity or the links.
    """
    signing = config.remote_id.signing
    if signing is None:
        return None
    key = read_private_key(Path(signing.key), "remote_id.signing.key")
    det = make_det(public_bytes(key), signing.raa, signing.hda)
    _check_identity(config, det)
    links = [decode_endorsement(bytes.fromhex(link)) for link in signing.links]
    try:
        return Signer(key, det, links, signing.period_s, os.urandom(HASH_SIZE))
    except ValueError as error:
        raise ConfigError(f"remote_id.signing.links: {error}") from error


def _check_identity(config: Config, det: Det) -> None:
    claimed = det_of(config.identity.uas_id) if config.identity.id_type is IdType.SPECIFIC_SESSION else None
    if claimed is not None and claimed != det:
        raise ConfigError(
            f"identity.uas_id: {claimed}; the key of remote_id.signing is that of {det}: write "
            f"{det.identity.encode('latin-1').hex()}"
        )
