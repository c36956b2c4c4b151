"""Beside the other package called teleop, `master` says what is wrong."""

import sys
from importlib.util import module_from_spec, spec_from_file_location
from types import ModuleType

import pytest

import master


def test_another_teleop_is_told_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "teleop", ModuleType("teleop"))
    monkeypatch.delitem(sys.modules, "teleop.version", raising=False)
    spec = spec_from_file_location("master_again", master.__file__)
    assert spec is not None
    assert spec.loader is not None
    with pytest.raises(ImportError, match=r"another package called teleop .* install bilateral-teleop"):
        spec.loader.exec_module(module_from_spec(spec))
