"""Where scenes are found: built in, of plug-ins, at a path; and whose packages they get."""

from __future__ import annotations

import importlib.metadata
import json
import sys
import types
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import teleop.scene.library
from teleop import Integral, Refused, load_scene
from teleop.__main__ import main
from teleop.scene.knobs import knobs_of
from teleop.scene.library import ROOT, beside, built_in_scenes, import_bundled, known_scenes, scene_function
from teleop.scene.loading import asks_for_trust, check_installed, live_knobs, stored_scene


class TestBuiltIn:
    def test_scenes_say_what_they_are_and_take_only_keywords(self) -> None:
        assert {
            "canonical", "free_motion", "hard_wall", "soft_tissue", "jittery_wan", "burst_loss", "blackout",
            "satellite", "local", "lte",
        } <= set(built_in_scenes())
        for name in built_in_scenes():
            function = scene_function(name)
            assert function.__doc__
            assert function.__doc__.splitlines()[0].endswith("."), name
            assert {"dt", "duration"} <= set(knobs_of(function)), name
            if name != "encoder_wall":  # one experiment, with the law that it is about
                assert {"law", "energy", "observer"} <= set(knobs_of(function)), name

    def test_nothing_else_in_the_folder_is_a_scene(self) -> None:
        for name in ("__init__", "__main__", "_x", "../scenarios/canonical", "a/b", "", "."):
            with pytest.raises(Refused, match="there is no scene"):
                scene_function(name)


class TestAtAPath:
    def test_a_users_own_scene_is_loaded_with_its_knobs_and_a_file_that_is_none_is_refused(
            self, tmp_path: Path) -> None:
        (tmp_path / "my own.py").write_text((ROOT / "scenarios" / "canonical.py").read_text())
        scene = load_scene(str(tmp_path / "my own.py"), delay=0.2)
        assert (scene.name, scene.knobs["delay"]) == ("my own", 0.2)
        for text, words in (("import nonsense_of_mine", "nonsense_of_mine"), ("scene = 3", "no function called"),
                            ("1 / 0", "ZeroDivision")):
            (tmp_path / "mine.py").write_text(text)
            with pytest.raises(Refused, match=words):
                scene_function(str(tmp_path / "mine.py"))


class TestOfPlugIns:
    def test_scenes_are_known_without_being_imported_and_loaded_by_name(self, monkeypatch: pytest.MonkeyPatch) -> None:
        module = types.ModuleType("plugged_in")
        module.scene = load_scene
        entry = importlib.metadata.EntryPoint("theirs", "plugged_in", "teleop.scenes")
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [entry])
        assert "theirs" in known_scenes()
        with pytest.raises(ModuleNotFoundError):
            scene_function("theirs")
        monkeypatch.setitem(sys.modules, "plugged_in", module)
        assert scene_function("theirs") is load_scene


