"""The folder of a study: what it is of, the key, the people's journals, and the table for a reviewer (Psych-DS).

    DIR/dataset_description.json              the table's columns, each with unit and meaning
    DIR/study.json                            name, digest of the plan, whether its people are simulated
    DIR/plan.toml                             the plan as it was
    DIR/key.json                              letter -> condition, mode 0600; read by programs, shown by `unblind` alone
    DIR/sub-03/journal.jsonl                  all that person 3 did, a line a step
    DIR/sub-03/trial-007/interval-1/          the record of an interval of a trial
    DIR/data/study-NAME_data.csv              one row a trial, of all people
    DIR/data/study-NAME_description-answers_data.csv      one row an answer of a questionnaire
    DIR/unblinded.jsonl                       who looked at the key, and when

Everything in it but the key shows letters. A person withdraws by the removal of their folder.
"""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from teleop.errors import Refused, number_of
from teleop.people.felt import check_levels, felt_stiffness, knobs_of
from teleop.people.journal import NAME, Journal, of_kind, read_journal
from teleop.people.plan import QuestionKind, StudyCondition, StudyPlan
from teleop.people.plan_file import read_plan
from teleop.people.schedule import LETTERS, Trial, dice
from teleop.people.scores import TLX_ITEMS, tlx_raw, tlx_weighted, tlx_weights
from teleop.people.session import check_row
from teleop.storage.files import creating, read_bytes, replacing, replacing_text
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import Misshapen, json_text, parse, record, text, write_document

DESCRIPTION, STUDY, PLAN, KEY, LOOKS = (
    "dataset_description.json", "study.json", "plan.toml", "key.json", "unblinded.jsonl")
COLUMNS = {  # of the table: unit and meaning
    "participant": ("", "number of the person"), "trial": ("", "number of the person's trial, training included"),
    "condition": ("", "letter of the condition; the key is apart"), "place": ("", "of the condition in the order"),
    "training": ("", "1 for a trial of training"),
    "level": ("N/m, m or N", "stiffness, distance or force of the trial"),
    "standard": ("N/m", "stiffness that the level is compared with"), "width": ("m", "of the target"),
    "second": ("", "1 where the level is in the second interval"), "answer": ("", "interval that was answered, 1 or 2"),
    "correct": ("", "1 for a correct answer, or an end within the target"),
    "time": ("s", "of the movement, or from the end of the last interval to the answer"),
    "end": ("m", "where the reach ended"), "overshoot": ("m or N", "beyond the target"),
    "peak_force": ("N", "largest force against the hand"), "delay": ("s", "measured, round trip"),
    "loss": ("1", "share of the packets"), "skipped": ("1", "share of the ticks"),
    "modality": ("", "visual: a pointer, no force display; haptic: a device that renders force"),
    "device": ("", "input device"), "refresh": ("Hz", "of the screen"),
    "focus_lost": ("", "1 where the page was not in front all the time"),
    "late_turn": ("", "1 where the turn before took longer than the plan says"), "stopped": ("", "1 after Stop"),
    "again": ("", "how often the trial was cut before, and run again"), "seconds": ("s", "since the session began"),
}
ANSWERS = ("participant", "condition", "place", "question", "kind", "item", "answer")
_RENAMED = {"trial": "number", "condition": "letter"}  # columns by the name that they have in a line


@dataclass(frozen=True, slots=True)
class StudyKey:
    """The conditions behind the letters, and the felt stiffness of each level under them."""

    conditions: Mapping[str, StudyCondition]  # by letter
    felt: Mapping[str, Mapping[float, float]]  # by letter


