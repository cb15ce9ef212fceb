"""Keys for DRIP: made by a command, kept private, and read for a flight."""

from __future__ import annotations

import os
import stat

import pytest
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from companion import config as configuration
from companion.commands.cli import main
from companion.commands.drip_keys import find_signing
from companion.commands.preflight import Preflight
from companion.config import Config, IdentityConfig, RemoteIdConfig, SigningConfig
from companion.errors import ConfigError
from companion.remote_id.drip.det import make_det, parse_det
from companion.remote_id.drip.keys import public_bytes
from companion.remote_id.drip.link import decode_endorsement, endorse
from companion.remote_id.messages import IdType
from companion.runtime.drip_key import make_key, open_signer, read_private_key

NAMES = ("--raa", "16376", "--hda", "10")


def told(capsys):
    """What `remote-id key` prints: identity, public key, and the identity for the configuration."""
    lines = capsys.readouterr().out.splitlines()
    return lines[0].split()[-1], lines[1].split()[-1], lines[2].split('"')[1]


def config_with(path, uas_id="1596F0000DMUCA01", id_type=IdType.SERIAL_NUMBER, **signing):
    section = SigningConfig(key=str(path), raa=16376, hda=10, **signing)
    return Config(
        identity=IdentityConfig(uas_id=uas_id, id_type=id_type), remote_id=RemoteIdConfig(signing=section)
    )


def test_a_key_is_made_private_and_never_overwritten(tmp_path, capsys):
    path = tmp_path / "drip.pem"
    assert main(["remote-id", "key", str(path), *NAMES]) == 0
    det, public, identity = told(capsys)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert parse_det(det) == make_det(bytes.fromhex(public), 16376, 10)
    assert bytes.fromhex(identity) == b"\x01" + parse_det(det).data
    assert parse_det(det).data[-1] != 0, "a Basic ID could not hold it"
    before = path.read_bytes()
    assert main(["remote-id", "key", str(path), *NAMES]) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert path.read_bytes() == before
    assert main(["remote-id", "key", str(path), *NAMES, "--show"]) == 0
    assert told(capsys) == (det, public, identity)


def test_a_registry_endorses_an_aircraft(tmp_path, capsys):
    registry, own = tmp_path / "hda.pem", tmp_path / "own.pem"
    main(["remote-id", "key", str(registry), *NAMES])
    registry_det, registry_key, _ = told(capsys)
    main(["remote-id", "key", str(own), *NAMES])
    det, public, _ = told(capsys)
    asked = ["remote-id", "endorse", str(registry), *NAMES, "--child", det, "--child-key", public]
    assert main([*asked, "--days", "2"]) == 0
    text = capsys.readouterr().out
    made = decode_endorsement(bytes.fromhex(text))
    assert (str(made.parent), str(made.child)) == (registry_det, det)
    assert made.is_signed_by(bytes.fromhex(registry_key))
    assert made.not_after_utc_s - made.not_before_utc_s == 2 * 86_400
    assert main([*asked[:-1], registry_key]) == 2
    assert "is not the DRIP entity tag" in capsys.readouterr().err

    (tmp_path / "own.link").write_text(text)
    path = tmp_path / "aircraft.toml"
    path.write_text(
        f'[identity]\nuas_id = "{"01" + parse_det(det).data.hex()}"\nid_type = 4\n'
        '[remote_id]\nsigning = { key = "own.pem", raa = 16376, hda = 10, links = ["own.link"] }\n'
    )
    loaded = configuration.load(path)
    assert loaded.remote_id.signing.key == str(own)
    assert loaded.remote_id.signing.links == (text.strip(),)
    signer = open_signer(loaded)
    assert str(signer.det) == det
    found = Preflight()
    find_signing(loaded, found)
    assert [f"{f.light.name} {f.text}" for f in found.findings] == [f"GREEN Remote ID is signed as {det}"]
    again = tmp_path / "again.toml"
    again.write_bytes(configuration.dump(loaded))
    assert configuration.load(again) == loaded
    for file in (own, registry):
        secret = read_private_key(file, "x").private_bytes(Encoding.Raw, PrivateFormat.Raw, NoEncryption())
        assert secret.hex().encode() not in again.read_bytes()


