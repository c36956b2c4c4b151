"""Key files: who may read them, what is refused, and that nothing of a key is ever shown."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import traceback
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP384R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, NoEncryption, PrivateFormat
from cryptography.x509 import load_pem_x509_certificate
from hypothesis import given
from hypothesis import strategies as st

from master.__main__ import main as master_main
from slave.__main__ import main as slave_main
from teleop.errors import Refused
from teleop.protocol.secure import keys
from teleop.protocol.secure.keys import fingerprint, keygen, load_key, parse_fingerprint


@pytest.fixture
def made(tmp_path: Path) -> tuple[Path, str]:
    return keygen(tmp_path / "hand")


def _private_text(path: Path) -> str:
    """The base64 of the private key in a file, on one line."""
    return "".join(path.read_text().split("-----")[2].split())


def text_of(private: Any, locked: Any = NoEncryption()) -> str:  # noqa: B008 - it has no state
    return str(private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, locked).decode())


class TestMaking:
    def test_the_file_is_its_owners_alone_whatever_the_umask_and_beside_a_folder_of_its_name(
        self, tmp_path: Path
    ) -> None:
        """There are folders `master` and `slave` where the two ends' keys are made first: those of the packages."""
        (tmp_path / "slave").mkdir()
        before = os.umask(0)
        try:
            path, _ = keygen(tmp_path / "slave")
        finally:
            os.umask(before)
        assert path == tmp_path / "slave.key"
        assert path.stat().st_mode & 0o777 == 0o600

    def test_the_fingerprint_is_the_sha_256_of_the_certificate_and_two_keys_differ_in_all_but_their_name(
        self, made: tuple[Path, str], tmp_path: Path
    ) -> None:
        path, printed = made
        certificate = load_pem_x509_certificate(path.read_bytes())
        assert printed.replace("-", "") == sha256(certificate.public_bytes(Encoding.DER)).hexdigest()
        one, two = load_key(path), load_key(keygen(tmp_path / "two")[0])
        assert one.fingerprint == printed != two.fingerprint
        assert one.certificate.subject == two.certificate.subject
        assert one.certificate.serial_number != two.certificate.serial_number

    def test_a_key_that_is_there_is_never_overwritten_nor_anything_else_of_that_name_nor_what_a_link_leads_to(
        self, made: tuple[Path, str], tmp_path: Path
    ) -> None:
        path, printed = made
        before = path.read_bytes()
        for name in (path, path.with_suffix("")):
            with pytest.raises(Refused, match=f"never overwritten; its fingerprint is {printed}"):
                keygen(name)
        assert path.read_bytes() == before
        (tmp_path / "notes.key").write_text("mine")
        (tmp_path / "link.key").symlink_to(tmp_path / "nowhere")
        for name in ("notes", "link"):
            with pytest.raises(Refused, match="never overwritten"):
                keygen(tmp_path / name)
        assert (tmp_path / "notes.key").read_text() == "mine"
        assert not (tmp_path / "nowhere").exists()

    def test_on_a_full_disk_nothing_is_left(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(_: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(keys.os, "fsync", full)
        with pytest.raises(Refused, match="No space left on device"):
            keygen(tmp_path / "hand")
        assert list(tmp_path.iterdir()) == []


class TestReading:
    def test_a_file_that_others_may_read_or_change_or_that_another_user_owns_is_refused_and_so_is_a_pipe(
        self, made: tuple[Path, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Its owner could read the key and put another in its place. A stricter mode will do."""
        for mode in (0o640, 0o604, 0o620, 0o602, 0o610, 0o644, 0o777):
            made[0].chmod(mode)
            with pytest.raises(Refused, match="chmod 600"):
                load_key(made[0])
        made[0].chmod(0o400)
        assert load_key(made[0]).fingerprint == made[1]
        os.mkfifo(tmp_path / "pipe.key", 0o600)
        with pytest.raises(Refused, match="is no file"):
            load_key(tmp_path / "pipe.key")
        owner = made[0].stat().st_uid
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
        with pytest.raises(Refused, match=f"owned by the user with the number {owner}.*sudo chown {owner + 1}"):
            load_key(made[0])

    def test_other_kinds_of_keys_and_key_and_certificate_of_different_ends_are_refused(
        self, made: tuple[Path, str], tmp_path: Path
    ) -> None:
        own, certificate = made[0].read_text().split("-----BEGIN CERT")
        foreign = keygen(tmp_path / "other")[0].read_text().split("-----BEGIN CERT")[1]
        ed25519, locked = Ed25519PrivateKey.generate(), BestAvailableEncryption(b"password")
        for private, certified, says in (
            (own, foreign, "do not belong together"), (text_of(ed25519), certificate, "P-256"),
            (text_of(generate_private_key(SECP384R1())), certificate, "P-256"),
            (text_of(ed25519, locked), certificate, "unencrypted"),
        ):
            made[0].write_text(private + "-----BEGIN CERT" + certified)
            with pytest.raises(Refused, match=says):
                load_key(made[0])


class TestSecrecy:
    def test_a_key_shows_its_fingerprint_and_nothing_else_and_is_not_pickled(self, made: tuple[Path, str]) -> None:
        """Nor is one shown again that was pasted for a fingerprint."""
        key = load_key(made[0])
        for shown in (repr(key), str(key), f"{key}", repr([key]), repr({"key": key})):
            assert f"Key(fingerprint='{made[1]}')" in shown
            assert len(shown) < 120
        assert not hasattr(key, "__dict__")
        with pytest.raises(TypeError):
            pickle.dumps(key)
        secret = _private_text(made[0])
        with pytest.raises(Refused) as refused:
            parse_fingerprint(secret)
        assert secret[:12] not in str(refused.value)

    def test_a_damaged_file_is_refused_or_still_the_same_key_and_no_refusal_quotes_it(
        self, made: tuple[Path, str]
    ) -> None:
        path, expected = made
        secret, text = _private_text(path), path.read_text()
        cut = [part for at in range(0, len(text), 11) for part in (
            text[:at], text[at:], text[:at] + "\0" + text[at + 1 :], text[at:] + text[:at])]
        for damaged in (*cut, text.replace("\n", " "), text.replace("EVATE", "X"), secret, text * 2):
            path.write_text(damaged)
            try:
                assert load_key(path).fingerprint == expected
            except Refused as refused:
                said = "".join(traceback.format_exception(refused))
                assert not any(secret[i : i + 12] in said for i in range(0, len(secret), 4))


class TestFingerprints:
    @given(st.binary(max_size=40), st.sampled_from(["", ":", " ", "-"]), st.booleans(), st.sampled_from(
        ["", "SHA256:", "sha256 Fingerprint=", "SHA-256: "]))
    def test_are_read_back_however_they_are_typed(self, der: bytes, between: str, upper: bool, before: str) -> None:
        printed = fingerprint(der)
        bare = printed.replace("-", "")
        written = between.join(bare[i : i + 2] for i in range(0, 64, 2))
        assert parse_fingerprint(before + (written.upper() if upper else written) + "\n") == printed
        assert parse_fingerprint(printed) == printed


class TestTheCommand:
    def test_writes_a_key_and_prints_what_the_other_end_is_told_or_what_to_install(
        self, typed: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        answer = typed("keygen", "hand")
        key = load_key("hand.key")
        assert answer.code == 0
        assert f"--peer-fingerprint {key.fingerprint}\n" in answer.out
        assert "--key hand.key\n" in answer.out
        assert _private_text(Path("hand.key"))[:12] not in answer.out
        as_json = json.loads(typed("keygen", "other", "--json").out)
        assert as_json == {"path": "other.key", "fingerprint": load_key("other.key").fingerprint}
        typed("keygen", "hand").assert_refused("never overwritten")
        monkeypatch.setattr(keys, "find_spec", lambda _: None)
        typed("keygen", "third").assert_refused("pip install 'bilateral-teleop[secure]'")
        assert not Path("third.key").exists()

    def test_an_end_that_is_given_its_own_fingerprint_as_the_peers_is_refused(
        self, capsys: pytest.CaptureFixture[str], tmp_path: Path
    ) -> None:
        """It waited for itself, and then said that the other end had shown another certificate."""
        path, own = keygen(tmp_path / "hand")
        for main, at in ((master_main, "--peer"), (slave_main, "--listen")):
            assert main(["hard_wall", at, "127.0.0.1:9", "--key", str(path), "--peer-fingerprint", own]) == 2
            refusal = capsys.readouterr().err
            assert "this end's own key" in refusal
            assert "printed at the other end" in refusal

    def test_without_the_extra_an_end_that_is_given_a_key_says_what_to_install(
        self, process: Callable[..., subprocess.Popen[str]], ended: Callable[..., Any]
    ) -> None:
        """It ended in a traceback: No module named 'OpenSSL'."""
        code = ("import sys; from importlib.abc import MetaPathFinder\n"
                "class Without(MetaPathFinder):\n"
                "    def find_spec(self, name, path=None, target=None):\n"
                "        if name in ('OpenSSL', 'cryptography'):\n"
                "            raise ModuleNotFoundError(f'No module named {name!r}', name=name)\n"
                "sys.meta_path.insert(0, Without())\n"
                "from teleop.protocol.secure import keys\n"
                "keys.find_spec = lambda _: None\n"
                "import master.__main__, slave.__main__\n"
                "typed = ['127.0.0.1:9', '--key', 'k', '--peer-fingerprint', 'f']\n"
                "for main, at in ((master.__main__.main, '--peer'), (slave.__main__.main, '--listen')):\n"
                "    print(main(['hard_wall', at, *typed]))")
        answer = ended(process("-c", code))
        assert answer.out == "2\n2\n"
        assert answer.err.count("pip install 'bilateral-teleop[secure]'") == 2

    def test_other_commands_load_nothing_of_it(
        self, process: Callable[..., subprocess.Popen[str]], ended: Callable[..., Any]
    ) -> None:
        code = ("import sys; from teleop.__main__ import main; main(['list']); "
                "print(sorted(set(sys.modules) & {'OpenSSL', 'cryptography', 'teleop.protocol.secure'}))")
        assert ended(process("-c", code)).out.endswith("[]\n")