@dataclass(frozen=True, slots=True)
class Study:
    """A study's folder, its plan and its key."""

    folder: Path
    plan: StudyPlan
    key: StudyKey
    simulated: bool

    def home(self, participant: int) -> Path:
        """The folder of a person."""
        return self.folder / f"sub-{participant:02d}"

    def trial_folder(self, participant: int, number: int) -> Path:
        """The folder for the record of a trial."""
        return self.home(participant) / f"trial-{number:03d}"

    def records(self, participant: int, trial: Trial) -> list[Path]:
        """The folders for the records of a trial's intervals, each of which `load_scene` takes as hand."""
        return [self.trial_folder(participant, trial.number) / f"interval-{i + 1}"
                for i in range(self.plan.task.intervals)]

    def people(self) -> list[int]:
        """The numbers of the people who have a journal."""
        return sorted(int(path.parent.name[4:]) for path in self.folder.glob(f"sub-*/{NAME}")
                      if path.parent.name[4:].isdecimal())

    def journal(self, participant: int, *, sync: bool = True) -> Journal:
        """Open the journal of a person, whose folder is made. Raises `Refused`."""
        check_participant(self.plan, participant)
        self.home(participant).mkdir(exist_ok=True)
        return Journal(self.home(participant) / NAME, sync=sync)

    def check_code(self, participant: int, code: str) -> None:
        """Refuse a participant's code that another one has."""
        for each in self.people():
            rows = read_journal(self.home(each) / NAME)
            if each != participant and rows and rows[0].get("code") == code:
                raise Refused(f"the code {code!r} is that of participant {each}; each person has a code of their own")

    def withdraw(self, participant: int) -> None:
        """Remove all that there is of a person, in their folder and in the tables."""
        shutil.rmtree(self.home(participant), ignore_errors=True)
        self.write_tables()

    def rows(self) -> Iterator[tuple[int, list[dict[str, Any]]]]:
        """Each person's number and the lines of their journal."""
        for participant in self.people():
            path = self.home(participant) / NAME
            rows = read_journal(path)
            for number, row in enumerate(rows, 1):
                check_row(self.plan, row, f"line {number} of {path}")
            yield participant, rows

    def looks(self) -> list[dict[str, Any]]:
        """Looks at the key, with who and when; none before it is unblinded."""
        return read_journal(self.folder / LOOKS)

    def label(self, letter: str) -> str:
        """A condition on all that is shown: its letter, or its name once the study is unblinded."""
        return self.key.conditions[letter].name if self.looks() else letter

    def write_tables(self) -> None:
        """Write the tables of all people who take part."""
        data = self.folder / "data"
        data.mkdir(exist_ok=True)
        journals = [*self.rows()]
        with replacing_text(data / f"study-{self.plan.name}_data.csv") as file:
            lines = csv.writer(file, lineterminator="\n")
            lines.writerow(COLUMNS)
            for participant, rows in journals:
                lines.writerows([_cell(value) for value in _columns(self.plan, participant, row)]
                                for row in of_kind(rows, "trial"))
        with replacing_text(data / f"study-{self.plan.name}_description-answers_data.csv") as file:
            lines = csv.writer(file, lineterminator="\n")
            lines.writerow(ANSWERS)
            for participant, rows in journals:
                for row in of_kind(rows, "question"):
                    lines.writerows([participant, row["letter"], row["place"], row["question"] + 1, *cells]
                                    for cells in _answers(self.plan, row))


def _columns(plan: StudyPlan, participant: int, row: Mapping[str, Any]) -> list[Any]:
    also = {"participant": participant, "standard": plan.task.standard or None}
    return [also.get(name, row.get(_RENAMED.get(name, name))) for name in COLUMNS]


def _cell(value: Any) -> Any:
    """A value as the table has it: truths as 0 and 1, what does not exist as n/a."""
    return "n/a" if value is None else int(value) if isinstance(value, bool) else value


def _answers(plan: StudyPlan, row: Mapping[str, Any]) -> Iterator[tuple[str, str, Any]]:
    """Kind, item and answer of each line of a questionnaire."""
    question = plan.questions[row["question"]]
    if question.kind is not QuestionKind.TLX:
        yield from ((question.kind.value, item, answer) for item, answer in zip(
            question.items, row.get("points", row.get("texts", ())), strict=True))
        return
    yield from (("tlx", item, rating) for item, rating in zip(TLX_ITEMS, row["ratings"], strict=True))
    yield "tlx", "raw", tlx_raw(row["ratings"])
    if question.weighted:
        yield "tlx", "weighted", tlx_weighted(row["ratings"], tlx_weights(row["chosen"]))


