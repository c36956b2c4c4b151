"""A session of a participant, step by step, without processes: what the screen is sent, and what the journal keeps."""

from __future__ import annotations

import json
import re
import shutil
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from teleop.__main__ import main
from teleop.errors import Refused
from teleop.law import known_laws
from teleop.live.page.controls import Controls
from teleop.live.records.reader import FILE
from teleop.people.journal import Journal
from teleop.people.plan_file import read_plan
from teleop.people.study import Study, create_study, open_study
from teleop.people.trials.conduct import LATE_TURNS, Screen, TrialConduct
from teleop.people.trials.rig import Rig

PLAN = '''
name = "try"
scene = "hard_wall"
set = {delay = 0.02}
consent = "You press walls."
[participants]
least = 2
most = 4
multiple_of = 2
[[condition]]
name = "waves"
set = {law = "wave"}
[[condition]]
name = "energy"
set = {law = "tdpa"}
[task]
TASK
[analysis]
primary = "PRIMARY"
contrasts = [["waves", "energy"]]
'''
COMPARE = 'kind = "compare"\nstandard = 400.0\nlevels = [200.0, 900.0]\nseconds = 1.0\nrepeats = 2'
REACH = 'kind = "reach"\ndistances = [0.02]\nwidths = [0.01]\nseconds = 2.6'
MORE = '''
[breaks]
every = 2
seconds = 30
[[question]]
kind = "tlx"
weighted = true
[[question]]
kind = "likert"
items = ["It moved as I wanted."]
[[question]]
kind = "text"
after = "session"
items = ["Anything else?"]
'''
SECRETS = re.compile(r"\b(waves|energy|queue|gain|age|link|law|" + "|".join(known_laws()) + r")\b")
KEYS = {
    "stage": {"type", "axes", "span", "target", "wall"}, "rows": {"type", "hand", "xm", "xs"},
    "said": {"type", "level", "text"},
    "screen": {"type", "screen", "done", "trials", "text", "training", "pointer", "resumed", "seconds", "interval",
               "intervals", "kind", "items", "points", "pairs", "noun"},
}
TAKES = {"wave": 0.12, "tdpa": 0.38}  # s from a turn's order to full force, as the two laws take them
MADE: dict[str, Path] = {}  # folder of a study by its plan: what is felt of each wall is measured once

RIG_COLUMNS = {"m": ["k", "late_ns", "seq", "x_m", "f_m"], "s": ["k", "late_ns", "seq", "x_s", "f_s"]}
DELAY = 20  # ticks, of the link each way


