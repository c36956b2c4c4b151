"""A study from plan to analysis by the commands: its folder, its blinding, its table, and what it refuses."""

from __future__ import annotations

import csv
import json
import stat
from pathlib import Path
from typing import Any

import pytest

from master.steered import SteeredMaster
from teleop.__main__ import main
from teleop.errors import Refused
from teleop.people.contrasts import paired_power
from teleop.people.journal import NAME, read_journal
from teleop.people.plan_file import read_plan
from teleop.people.schedule import Trial
from teleop.people.simulated import Person, simulate_session
from teleop.people.study import COLUMNS, KEY, Study, create_study, intervals, open_study
from teleop.scene.loading import load_scene
from tests.teleop.people.plans import REACH, TEXT, plan_of

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a plan, in which commands are typed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plan.toml").write_text(TEXT)
    (tmp_path / "reach.toml").write_text(REACH)
    return tmp_path


def typed(capsys: Capture, *words: str, code: int = 0) -> str:
    """Output of `teleop study`, or the sentence of its refusal."""
    assert main(["study", *words]) == code
    streams = capsys.readouterr()
    return streams.err if code else streams.out


def answer(capsys: Capture, *words: str) -> dict[str, Any]:
    return dict(json.loads(typed(capsys, *words, "--json")))


def test_check_shows_what_each_law_lets_through_and_what_a_session_costs(here: Path, capsys: Capture) -> None:
    text = typed(capsys, "check", "plan.toml")
    for words in ("within, williams: 2 rows, repeated 2 times by 4 people", "28 trials", "15 min", "18 MB on disk",
                  "+61.9%  -32.1%", "333.3 N/m", "none: teleop study check plan.toml --lock registers the plan"):
        assert words in text, words
    document = answer(capsys, "check", "plan.toml")
    felt = {(each["condition"], each["level"]): each for each in document["felt"]}
    assert felt["stiff", 700.0]["correct"] == pytest.approx(0.5 * 0.02 + 0.98 * 0.84036, abs=1e-4)
    assert not (here / "runs").exists()


def test_people_were_counted_for_an_alpha_of_a_twentieth_whatever_the_plan_says(here: Path, capsys: Capture) -> None:
    for alpha in (0.05, 0.001):
        power = f"alpha = {alpha}\n[power]\nd_z = 1.0\n[simulated]"
        (here / "plan.toml").write_text(TEXT.replace("[simulated]", power))
        found = answer(capsys, "check", "plan.toml")["power"]
        assert paired_power(1.0, found["needed"] - 1, alpha) < 0.8 <= paired_power(1.0, found["needed"], alpha)
        assert found["power"] == pytest.approx(paired_power(1.0, 4, alpha))


def test_a_locked_plan_that_was_changed_is_refused(here: Path, capsys: Capture) -> None:
    typed(capsys, "check", "plan.toml", "--lock")
    lock = json.loads((here / "plan.lock").read_text())
    assert lock["plan"] == plan_of(TEXT).digest
    assert {"bilateral-teleop", "python"} <= set(lock["versions"])
    assert lock["date"].endswith("Z")
    (here / "plan.toml").write_text("# another comment\n" + TEXT.replace("\n", "\r\n"))
    assert "locked, and unchanged since" in typed(capsys, "check", "plan.toml")
    (here / "plan.toml").write_text(TEXT.replace("repeats = 4", "repeats = 6"))
    for words in (("check",), ("simulate",), ("run", "--participant", "1")):
        sentence = typed(capsys, words[0], "plan.toml", *words[1:], code=2)
        assert "plan.toml was changed after it was locked on" in sentence
    assert not (here / "runs").exists()


def test_until_it_is_unblinded_nothing_shows_a_condition(here: Path, capsys: Capture) -> None:
    """No word of a condition or a law in any output, name or file, apart from the plan and the key."""
    words = ("smooth", "stiff", "wave", '"pp"', "law.", "compliance")
    outputs = [typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "4"),
               typed(capsys, "analyse", "s"), json.dumps(answer(capsys, "analyse", "s")["after"]),
               typed(capsys, "analyse", "s", "--measure", "tlx")]
    for path in sorted((here / "s").rglob("*")):
        outputs.append(path.name)
        if path.is_file() and path.name not in ("plan.toml", KEY):
            outputs.append(path.read_text())
    assert not [(word, text) for word in words for text in outputs if word in text.replace("stiffness", "")]
    assert "A - B" in outputs[1]
    assert stat.S_IMODE((here / "s" / KEY).stat().st_mode) == 0o600
    shown = typed(capsys, "unblind", "s", "--name", "Ada")
    assert "look 1 at the key, by Ada" in shown
    assert "smooth" in shown
    assert not (here / "s" / "people.png").exists()
    text = typed(capsys, "analyse", "s", "--plot")
    assert "smooth - stiff" in text
    assert "JND of k_e at 500 N/m, 84.1 % correct: " in text
    assert text.endswith("plot: s/people.png\n")
    assert (here / "s" / "people.png").read_bytes()[:4] == b"\x89PNG"
    looks = read_journal(here / "s" / "unblinded.jsonl")
    assert [(each["who"], each["when"][-1]) for each in looks] == [("Ada", "Z")]