def test_a_key_that_others_can_read_is_refused(tmp_path):
    path = tmp_path / "drip.pem"
    make_key(path, 0, 0)
    path.chmod(0o640)
    with pytest.raises(ConfigError, match=r"remote_id\.signing\.key: .*chmod 600"):
        open_signer(config_with(path))


def test_what_is_no_key(tmp_path):
    path = tmp_path / "drip.pem"
    for content in (b"", b"secret words", os.urandom(40)):
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(ConfigError, match="not the PEM file") as refused:
            open_signer(config_with(path))
        assert "secret" not in str(refused.value)
    other = rsa.generate_private_key(65537, 2048)
    path.write_bytes(other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())[:1024])
    with pytest.raises(ConfigError):
        open_signer(config_with(path))
    with pytest.raises(ConfigError, match="no such file"):
        open_signer(config_with(tmp_path / "none.pem"))


def test_the_identity_must_be_that_of_the_key(tmp_path):
    path = tmp_path / "drip.pem"
    det = make_det(public_bytes(make_key(path, 16376, 10)), 16376, 10)
    assert open_signer(config_with(path)).det == det, "beside a serial number"
    assert open_signer(config_with(path, det.identity, IdType.SPECIFIC_SESSION)).det == det
    other = make_det(bytes(32), 16376, 10)
    with pytest.raises(ConfigError, match=r"identity\.uas_id: .* the key of remote_id\.signing is that of"):
        open_signer(config_with(path, other.identity, IdType.SPECIFIC_SESSION))
    assert open_signer(Config(identity=IdentityConfig(uas_id="X"))) is None


def test_what_the_check_before_a_flight_says(tmp_path):
    path = tmp_path / "drip.pem"
    found = Preflight()
    find_signing(config_with(path), found)
    assert not found.ready
    key = make_key(path, 16376, 10)
    det = make_det(public_bytes(key), 16376, 10)
    ended = endorse(key, det, det, public_bytes(key), 1_600_000_000, 1_600_000_001).encode().hex()
    for links, words in (((), "no registry endorses"), ((ended,), "is not valid now")):
        found = Preflight()
        find_signing(config_with(path, links=links), found)
        assert words in found.findings[1].text
        assert found.ready
    found = Preflight()
    find_signing(Config(identity=IdentityConfig(uas_id="X")), found)
    assert not found.findings


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ('signing = { key = "a", raa = 16384, hda = 0 }', "remote_id.signing.raa"),
        ('signing = { key = "a", raa = 0, hda = 0, links = ["none"] }', "links[0]: 'none': neither"),
        ('signing = { key = "a", raa = 0, hda = 0, period_s = 4.0 }', "period_s"),
    ],
)
def test_wrong_keys_of_the_section_are_named(tmp_path, lines, words):
    path = tmp_path / "aircraft.toml"
    path.write_text(f'[identity]\nuas_id = "X"\n[remote_id]\n{lines}\n')
    with pytest.raises(ConfigError) as refused:
        configuration.load(path)
    assert words in str(refused.value)


def test_a_module_alone_cannot_sign(tmp_path):
    path = tmp_path / "aircraft.toml"
    path.write_text(
        '[identity]\nuas_id = "X"\n[remote_id]\nsigning = { key = "a", raa = 0, hda = 0 }\n'
        '[[radio]]\nbackend = "arduremoteid"\nlink = "serial:/dev/ttyACM0:57600"\n'
    )
    with pytest.raises(ConfigError, match=r"remote_id\.signing: no \[\[radio\]\] sends signatures"):
        configuration.load(path)