class FakeRig:
    """A stand-in of the three processes: the master follows the hand, the slave 20 ms later, on the clock `now` (s).

    `takes(knobs)`: s from a turn's order to full force. Its records have a few rows.
    """

    def __init__(self, folder: Path, now: Callable[[], float], takes: Callable[[Mapping[str, str]], float]) -> None:
        self._folder, self._now, self._takes = folder, now, takes
        self.lost, self.is_recorded = False, True
        self.live: dict[str, dict[str, Any]] = {"m": {"loss": 0.0}, "s": {"loss": 0.0}}
        self.done: list[tuple[str, Any]] = []  # what was asked of it, in order
        self.hand: list[tuple[float, float]] = [(0.0, 0.0)]  # when the hand was moved, and where
        self._ready_at, self._part = 0.0, 0
        self.folders: dict[str, Path] = {}

    def begin(self) -> None:
        self.done.append(("begin", None))
        self.lost = False

    def turn(self, knobs: Mapping[str, str], home: Sequence[float]) -> None:
        self.done.append(("turn", dict(knobs)))
        self.write()
        self._ready_at, self._part = self._now() + self._takes(knobs), self._part + 1
        self.hand.append((self._now(), home[0]))
        self.folders = {e: self._folder / f"{self._part:04d}" / name for e, name in (("m", "master"), ("s", "slave"))}

    @property
    def is_ready(self) -> bool:
        return self._now() >= self._ready_at

    def let_go(self) -> None:
        self.done.append(("let go", None))
        self.write()

    def end_record(self) -> None:
        self.done.append(("end", None))

    def steer(self, to: Sequence[float] | None) -> None:
        if to is not None:
            self.hand.append((self._now(), to[0]))

    def drop(self, folders: Sequence[Path]) -> None:
        for folder in folders:
            shutil.rmtree(folder.parent, ignore_errors=True)

    @property
    def tick(self) -> int:
        return round(1e3 * self._now())

    def at(self, k: int) -> float:
        """Where the hand is at a tick, m."""
        return next(to for since, to in reversed(self.hand) if k >= 1e3 * since or since == 0.0)

    def places(self) -> dict[str, Any]:
        k = self.tick
        return {"hand": (self.at(k),), "master": (self.at(k),), "slave": (self.at(k - DELAY),)}

    def path(self, e: str, count: int) -> list[Any]:
        return [(self.at(k - DELAY),) for k in range(self.tick - count + 1, self.tick + 1)]

    def write(self) -> None:
        """Write the records of the newest turn, of the last three seconds."""
        for e, folder in self.folders.items():
            folder.mkdir(parents=True, exist_ok=True)
            header = {"end": e, "dt_ns": 1_000_000, "axes": 1, "scene": "hard_wall", "knobs": {}, "seed": 0,
                      "mode": "live", "force": "sensor", "columns": RIG_COLUMNS[e]}
            rows = b"".join(struct.pack("<5d", k, 0.0, max(-1, k - DELAY), self.at(k - DELAY * (e == "s")),
                                        100.0 * self.at(k)) for k in range(max(0, self.tick - 3000), self.tick + 1))
            (folder / FILE).write_bytes(json.dumps(header).encode() + b"\n" + rows)


class Sitting:
    """A session on a clock that the test moves."""

    def __init__(self, folder: Path, plan: str, *, takes: Callable[[Mapping[str, str]], float] | None = None,
                 study: Study | None = None, device: str | None = None) -> None:
        path = folder / "plan.toml"
        path.write_text(plan)
        self.t = 0.0
        self.sent: list[str] = []
        self.marks: list[str] = []
        self.lines: list[str] = []
        if study is None and path.read_text() not in MADE:
            made = Path(mkdtemp()) / "study"
            create_study(read_plan(path), made, entropy=1)
            MADE[plan] = made
        if study is None:
            shutil.copytree(MADE[plan], folder / "study")
        self.study = study or open_study(folder / "study")
        self.journal: Journal = self.study.journal(1)
        self.rig = FakeRig(folder / "live", lambda: self.t, takes or (lambda knobs: TAKES[knobs["law"]]))
        self.conduct = TrialConduct(
            self.study, 1, self.journal, cast("Rig", self.rig), Controls("hard_wall", {"delay": "0.02"}),
            now=lambda: self.t, show=self.sent.append, tell=self.sent.append, report=self.lines.append,
            mark=self.marks.append, device=device)

    def say(self, kind: str, **fields: Any) -> None:
        self.conduct.hear("page", {"type": kind, **fields})

    def until(self, *screens: Screen, most: float = 60.0) -> None:
        """Let the time go on to one of these screens."""
        for _ in range(round(most * 60)):
            if self.conduct.screen in screens:
                return
            self.t += 1.0 / 60.0
            self.conduct.step(self.t)
        raise AssertionError(f"{self.conduct.screen} and none of {screens}")

    def carry_on(self, press: float = 0.05, stop_after: int | None = None) -> None:
        """Go on as a person would, to the end or until so many trials are in the journal."""
        while not self.conduct.is_over:
            if stop_after is not None and len(self.trials) >= stop_after:
                return
            screen = self.conduct.screen
            if screen is Screen.CONSENT:
                self.say("consent", code="P1")
            elif screen in (Screen.INSTRUCTIONS, Screen.STOPPED):
                self.say("next")
            elif screen is Screen.TRIAL:
                self.t += 0.2
                self.say("hand", to=[press])
                self.until(Screen.TURN, Screen.RECORD, Screen.ANSWER)
            elif screen is Screen.ANSWER:
                self.t += 0.5
                self.say("answer", interval=2)
            elif screen is Screen.BREAK:
                self.t += 31.0
                self.say("next")
            elif screen is Screen.QUESTION:
                asked = self.newest("screen")
                answers = {"tlx": {"ratings": [50] * 6, "chosen": [pair[0] for pair in asked.get("pairs", [])]},
                           "likert": {"points": [4]}, "text": {"texts": ["No."]}}
                self.say("answers", **answers[asked["kind"]])
            else:
                self.until(*[each for each in Screen if each not in (Screen.TURN, Screen.RECORD)])

    def newest(self, kind: str) -> dict[str, Any]:
        message: dict[str, Any] = next(each for each in map(json.loads, reversed(self.sent)) if each["type"] == kind)
        return message

    @property
    def trials(self) -> list[dict[str, Any]]:
        return [row for row in self.journal.rows if row["kind"] == "trial"]