def test_the_table_has_a_row_for_each_trial_and_a_cut_simulation_goes_on_to_it(here: Path, capsys: Capture) -> None:
    typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "3")
    with (here / "s" / "data" / "study-small_data.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 28
    assert {(row["participant"], row["trial"]) for row in rows} == {(str(p), str(t)) for p in (1, 2, 3)
                                                                  for t in range(1, 29)}
    assert ({row["condition"] for row in rows}, {row["modality"] for row in rows}) == ({"A", "B"}, {"simulated"})
    assert all(row["correct"] == str(int((row["answer"] == "2") == ((row["second"] == "1") == (
        float(row["level"]) > float(row["standard"]))))) for row in rows)
    description = json.loads((here / "s" / "dataset_description.json").read_text())
    assert (description["@context"], description["@type"]) == ("https://schema.org/", "Dataset")
    named = [each["name"] for each in description["variableMeasured"]]
    with (here / "s" / "data" / "study-small_description-answers_data.csv").open() as file:
        answers = list(csv.DictReader(file))
    assert {*COLUMNS, *answers[0]} == set(named)
    scores = [row for row in answers if row["item"] in ("raw", "weighted")]
    assert len(scores) == 3 * 2 * 2
    path = here / "s" / "sub-02" / NAME
    whole = path.read_bytes()
    table = (here / "s" / "data" / "study-small_data.csv").read_bytes()
    path.write_bytes(whole[:len(whole) // 2])
    typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "3")
    assert path.read_bytes() == whole
    assert (here / "s" / "data" / "study-small_data.csv").read_bytes() == table
    before = sorted(here.rglob("*"))
    assert "is of the study small" in typed(capsys, "simulate", "reach.toml", "--out", "s", code=2)
    (here / "plan.toml").write_text(TEXT.replace("seed = 5", "seed = 6"))
    assert "is of another plan of that name" in typed(capsys, "simulate", "plan.toml", "--out", "s", code=2)
    with pytest.raises(Refused, match="s is a study with simulated people; give another folder"):
        open_study("s", simulated=False)
    assert sorted(here.rglob("*")) == before


def test_what_is_left_out_has_its_reason_and_the_findings_of_before(here: Path, capsys: Capture) -> None:
    (here / "plan.toml").write_text(TEXT.replace("least_correct = 0.5", "least_correct = 0.5\nlongest = 8.0\n"
                                                                       "focus_lost = true\nleast_trials = 0.9"))
    typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "6")
    for number, change in ((1, {"time": 9.0, "modality": "haptic"}), (2, {"correct": False, "answer": 1}),
                           (3, {"focus_lost": True})):
        path = here / "s" / f"sub-{number:02d}" / NAME
        rows = read_journal(path)
        trials = [row for row in rows if row["kind"] == "trial" and not row["training"]]
        for row in trials[:1] if number == 1 else trials:
            row.update(change)
        path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    document = answer(capsys, "analyse", "s")
    assert document["excluded"]["trials"] == {"took too long": 1, "page not in front": 24}
    assert document["excluded"]["people"] == {
        "sub-02": "0% of the answers are correct, fewer than 50%", "sub-03": "0 of 24 trials are left, fewer than 90%"}
    assert (document["before"]["people"], document["before"]["trials"]) == (6, 144)
    assert (document["after"]["people"], document["after"]["trials"]) == (4, 4 * 24 - 1)
    text = typed(capsys, "analyse", "s")
    assert "before anything was left out" in text
    assert "1 trial took too long" in text
    path.write_text(path.read_text().replace('"modality": "simulated"', '"modality": "visual"'))
    assert "a pointer displays no force" in typed(capsys, "analyse", "s", code=2)


@pytest.mark.usefixtures("here")
def test_reaches_are_analysed_by_time_throughput_and_questions(capsys: Capture) -> None:
    typed(capsys, "simulate", "reach.toml", "--out", "s", "--participants", "8")
    for measure in ("time", "throughput", "overshoot", "correct"):
        document = answer(capsys, "analyse", "s", "--measure", measure)
        assert [each["people"] for each in document["after"]["conditions"]] == [8, 8], measure
        for contrast in document["after"]["contrasts"]:
            assert contrast["low"] < contrast["estimate"] < contrast["high"]
            assert contrast["corrected_interval"][0] < contrast["corrected"] < contrast["corrected_interval"][1]
        assert document["after"]["contrasts"] or measure == "correct"  # where all hit, there is nothing to compare
    assert "no measure 'w'" in typed(capsys, "analyse", "s", "--measure", "w", code=2)


def test_a_line_that_no_session_writes_is_refused_and_named(here: Path, capsys: Capture) -> None:
    typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "2")
    path = here / "s" / "sub-02" / NAME
    whole = path.read_text()
    for before, after, why in (
            ('"level": 700.0', '"level": 701.0', "the plan has no level 701"),
            ('"answer": 1', '"answer": 3', "the trial.answer must be"),
            ('"letter": "A"', '"letter": "wave"', "the trial.letter must be"),
            ('"stopped": false, ', "", "the trial has no stopped"),
            ('"ratings": [', '"ratings": [500, ', "question 1 has 6 ratings"),
            ('"question": 1', '"question": 7', "the plan has 2 questions")):
        path.write_text(whole.replace(before, after, 1))
        sentence = typed(capsys, "analyse", "s", code=2)
        assert "is no line of this study (" in sentence, before
        assert why in sentence, (why, sentence)
    path.write_text(whole)
    (here / "s" / KEY).write_text("{}")
    assert "key.json is no key of this study; put it back from a copy" in typed(capsys, "analyse", "s", code=2)


