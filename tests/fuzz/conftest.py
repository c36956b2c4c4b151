"""What all fuzz tests share, made once."""

from __future__ import annotations

from typing import Any

import pytest

from tests.fuzz.running import foreign


@pytest.fixture(scope="session")
def others() -> list[bytes]:
    """All that other sessions said, in the open."""
    return foreign()


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """Three keys: the master's, the slave's, a stranger's."""
    pytest.importorskip("OpenSSL", reason="pip install 'bilateral-teleop[secure]'")
    from teleop.protocol.secure.keys import keygen, load_key

    folder = tmp_path_factory.mktemp("keys")
    return [load_key(keygen(folder / name)[0]) for name in ("master", "slave", "stranger")]


@pytest.fixture(scope="session")
def recorded(keys: list[Any]) -> list[bytes]:
    """All that two ends with these keys sent in an association before."""
    from tests.fuzz.records import of_another_association

    return of_another_association(keys)