Sitter = Callable[..., Sitting]


@pytest.fixture
def sitting(tmp_path: Path) -> Sitter:
    """`sitting(task, more="")`: a session of the plan with this task."""
    def make(task: str = COMPARE, more: str = "", primary: str = "correct", **options: Any) -> Sitting:
        return Sitting(tmp_path, PLAN.replace("TASK", task).replace("PRIMARY", primary) + more, **options)

    return make


def test_a_session_goes_from_consent_to_its_end_and_nothing_that_is_sent_names_a_condition(sitting: Sitter) -> None:
    at = sitting(more=MORE)
    at.sent += at.conduct.greeting()
    at.carry_on()
    kinds = [row["kind"] for row in at.journal.rows]
    condition = ["trial", "trial", "break", "trial", "trial", "question", "question"]
    assert kinds == ["session", *condition, *condition, "question"]
    assert at.conduct.screen is Screen.END
    for row in at.trials:
        assert (row["answer"], row["modality"], row["device"], row["again"]) == (2, "visual", "pointer", 0)
        assert not row["late_turn"]
        assert row["time"] == pytest.approx(0.5)
        assert row["peak_force"] == pytest.approx(5.0)
        assert row["delay"] == pytest.approx(0.04)
        assert row["correct"] == (row["second"] == (row["level"] > 400.0))
    for text in [*at.sent, *at.marks, *at.lines]:
        assert SECRETS.search(text) is None, text
    for message in map(json.loads, at.sent):
        assert {*message} <= KEYS[message["type"]], message
    assert {message["screen"] for message in map(json.loads, at.sent) if message["type"] == "screen"} == {
        "consent", "instructions", "turn", "trial", "answer", "break", "question", "record", "end"}
    at.study.write_tables()
    kept = at.study.trial_folder(1, 1) / "interval-2" / "ends.bin"
    assert kept.stat().st_mode & 0o777 == 0o600


def test_a_law_that_takes_longer_was_told_by_the_time_between_two_trials(sitting: Sitter) -> None:
    """From the answer, and from the end of the first interval, to the next one it is the plan's time."""
    at = sitting()
    begins: list[tuple[str, float]] = []
    while not at.conduct.is_over:
        before, t = at.conduct.screen, at.t
        if before is Screen.ANSWER:
            at.say("answer", interval=1)
            t = at.t
        elif before in (Screen.CONSENT, Screen.INSTRUCTIONS):
            at.say("next") if before is Screen.INSTRUCTIONS else at.say("consent", code="P1")
        if at.conduct.screen in (Screen.TURN, Screen.RECORD):
            at.until(Screen.TRIAL, Screen.END)
            if not at.conduct.is_over:
                begins.append((at.rig.done[-1][1]["law"], round(at.t - t, 3)))
        elif at.conduct.screen is Screen.TRIAL:
            at.until(Screen.TURN, Screen.ANSWER)
    assert {law for law, _ in begins} == {"wave", "tdpa"}
    assert {round(60.0 * (gap - 1.5)) for _, gap in begins} <= {0, 1}, "within a picture"
    assert not any(row["late_turn"] for row in at.trials)


