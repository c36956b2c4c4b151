"""A live run that is run again: to the bit, or where it differs; open loop; and as a link in virtual time."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from channel.recorded import Recorded
from slave.wall import Wall
from teleop import Device, Encoder, Fixed, Integral, LowPass, Playout, Refused, Result, Zero, load_scene, run
from teleop.__main__ import main
from teleop.live.records.inputs import ARRIVALS, INPUTS
from teleop.live.records.reader import TruncatedRecord, read_record
from teleop.live.records.record import read_events
from teleop.live.replay.rerun import command_open_loop, difference, read_end
from teleop.scene.playout import as_typed
from tests.live.conftest import Pair
from tests.live.recording import Recording
from tests.teleop.conftest import Answer
from tests.teleop.protocol.virtual_clock import MS, healing

pytestmark = pytest.mark.live


@pytest.fixture
def typed(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Answer]:
    """`typed(*arguments)`: `teleop replay ARGUMENTS` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Answer:
        code = main(["replay", *map(str, arguments)])
        return Answer(code, *capsys.readouterr())

    return call


def test_a_live_run_is_run_again_to_the_bit(lossy: Path, typed: Callable[..., Answer]) -> None:
    said = typed(lossy)
    assert (said.code, said.err) == (0, "")
    for name in ("master", "slave"):
        assert f"{name}   " in said.out
    assert said.out.count("forces and messages the same to the bit") == 2
    one = typed(lossy / "slave", "--json")
    document = json.loads(one.out)
    assert (one.code, document["status"], document["slave"]["difference"]) == (0, "same", None)
    assert document["slave"]["ticks"] == json.loads((lossy / "slave" / "summary.json").read_text())["ticks"]
    assert "master" not in document