def study_in(folder: Path) -> Study:
    return create_study(read_plan(folder / "plan.toml"), folder / "s", entropy=2**70 + 5)


def test_each_person_has_a_code_of_their_own_and_withdraws_whole(here: Path) -> None:
    study = study_in(here)
    for number in (1, 2):
        with study.journal(number) as journal:
            journal.append({"kind": "session", "code": f"code{number}"})
    study.check_code(2, "code2")
    with pytest.raises(Refused, match="the code 'code1' is that of participant 1"):
        study.check_code(2, "code1")
    with pytest.raises(Refused, match="the plan has the participants 1 to 8, not 9"):
        study.journal(9)
    study.withdraw(1)
    assert study.people() == [2]
    assert not study.home(1).exists()


def test_a_trials_intervals_have_the_conditions_knobs_and_the_walls_in_order(here: Path) -> None:
    study = study_in(here)
    letter = next(letter for letter, each in study.key.conditions.items() if each.name == "stiff")
    for second in (False, True):
        trial = Trial(number=1, letter=letter, place=1, training=False, level=700.0, width=0.0, second=second)
        got = intervals(study, trial)
        walls = [each.pop("k_e") for each in got]
        assert walls == ([500.0, 700.0] if second else [700.0, 500.0])
        assert got == [{"delay": 0.02, "duration": 4.0, "law": "pp", "law.K": 1000.0, "law.B": 10.0}] * 2


def test_a_trials_hand_runs_again_under_another_law_between_the_trials_own_walls(here: Path, capsys: Capture) -> None:
    """The hand of a live page, recorded for both intervals of the second trial of person 1."""
    study = study_in(here)
    with study.journal(1) as journal:
        simulate_session(Person(study.plan, 1, study.key.felt, study.key.conditions), journal)
        row = [each for each in journal.rows if each["kind"] == "trial"][1]
    trial = Trial(**{name: row[name] for name in ("number", "letter", "place", "training", "level", "width", "second")})
    assert "has no record of a hand" in typed(capsys, "rerun", "s", "--trial", "sub-01/2", "--law", "tdpa", code=2)
    for record in study.records(1, trial):
        record.mkdir(parents=True)
        device = SteeredMaster(load_scene("hard_wall"))
        device.record(record)
        for k in range(1, 301):
            if k % 16 == 0:
                device.steer([0.05])
            device.read(k)
            device.hold((2.0,))
        device.record(None)
    document = answer(capsys, "rerun", "s", "--trial", "sub-01/2", "--law", "tdpa", "--out", "again")
    assert [each["ticks"] for each in document["intervals"]] == [300, 300]
    walls = [500.0, trial.level] if trial.second else [trial.level, 500.0]
    assert [each["parameters"]["k_e"] for each in document["intervals"]] == walls
    assert all(each["parameters"]["law"]["name"] == "tdpa" for each in document["intervals"])
    assert sorted(path.name for path in (here / "again").iterdir()) == ["interval-1", "interval-2"]
    assert "has no trial sub-01/99" in typed(capsys, "rerun", "s", "--trial", "sub-01/99", "--law", "tdpa", code=2)


def test_without_scipy_a_plan_is_checked_and_simulated_and_the_analysis_says_what_installs_it(
        here: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    for name in [name for name in sys.modules if name.partition(".")[0] == "scipy"] + ["scipy", "scipy.special"]:
        monkeypatch.setitem(sys.modules, name, None)  # an import of it fails
    monkeypatch.setattr("teleop.people.command.find_spec", lambda _: None)
    (here / "plan.toml").write_text(TEXT + "[power]\nd_z = 0.8\n")
    assert "power      needs scipy; install it with: pip install 'bilateral-teleop[people]'" in typed(
        capsys, "check", "plan.toml")
    typed(capsys, "simulate", "plan.toml", "--out", "s", "--participants", "2")
    assert typed(capsys, "analyse", "s", code=2) == (
        "teleop: the analysis needs scipy; install it with: pip install 'bilateral-teleop[people]'\n")


def test_recovery_counts_what_the_analysis_makes_of_known_people(here: Path, capsys: Capture) -> None:
    document = answer(capsys, "simulate", "plan.toml", "--participants", "4", "--recover", "3")
    assert document["studies"] == 3
    assert set(document["coverage"]) == {"smooth", "stiff"}
    assert all(0.08 < w < 0.25 for w in document["w"].values())
    assert not (here / "runs").exists()