@pytest.mark.parametrize("late", [2, LATE_TURNS])
def test_a_turn_that_takes_longer_is_flagged_and_a_robot_never_ready_started_anew(sitting: Sitter, late: int) -> None:
    slow = iter([2.0] * late)
    at = sitting(takes=lambda _: next(slow, 0.1))
    at.carry_on(stop_after=2)
    assert [row["late_turn"] for row in at.trials] == [True, False]
    assert (("begin", None) in at.rig.done) == (late == LATE_TURNS)
    if late == 2:
        walls = [knobs["k_e"] for what, knobs in at.rig.done if what == "turn"]
        assert walls[0] == walls[1] == walls[2] != walls[3], "the first interval three times, then the second"


def test_an_answer_counts_after_both_intervals_alone(sitting: Sitter) -> None:
    at = sitting()
    at.say("consent", code="P1")
    at.say("answer", interval=1)
    at.say("next")
    for interval in (1, 2):
        at.until(Screen.TRIAL)
        at.say("answer", interval=interval)
        assert at.conduct.screen is Screen.TRIAL
        at.until(Screen.TURN, Screen.ANSWER)
    assert at.conduct.screen is Screen.ANSWER
    assert at.trials == []
    at.say("answer", interval=1)
    at.until(Screen.TURN)
    assert at.trials[0]["answer"] == 1


def test_stop_brings_the_force_to_zero_and_marks_the_trial(sitting: Sitter) -> None:
    at = sitting()
    at.say("consent", code="P1")
    at.say("next")
    at.until(Screen.TRIAL)
    at.say("stop")
    assert at.rig.done[-1] == ("let go", None)
    assert at.conduct.screen is Screen.STOPPED
    assert (at.trials[0]["stopped"], at.trials[0]["answer"], at.trials[0]["correct"]) == (True, None, None)
    at.carry_on(stop_after=2)
    assert [(row["number"], row["stopped"]) for row in at.trials] == [(1, True), (2, False)]
    at.say("stop")
    assert at.rig.done[-1] == ("let go", None)


def test_a_trial_that_was_cut_is_run_again_with_the_same_walls(sitting: Sitter) -> None:
    """By a screen that is gone, a robot that is lost, or a session that ended in the middle."""
    at = sitting()
    at.say("consent", code="P1")
    at.say("next")
    at.until(Screen.TRIAL)
    walls = [knobs["k_e"] for what, knobs in at.rig.done if what == "turn"]
    at.conduct.forget("page")
    assert at.conduct.screen is Screen.STOPPED
    at.say("next")
    at.until(Screen.TRIAL)
    at.rig.lost = True
    at.until(Screen.STOPPED)
    at.journal.close()
    at = sitting(study=at.study)
    assert json.loads(at.conduct.screen_message())["screen"] == "instructions"
    at.carry_on(stop_after=1)
    assert (at.trials[0]["number"], at.trials[0]["again"]) == (1, 2)
    assert walls[0] == next(knobs["k_e"] for what, knobs in at.rig.done if what == "turn")


def test_whoever_withdraws_leaves_nothing(sitting: Sitter) -> None:
    at = sitting()
    at.carry_on(stop_after=1)
    at.study.write_tables()
    table = at.study.folder / "data" / "study-try_data.csv"
    assert len(table.read_text().splitlines()) == 2
    at.say("withdraw")
    assert at.conduct.screen is Screen.WITHDRAWN
    assert not at.study.home(1).exists()
    assert len(table.read_text().splitlines()) == 1
    assert "withdrawn" in at.sent[-1]


