"""Another package on the index imports as `teleop` too: beside it ours say so in one sentence."""

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from types import ModuleType

import pytest


def test_beside_the_other_teleop_each_package_says_what_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    homes = {name: import_module(name).__file__ for name in ("channel", "master", "slave")}
    monkeypatch.setitem(sys.modules, "teleop", ModuleType("teleop"))
    monkeypatch.delitem(sys.modules, "teleop.version", raising=False)
    for name, home in homes.items():
        spec = spec_from_file_location(f"{name}_again", home)
        assert spec is not None
        assert spec.loader is not None
        with pytest.raises(ImportError, match=f"`{name}` found another package called teleop .* install bilateral"):
            spec.loader.exec_module(module_from_spec(spec))