def create_study(plan: StudyPlan, out: Path | str | None, *, entropy: int, simulated: bool = False) -> Study:
    """Make the folder of a study, with a key drawn by `entropy`. Raises `Refused`.

    The felt stiffness of each level under each condition is measured and checked first, and kept in the key.
    """
    felt = felt_stiffness(plan)
    check_levels(plan, felt)
    order = dice(entropy % 2**64, entropy // 2**64 % 2**64, 4).random(len(plan.conditions)).argsort()
    with new_folder(out, plan.name) as new:
        (new.inside / PLAN).write_text(plan.source)
        write_document(new.inside / STUDY, {"name": plan.name, "plan": plan.digest, "simulated": simulated})
        write_document(new.inside / DESCRIPTION, describe(plan))
        key = {LETTERS[i]: {"condition": plan.conditions[at].name,
                            "felt": {repr(level): value for level, value in felt[plan.conditions[at].name].items()}}
               for i, at in enumerate(order)}
        with replacing(new.inside / KEY) as file:
            os.chmod(file.fileno(), 0o600)
            file.write(json_text(key, indent=2).encode() + b"\n")
    return open_study(new.path)


def open_study(folder: Path | str, plan: StudyPlan | None = None, *, simulated: bool | None = None) -> Study:
    """Open a study's folder, which must be of this `plan` where one is given. Raises `Refused`."""
    folder = Path(folder)
    try:
        about = parse(read_bytes(folder / STUDY, links=False))
        record({"name": text, "plan": text})(about, STUDY)
        key = parse(read_bytes(folder / KEY, links=False))
    except (OSError, Misshapen) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise Refused(f"{folder} is no folder of a study ({why}); give one that teleop study has made") from None
    stored = read_plan(folder / PLAN)
    if stored.digest != about["plan"]:
        raise Refused(f"{folder / PLAN} was changed after the study began; put it back as it was")
    if plan is not None and plan.digest != stored.digest:
        difference = f"is of the study {stored.name}" if plan.name != stored.name else "is of another plan of that name"
        raise Refused(f"{folder} {difference}; give another folder with --out")
    if simulated is not None and simulated != bool(about.get("simulated")):
        people = "simulated people" if about.get("simulated") else "people"
        raise Refused(f"{folder} is a study with {people}; give another folder with --out")
    try:
        letters = {letter: stored.condition(str(entry["condition"])) for letter, entry in key.items()}
        felt = {letter: {float(level): float(value) for level, value in entry["felt"].items()}
                for letter, entry in key.items()}
        if [*letters] != sorted(LETTERS[:len(stored.conditions)]):
            raise KeyError
    except (TypeError, KeyError, ValueError, AttributeError, StopIteration):
        raise Refused(f"{folder / KEY} is no key of this study; put it back from a copy") from None
    return Study(folder, stored, StudyKey(letters, felt), bool(about.get("simulated")))


def describe(plan: StudyPlan) -> dict[str, Any]:
    """The document dataset_description.json of Psych-DS, in the words of schema.org."""
    measured = [{"@type": "PropertyValue", "name": name, "description": meaning, **({"unitText": unit} if unit else {})}
                for name, (unit, meaning) in COLUMNS.items()]
    measured += [{"@type": "PropertyValue", "name": name, "description": "of a questionnaire's answer"}
                 for name in ANSWERS if name not in COLUMNS]
    return {"@context": "https://schema.org/", "@type": "Dataset", "name": plan.name,
            "description": f"A {plan.design.value}-subject study of {number_of(len(plan.conditions), 'condition')}, "
                           f"task {plan.task.kind.value}, in the scene {plan.scene}.",
            "variableMeasured": measured}


def check_lock(path: Path, plan: StudyPlan) -> bool:
    """True if the plan of this file is locked. Raises `Refused` if it was changed since."""
    try:
        locked = parse(read_bytes(lock_path(path)))
        record({"plan": text, "date": text})(locked, lock_path(path).name)
    except FileNotFoundError:
        return False
    except (OSError, Misshapen) as error:
        raise Refused(f"{lock_path(path)} cannot be read ({error}); put it back from a copy") from None
    if locked["plan"] != plan.digest:
        raise Refused(f"{path} was changed after it was locked on {locked['date']}; put it back, or register the "
                      f"change: remove {lock_path(path)}, and type teleop study check {path} --lock")
    return True


def check_participant(plan: StudyPlan, participant: int) -> None:
    """Refuse a number that no participant of the plan has."""
    if not 1 <= participant <= plan.participants.most:
        raise Refused(f"the plan has the participants 1 to {plan.participants.most}, not {participant}; write for "
                      "example --participant 1")


def lock_path(path: Path) -> Path:
    """The lock of a plan."""
    return path.with_suffix(".lock")


def write_lock(path: Path, plan: StudyPlan, document: Mapping[str, Any]) -> None:
    """Lock a plan: its digest, the versions and the date. Raises `Refused` if it is locked already."""
    try:
        with creating(lock_path(path)) as file:
            file.write(json_text({"plan": plan.digest, **document}, indent=2).encode() + b"\n")
    except FileExistsError:
        raise Refused(f"{path} is locked already, by {lock_path(path)}") from None
    except OSError as error:
        raise Refused(f"cannot write {lock_path(path)} ({error.strerror or error}); give a plan in a folder that you "
                      "may write to") from None


def intervals(study: Study, trial: Trial) -> list[dict[str, object]]:
    """The knobs of each interval of a trial, for `load_scene(plan.scene, **knobs)`."""
    condition, plan = study.key.conditions[trial.letter], study.plan
    if plan.task.intervals == 1:
        return [knobs_of(plan, condition, trial.level)]
    walls = [plan.task.standard, trial.level]
    return [knobs_of(plan, condition, wall) for wall in (walls if trial.second else walls[::-1])]