def test_a_code_is_asked_for_and_belongs_to_one_person(sitting: Sitter) -> None:
    at = sitting()
    with at.study.journal(2) as other:
        other.append({"kind": "session", "code": "P2"})
    for code, words in (("", "1 to 40"), ("x" * 41, "1 to 40"), ("a\nb", "1 to 40"), ("P2", "somebody else")):
        with pytest.raises(Refused, match=words):
            at.say("consent", code=code)
    assert at.journal.rows == []


def test_a_break_lasts_as_long_as_the_plan_says(sitting: Sitter) -> None:
    at = sitting(more=MORE)
    at.carry_on(stop_after=2)
    at.until(Screen.BREAK)
    at.t += 29.0
    with pytest.raises(Refused, match="The break goes on"):
        at.say("next")
    at.t += 1.5
    at.say("next")
    assert at.journal.rows[-1]["kind"] == "break"
    assert at.journal.rows[-1]["seconds"] == pytest.approx(30.5)


def test_a_reach_ends_when_the_robot_rests_and_its_time_counts_from_the_first_movement(sitting: Sitter) -> None:
    at = sitting(REACH, primary="time")
    at.carry_on(press=0.022, stop_after=1)
    row = at.trials[0]
    assert (row["end"], row["overshoot"], row["correct"]) == (pytest.approx(0.022), pytest.approx(0.002), True)
    assert row["time"] == pytest.approx(0.02), "of a hand that jumps, the link's delay is left"
    assert row["seconds"] < 1.5 + 2.6, "it ends by itself"
    target = next(message["target"] for message in map(json.loads, at.sent) if message["type"] == "stage"
                  and message["target"])
    assert target == {"at": 0.02, "width": 0.01, "of": "slave"}


def test_a_plan_decides_what_of_the_robot_is_shown(sitting: Sitter) -> None:
    at = sitting(COMPARE + '\nshow = ["hand"]')
    at.carry_on(stop_after=1)
    stages = [message for message in map(json.loads, at.sent) if message["type"] == "stage"]
    rows = [message for message in map(json.loads, at.sent) if message["type"] == "rows"]
    assert {stage["wall"] for stage in stages} == {None}
    assert {frozenset(row) for row in rows} == {frozenset({"type", "hand"})}


def test_a_lost_focus_and_the_refresh_of_the_screen_are_kept(sitting: Sitter) -> None:
    at = sitting()
    at.say("screen", refresh=59.94)
    at.carry_on(stop_after=1)
    at.until(Screen.TRIAL)
    at.say("focus")
    at.carry_on(stop_after=2)
    assert [(row["refresh"], row["focus_lost"]) for row in at.trials] == [(59.9, False), (59.9, True)]


@pytest.mark.parametrize("device", [None, "haply:/dev/ttyACM0"])
def test_a_press_by_a_device_names_it_by_a_pointer_shows_how_far_to_pull(sitting: Sitter, device: str | None) -> None:
    at = sitting('kind = "press"\nforces = [2.0]\nseconds = 1.0', primary="peak_force", device=device)
    at.carry_on(stop_after=1)
    assert (at.trials[0]["modality"], at.trials[0]["device"]) == (
        ("visual", "pointer") if device is None else ("haptic", device))
    sent = [json.loads(text) for text in at.sent]
    assert [message["pointer"] for message in sent if message.get("screen") == "instructions"] == [device is None]
    assert [message["target"] for message in sent if message["type"] == "stage"][-1] == (
        {"at": 2.0 / 200.0, "width": 0.0, "of": "hand"} if device is None else None)


def test_a_disk_without_room_for_a_session_is_refused_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace("TASK", REACH).replace("PRIMARY", "time"))
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=1e5))
    assert main(["study", "run", str(tmp_path / "plan.toml"), "--participant", "1", "--out", str(tmp_path / "s")]) == 2
    assert "has 100 kB left; free some space" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