@pytest.mark.parametrize(("column", "field"), [
    ("x_m", "x_m"), ("v_m", "f_m"), ("gain", "f_m"), ("tx", "tx.u"), ("f_m", "f_m"),
])
def test_one_number_that_is_another_is_named_with_its_tick(
    column: str, field: str, lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    folder = tmp_path / "m"
    shutil.copytree(lossy / "master", folder)
    scene = load_scene("hard_wall", **json.loads((lossy / "master" / INPUTS).read_bytes().split(b"\n")[0])["knobs"])
    end = read_end(folder, scene)
    rows = end.inputs.rows.part(0, end.ticks).copy()
    at = end.ticks - 3
    rows[at, end.inputs.places[column]] += 1e-6
    header = (folder / INPUTS).read_bytes().split(b"\n", 1)[0]
    (folder / INPUTS).write_bytes(header + b"\n" + rows.astype("<f8").tobytes())
    said = typed(folder, "--json")
    found = json.loads(said.out)
    assert (said.code, found["status"]) == (1, "differs")
    assert (found["master"]["difference"]["k"], found["master"]["difference"]["field"]) == (int(rows[at, 0]), field)
    assert f"differs at tick {int(rows[at, 0])}" in typed(folder).out


def test_open_loop_the_same_law_commands_what_it_did_whatever_the_messages_come_from(
    lossy: Path, typed: Callable[..., Answer]
) -> None:
    """With both ends the messages are sent anew and take the recorded way; alone, they are the recorded ones."""
    for folder, heard in ((lossy, "exchanged"), (lossy / "master", "recorded")):
        document = json.loads(typed(folder, "--set", f"law.b={load_scene('hard_wall').law.b}", "--json").out)
        assert document["status"] == "open loop"
        assert "open loop" in document["sentence"]
        assert document["master"]["heard"] == heard
        assert document["master"]["force"]["greatest_difference"] == 0.0
        assert document["master"]["force"]["rms"] > 0.01


def test_another_law_says_what_it_would_have_commanded_and_draws_it(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    pytest.importorskip("matplotlib")
    said = typed(lossy, "--set", "law=pfra", "--plot", "--out", "mine")
    assert (said.code, said.err) == (0, "")
    assert "open loop: each end reads the motion that was recorded" in said.out
    assert (tmp_path / "mine" / "replay.png").is_file()
    with np.load(tmp_path / "mine" / "forces.npz") as forces:
        apart = np.abs(forces["f_s_commanded"] - forces["f_s_recorded"])[:, 0]
        at = forces["t_s"][int(np.argmax(apart))]
    own = json.loads((tmp_path / "mine" / "summary.json").read_text())["slave"]["force"]
    assert own["greatest_difference"] == apart.max() > 0.1
    assert own["at"] == at
    assert own["rms_difference"] == pytest.approx(float(np.sqrt(np.mean(apart**2))))


def test_what_cannot_be_replayed_is_refused_in_one_sentence(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    shutil.copytree(lossy / "master", tmp_path / "old")
    (tmp_path / "old" / INPUTS).unlink()
    mine = tmp_path / "law_mine.py"
    mine.write_text("from teleop.laws.wave import Wave\n\n\nclass Mine(Wave):\n    pass\n")
    for words, sentence in (
        (["nowhere"], "nowhere holds no record of a live end; give the folder"),
        ([tmp_path / "old"], "holds no inputs.bin to run again (No such file"),
        ([lossy / "master", "--set", "law=pfra"], "the master heard w of the law wave, and the law pfra hears f_env"),
        ([lossy, "--set", "dt=0.002"], "the record has the ticks and the axes of its run"),
        ([lossy, "--set", "nonsense=1"], "nonsense"),
        ([lossy / "slave", lossy / "master"], "give the master's folder first"),
    ):
        said = typed(*words)
        said.assert_refused(sentence)


def test_a_scene_in_a_file_of_its_own_is_replayed_with_trust_alone(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    folder, scene = tmp_path / "m", tmp_path / "mine.py"
    shutil.copytree(lossy / "master", folder)
    scene.write_text("from scenarios.hard_wall import scene as scene\n")
    for name in (INPUTS, "record.bin"):
        first, rows = (folder / name).read_bytes().split(b"\n", 1)
        (folder / name).write_bytes(json.dumps({**json.loads(first), "scene": str(scene)}).encode() + b"\n" + rows)
    said = typed(folder)
    assert said.code == 2
    assert "add --trust" in said.err
    assert "the same to the bit" in typed(folder, "--trust").out


def test_a_record_that_is_cut_off_is_replayed_as_far_as_it_goes_and_says_so(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    folder = tmp_path / "m"
    shutil.copytree(lossy / "master", folder)
    (folder / INPUTS).write_bytes((folder / INPUTS).read_bytes()[:-1000])
    said = typed(folder, "--json")
    document = json.loads(said.out)
    assert (said.code, document["status"]) == (0, "same")
    assert 0 < document["master"]["ticks"] < len(read_record(folder)[1].ticks)
    assert "cut off in the middle of a row" in document["notes"][0]


def test_messages_that_no_folder_has_in_open_loop_are_told_of_and_each_note_once(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    """Of a slave that was killed and started again its last folder alone was given: silence, and no word of it."""
    folder = tmp_path / "run"
    shutil.copytree(lossy, folder)
    inputs, record = folder / "slave" / INPUTS, folder / "master" / "record.bin"
    inputs.write_bytes(inputs.read_bytes()[: inputs.stat().st_size // 2])
    record.write_bytes(record.read_bytes()[:-1])
    document = json.loads(typed(folder, "--set", "law.b=21", "--json").out)
    whole = json.loads(typed(lossy, "--set", "law.b=21", "--json").out)
    assert len(document["notes"]) == len({*document["notes"]}) == 3
    told = document["notes"][2]
    assert told.startswith("master: ")
    assert "came from ticks that the other folder does not have" in told
    assert 100 < int(told.split()[1]) < whole["slave"]["ticks"]
    assert whole["notes"] == []


def test_whatever_a_folder_of_others_holds_a_replay_ends_in_an_answer_or_in_one_sentence(
    lossy: Path, tmp_path: Path, typed: Callable[..., Answer]
) -> None:
    dice, codes = Random(3), set()
    for i in range(16):
        folder = tmp_path / str(i)
        shutil.copytree(lossy, folder)
        file = folder / dice.choice(("master", "slave")) / dice.choice((INPUTS, ARRIVALS, "record.bin"))
        data = bytearray(file.read_bytes())
        start = data.index(b"\n") + 1
        for _ in range(dice.choice((1, 3, 20))):
            at = dice.randrange(start) if dice.random() < 0.2 else dice.randrange(start, len(data))
            data[at : at + 8] = dice.choice((b"\xff" * 8, bytes(6) + b"\xf0\x7f", b"", dice.randbytes(8), bytes(9)))
        file.write_bytes(data)
        said = typed(folder, *(["--set", "law=pfra"] if i % 2 else []))
        codes.add(said.code)
        assert said.code in (0, 1, 2)
        assert (said.code == 2) is (said.out == "")
        assert said.code != 2 or said.err.count("\n") == 1
        with suppress(Refused), warnings.catch_warnings():
            warnings.simplefilter("ignore", TruncatedRecord)
            Recorded(str(folder)).arrivals(0, 100, 1_000_000, 1, 100)
    assert len(codes) > 1


def interrupted(out: Path, *, first: float, **other: Any) -> Recording:
    """Two ends over a rough link that have run for `first` s, when the slave falls asleep for 1.5 s."""
    world = Recording(healing(energy=True, duration=20.0, playout=Integral()), out=out, loss=0.1, jitter=30_000_000,
                      copies=0.1, **other)
    world.run(first)
    world.pause("s", asleep=True)
    world.run(1.5)
    world.pause("s", asleep=False)
    return world


@pytest.mark.parametrize("every", [{"m": 1, "s": 1}, {"m": 2, "s": 1}], ids=["one rate", "two rates"])
def test_sessions_that_begin_anew_pauses_and_other_rates_are_run_again_to_the_bit(
    every: dict[str, int], tmp_path: Path
) -> None:
    world = interrupted(tmp_path, first=2.0, every=every)
    world.run(2.0)
    world.start("m")
    world.until_both_play(8.0)
    world.run(1.0)
    sessions, gaps = set(), 0
    for folder, e in world.folders():
        end = read_end(folder, world.scene)
        rows = end.inputs.rows.part(0, end.ticks)
        assert end.ticks > 50
        assert difference(end, world.scene) is None, (folder, e)
        sessions.add(rows[:, 2].max())
        gaps += int((rows[:, 1] > 1).sum())
    assert max(sessions) >= 2
    assert gaps >= 1


def test_open_loop_over_sessions_that_begin_anew_the_messages_take_the_way_they_took(tmp_path: Path) -> None:
    """One that is started anew counts what waves have come to from the first message that it plays."""
    world = interrupted(tmp_path, first=1.0)
    world.until_both_play(8.0)
    world.run(2.0)
    ends = [read_end(folder, world.scene) for folder, _ in sorted(world.folders())]
    for one in command_open_loop(ends, world.scene, world.scene).values():
        assert len(one.k) > 300
        assert np.abs(one.commanded).max() > 0.1
        assert np.array_equal(one.commanded, one.recorded)


THREE: dict[str, Any] = {"axes": 3, "environment": (Wall(k=2e3, at=0.002), None, None), "device_m": Device(
    encoder=Encoder(step=1e-5), velocity=LowPass(cutoff=50.0)), "playout": Integral()}


@pytest.mark.parametrize(("law", "other"), [("wave", {}), ("wave", THREE), ("pfra", THREE)],
                         ids=["one axis", "waves in three", "a sensor in three"])
def test_ends_that_go_by_packets_are_run_again_to_the_bit(
    law: str, other: dict[str, Any], pair: Callable[..., Pair]
) -> None:
    scene = replace(load_scene("hard_wall", law=law, observer="none", duration=0.3), **other)
    run = pair(scene, seed=3).run()
    assert set(run.status().values()) == {"ok"}
    master, slave = run.write()
    for folder in (master, slave):
        end = read_end(folder, scene)
        assert end.inputs.sensor is (law == "pfra")
        assert difference(end, scene) is None
    assert not (master / ARRIVALS).exists()


NOISE = 1e-9  # N


def apart(folder: Path, e: str, result: Result, until: int | None = None) -> tuple[float, int]:
    """The greatest difference of an end's force (N) at the ticks that it ran, and how many these were."""
    header, record, _ = read_record(folder)
    rows: Any = record.rows
    ticks = np.asarray(record.ticks)
    ticks = ticks[: len(ticks) if until is None else int(np.searchsorted(ticks, until))]
    live = rows.table(0, len(ticks))[:, header["columns"][3:].index(f"f_{e}")]
    assert np.array_equal(np.asarray(record.played)[: len(ticks)], result.trace[f"seq_{e}"][ticks])
    return float(np.abs(live - result.trace[f"f_{e}"][ticks]).max()), len(ticks)


def test_a_lossy_live_run_over_its_own_link_in_virtual_time_gives_its_forces(lossy: Path) -> None:
    """Up to where an end let go, if the machine stalled it for so long: what a guard does then is not of the link."""
    knobs = json.loads((lossy / "master" / INPUTS).read_bytes().split(b"\n")[0])["knobs"]
    result = run(load_scene("hard_wall", **{**knobs, "link": f"recorded({str(lossy)!r})"}))
    events = [event for name in ("master", "slave") for event in read_events(lossy / name)]
    until = min((event["k"] for event in events if event["what"] in ("safe", "session")), default=2000)
    for e, name in (("m", "master"), ("s", "slave")):
        most, ticks = apart(lossy / name, e, result, until)
        assert most <= NOISE
        counts = json.loads((lossy / name / "summary.json").read_text())
        assert until < 2000 or ticks == counts["ticks"]
    if until == 2000:
        assert np.abs(result.trace["f_m"]).max() > 0.1


@pytest.mark.parametrize("playout", [
    pytest.param(Integral(), marks=pytest.mark.full), Zero(), pytest.param(Fixed(0.04), marks=pytest.mark.full),
], ids=as_typed)
def test_left_out_ticks_and_arrivals_of_a_run_make_the_same_run_in_virtual_time(
    playout: Playout, tmp_path: Path
) -> None:
    """Two seconds over loss, copies and jitter, both ends asleep for a while, with clocks that differ."""
    scene = healing(energy=True, duration=2.0, dt=0.001, playout=playout)
    found = Recording(scene, out=tmp_path, loss=0.1, jitter=9 * MS, copies=0.1, noise=MS // 2)
    found.until_both_play(1.0)
    for e in "msms":
        found.run(0.3)
        found.pause(e, asleep=True)
        found.run(0.03)
        found.pause(e, asleep=False)
    found.run(2.0)
    folders = {e: folder for folder, e in found.folders()}
    link = Recorded(str(folders["m"]), str(folders["s"]))
    result = run(replace(scene, link=link))
    assert result.status == "ok"
    for e, folder in folders.items():
        most, ticks = apart(folder, e, result, scene.ticks)
        assert most <= NOISE
        assert scene.ticks - 80 < ticks < scene.ticks - 40
    without = run(replace(scene, link=Recorded(str(folders["m"]), str(folders["s"]), left_out=False)))
    assert np.abs(without.trace["f_m"] - result.trace["f_m"]).max() > 1e-3
    # The left out ticks come by time, whatever the tick.
    own, half = (link.leaves_out(0, dt_ns) for dt_ns in (MS, MS // 2))
    assert own is not None
    assert half is not None
    out = own.left_out(0, 2 * scene.ticks, 0)
    assert np.array_equal(half.left_out(0, 2 * scene.ticks, 5), np.repeat(out[: scene.ticks], 2))
    ran = np.asarray(read_record(folders["m"])[1].ticks)
    assert np.array_equal(np.flatnonzero(~out[: ran[-1] + 1]), ran)
    assert np.array_equal(out[ran[-1] + 1 :], out[: len(out) - ran[-1] - 1])  # and from the beginning again
