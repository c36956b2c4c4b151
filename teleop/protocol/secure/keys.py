"""Identity of an end: a private key and its certificate in one file, and the fingerprint that the other end pins.

`teleop keygen NAME` writes `NAME.key`, one PEM file that only its owner may read: an EC key on P-256 and a certificate
that it signed itself. No authority's signature is needed: each end is told the other's fingerprint, the SHA-256 of the
certificate, and takes that certificate and no other. So a certificate never runs out, since what an end with a wrong
clock makes of a date must not decide whether it is let in; a key is replaced by making another and telling the other
end. The certificate has the same name in it whoever made it, because it crosses the network before the encryption
begins.
"""

from __future__ import annotations

import os
import re
import stat
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from teleop.errors import Refused

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
    from cryptography.x509 import Certificate

SUFFIX = ".key"
_DIGITS, _GROUP = 64, 8  # of a fingerprint, in hexadecimal
_MOST = 65_536  # bytes of a key file
_NAME = "bilateral-teleop"
_EXAMPLE = "-".join(["0123abcd"] * (_DIGITS // _GROUP))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Key:
    """An end's key and certificate. Its text form shows the fingerprint, which is public, and nothing else."""

    fingerprint: str
    private: EllipticCurvePrivateKey = field(repr=False)
    certificate: Certificate = field(repr=False)


def need_secure() -> None:
    """Refuse where nothing can be encrypted, before anything is done."""
    if find_spec("OpenSSL") is None or find_spec("cryptography") is None:
        raise Refused("keys and encryption need pyOpenSSL and cryptography: pip install 'bilateral-teleop[secure]'")


def fingerprint(certificate: bytes) -> str:
    """The SHA-256 of a certificate (DER) as people compare it: eight groups of eight hexadecimal digits.

    >>> fingerprint(b"")[:26]
    'e3b0c442-98fc1c14-9afbf4c8'
    """
    return _grouped(sha256(certificate).hexdigest())


def parse_fingerprint(text: str) -> str:
    """The fingerprint that was typed, in the form of `fingerprint`. Raises `Refused`.

    Letters may be of either case; hyphens, colons and spaces may stand anywhere, or nowhere; what `openssl x509
    -fingerprint -sha256` prints is taken whole.

    >>> parse_fingerprint("SHA256:" + "E3:B0:C4:42:" * 8)[:17]
    'e3b0c442-e3b0c442'
    """
    bare = re.sub(r"(?i)^\s*sha-?256( fingerprint)?\s*[:=]", "", text)
    digits = re.sub(r"[-:\s]", "", bare).lower()
    if not re.fullmatch(r"[0-9a-f]*", digits):
        wrong = "has letters in it that no hexadecimal number has"
    elif len(digits) == _DIGITS:
        return _grouped(digits)
    else:
        wrong = f"has {len(digits)} hexadecimal digits where a SHA-256 has {_DIGITS}"
    # The text itself is not shown: it may be a key that was pasted in the wrong place.
    raise Refused(f"what was given as the peer's fingerprint is none: it {wrong}; copy the line that `teleop keygen` "
                  f"printed at the other end, of the form {_EXAMPLE}")


def keygen(path: str | Path) -> tuple[Path, str]:
    """Make a key and a certificate; where they were written, and the fingerprint. Raises `Refused`.

    `path`: the file, with its `.key` or without. One that is there stays as it is. The file is its owner's alone from
    the moment it exists, and is gone if it could not be written whole.
    """
    need_secure()
    from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    path = Path(path)
    if not path.name:
        raise Refused(f"{str(path)!r} names no file; write for example: teleop keygen slave")
    path = path.with_name(path.name.removesuffix(SUFFIX) + SUFFIX)
    private = generate_private_key(SECP256R1())
    certificate = _self_signed(private)
    text = private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    _write(path, text + certificate.public_bytes(Encoding.PEM))
    return path, fingerprint(certificate.public_bytes(Encoding.DER))


def load_key(path: str | Path) -> Key:
    """The key in a file that `keygen` wrote. Raises `Refused`, in whose text nothing of the key is ever shown.

    Refused are a file that another user owns, one that others than its owner may read or change, and one that is not a
    P-256 key and, after it, the certificate of that key.
    """
    need_secure()
    from cryptography.exceptions import UnsupportedAlgorithm
    from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key
    from cryptography.x509 import load_pem_x509_certificate

    text = _read(Path(path))
    cure = f"make a new one with: teleop keygen NAME, and pass --key NAME{SUFFIX}"
    try:
        private = load_pem_private_key(text, None)
        certificate = load_pem_x509_certificate(text)
        public = certificate.public_key()
    except (ValueError, TypeError, UnsupportedAlgorithm):  # their texts may quote what they read
        raise Refused(f"{path} is not a key and its certificate, unencrypted, in one PEM file; {cure}") from None
    if not isinstance(private, EllipticCurvePrivateKey) or not isinstance(private.curve, SECP256R1):
        raise Refused(f"{path} holds a key that is not on the curve P-256, the only one in use here; {cure}")
    if public != private.public_key():
        raise Refused(f"the key and the certificate in {path} do not belong together; {cure}")
    return Key(fingerprint=fingerprint(certificate.public_bytes(Encoding.DER)), private=private,
               certificate=certificate)


def _self_signed(private: EllipticCurvePrivateKey) -> Certificate:
    from cryptography.hazmat.primitives.hashes import SHA256
    from cryptography.x509 import CertificateBuilder, Name, NameAttribute, random_serial_number
    from cryptography.x509.oid import NameOID

    name = Name([NameAttribute(NameOID.COMMON_NAME, _NAME)])
    builder = CertificateBuilder().subject_name(name).issuer_name(name).public_key(private.public_key())
    # The last date is what RFC 5280, 4.1.2.5, has for a certificate that does not run out.
    builder = builder.not_valid_before(datetime(1970, 1, 1)).not_valid_after(datetime(9999, 12, 31, 23, 59, 59))
    return builder.serial_number(random_serial_number()).sign(private, SHA256())


def _write(path: Path, text: bytes) -> None:
    try:
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise Refused(f"{path} is there already, and a key is never overwritten; {_there(path)}") from None
    except OSError as error:
        raise Refused(f"cannot write {path} ({error.strerror}); name a file in a folder that is there and that you "
                      f"may write to") from None
    try:
        with open(file, "wb") as out:
            out.write(text)
            out.flush()
            os.fsync(out.fileno())
    except OSError as error:
        with suppress(OSError):
            path.unlink()
        raise Refused(f"could not write {path} ({error.strerror}), so nothing was left there; free some space, or "
                      f"name a file on another disk") from None


def _there(path: Path) -> str:
    """Advice for a file that is in the way."""
    try:
        return f"its fingerprint is {load_key(path).fingerprint}; to use another key, give another name"
    except Refused:
        return "give another name, or remove it"


def _read(path: Path) -> bytes:
    try:
        # Without O_NONBLOCK a pipe of that name would wait for its writer.
        file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except FileNotFoundError:
        raise Refused(f"there is no key file {path}; make it with: teleop keygen {path.stem or 'NAME'}") from None
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "no file has such a name"
        raise Refused(f"cannot read the key file {path} ({why}); give one that you may read") from None
    try:
        status = os.fstat(file)  # of what was opened: the name may lead elsewhere by now
        if not stat.S_ISREG(status.st_mode):
            raise Refused(f"{path} is no file; give the {SUFFIX} file that `teleop keygen` wrote")
        if os.name == "posix" and status.st_uid != os.geteuid():
            # The owner of a file may read and replace it at any time, whatever its mode says.
            raise Refused(f"{path} is owned by the user with the number {status.st_uid}, and this process runs as user "
                          f"{os.geteuid()}, so its owner can read and replace the key; make one of your own with: "
                          f"teleop keygen NAME, or if the file is yours: sudo chown {os.geteuid()} {path}")
        if os.name == "posix" and status.st_mode & 0o077:
            raise Refused(f"others than its owner may read or change {path}, so it may not be secret any more; make a "
                          f"new key, or if you know that no other user has read it: chmod 600 {path}")
        return os.read(file, _MOST)
    except OSError as error:
        raise Refused(f"cannot read the key file {path} ({error.strerror}); give one that you may read") from None
    finally:
        os.close(file)


def _grouped(digits: str) -> str:
    return "-".join(digits[i : i + _GROUP] for i in range(0, _DIGITS, _GROUP))