class TestTheHouse:
    def test_is_found_beside_teleop_and_not_taken_from_elsewhere(
            self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        assert Path(import_bundled("channel.delay").__file__).is_relative_to(ROOT)
        stranger = types.ModuleType("slave")
        stranger.__file__ = str(tmp_path / "slave.py")
        monkeypatch.setitem(sys.modules, "slave", stranger)
        for take in (lambda: import_bundled("slave.wall"), lambda: scene_function("canonical")):
            with pytest.raises(Refused, match=r"'slave' was taken from .*slave.py"):
                take()


class TestBesideAScenesFile:
    """A scene said "No module named 'law_mine'" of the file beside it, under `teleop run` alone."""

    @pytest.fixture(autouse=True)
    def _as_before(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        monkeypatch.setattr(teleop.scene.library, "_FOLDERS", [])
        before = set(sys.modules)
        yield
        for name in set(sys.modules) - before:
            del sys.modules[name]

    @staticmethod
    def written(folder: Path, k: float, module: str = "law_mine", scene: str = "mine") -> str:
        folder.mkdir(exist_ok=True)
        (folder / f"{module}.py").write_text(f"K = {k}\n")
        (folder / f"{scene}.py").write_text(f"from {module} import K\n\ndef scene(*, k: float = K): ...\n")
        return str(folder / f"{scene}.py")

    def test_a_module_is_imported_and_the_search_path_and_what_is_installed_stay_as_they_are(
            self, tmp_path: Path) -> None:
        """The scene's folder was left in sys.path, and the root of the packages before all else."""
        before = list(sys.path)
        (tmp_path / "colorsys.py").write_text("raise AssertionError\n")
        (tmp_path / "other.py").write_text("import colorsys\ndef scene(*, k: float = colorsys.ONE_THIRD): ...\n")
        for path, k in ((self.written(tmp_path, 3.0), 3.0), (str(tmp_path / "other.py"), 1.0 / 3.0)):
            assert knobs_of(scene_function(path))["k"][:2] == (float, k)
        assert sys.path == before

    def test_a_module_is_imported_by_a_thread_and_by_a_law_or_scene_that_asks_late(self, tmp_path: Path) -> None:
        (tmp_path / "gains.py").write_text("K = 5.0\n")
        (tmp_path / "late_one.py").write_text("K = 4.0\n")
        (tmp_path / "law_mine.py").write_text("def gain():\n    from gains import K\n    return K\n")
        (tmp_path / "mine.py").write_text(
            "from law_mine import gain\ndef scene():\n    import late_one\n    return gain, late_one.K\n")
        function: Any = scene_function(str(tmp_path / "mine.py"))
        gain, late = function()
        assert late == 4.0
        with ThreadPoolExecutor(1) as one:
            assert one.submit(gain).result() == 5.0

    def test_of_two_scenes_each_has_its_own_and_none_is_given_the_other_ones_module(self, tmp_path: Path) -> None:
        for k, folder in enumerate(("a", "b"), start=1):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / "other.py").write_text("")  # in a's folder too, where nobody asks for it
            path = self.written(tmp_path / folder, float(k), module="other" if folder == "b" else "one")
            assert knobs_of(scene_function(path))["k"][:2] == (float, float(k))
        scene_function(self.written(tmp_path / "a", 1.0))
        with pytest.raises(Refused, match=r"b/mine\.py imports law_mine, and .*a/law_mine\.py has been imported"):
            scene_function(self.written(tmp_path / "b", 2.0))

    def test_it_is_found_whatever_imports_it(self, tmp_path: Path) -> None:
        path = self.written(tmp_path, 1.0)
        (tmp_path / "law_mine.py").write_text("import package, json, gone\nfrom . import nothing\n")
        (tmp_path / "package").mkdir()
        (tmp_path / "package" / "__init__.py").write_text("import law_mine\n")
        assert beside(Path(path)) == {
            "law_mine": tmp_path / "law_mine.py", "package": tmp_path / "package" / "__init__.py"}

    def test_the_command_runs_it(self, tmp_path: Path) -> None:
        text, law = (ROOT / "scenarios" / "hard_wall.py").read_text(), ROOT / "teleop" / "laws" / "direct.py"
        (tmp_path / "law_mine.py").write_text(law.read_text())
        text = text.replace("\n\n\ndef scene", "\nfrom law_mine import Direct\n\n\ndef scene")
        (tmp_path / "mine.py").write_text(text.replace("Wave(b=20.0, K=1000.0, B=20.0)", "Direct()"))
        assert main(["run", str(tmp_path / "mine.py"), "--set", "duration=0.1", "--out", str(tmp_path / "out")]) == 0
        assert json.loads((tmp_path / "out" / "summary.json").read_text())["parameters"]["law"]["name"] == "Direct"


# Scenes as they are loaded: beside the clock, and from a stored folder, whose files are opened for who trusts it


def test_what_runs_by_the_clock_plays_waves_by_their_integral_with_a_link_or_without() -> None:
    """Over `--link none`, which is a real network live, each packet that was lost took its wave with it."""
    assert live_knobs("hard_wall", {}) == {"playout": "integral"}
    assert live_knobs("hard_wall", {"link": "none"}) == {"link": "none", "playout": "integral"}
    assert live_knobs("local", {}) == {"playout": "integral"}
    assert load_scene("local", playout="integral").played_as == Integral()
    assert live_knobs("hard_wall", {"law": "direct"}) == {"law": "direct"}
    assert live_knobs("hard_wall", {"playout": "zero"}) == {"playout": "zero"}
    assert live_knobs("jittery_wan", {}) == {}, "it names its own"


def test_every_built_in_scene_is_made_again_from_its_name() -> None:
    for name in built_in_scenes():
        check_installed(name)
        if name != "lte":  # which has no scene without its recordings
            scene = stored_scene(name, {"duration": "0.5"}, trust=False)
            assert scene.ticks == round(0.5 / scene.dt), name
            assert not asks_for_trust(name, {"duration": "0.5"}), name
    assert not asks_for_trust("canonical", {"link": "delay(0.05) | bernoulli(0.1)"})


def test_whoever_recorded_with_a_file_is_told_that_report_asks_for_trust(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, knobs in (
            ("mine.py", {}), ("folder/mine.py", {}), ("lte", {"up": "a", "down": "b"}),
            ("recorded_reach", {"motion": "my.csv"}), ("canonical", {"link": "ping_log('log')"}),
            ("canonical", {"link": 'delay(0.1) ; mahimahi("trace")'}), ("hard_wall", {"law": "law_mine.py"}),
            ("hard_wall", {"law": "law_mine.py:PositionPosition"}), ("hard_wall", {"law": "/somewhere/else.py"})):
        assert asks_for_trust(name, knobs), (name, knobs)
        with pytest.raises(Refused, match="--trust"):
            stored_scene(name, knobs, trust=False)
