"""A session of a participant: one step after the other, and all that is ever sent to the screen.

The screen shows what it is sent and decides nothing. What is sent is made in `Screen` and `TrialConduct.picture` alone:
stage, hand, master, slave and the wall as far as the plan shows them, instructions, questions and where the session
is. No condition, law, link, force or energy is among it, so nothing of them can be found in the browser.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from teleop.errors import Refused
from teleop.live.page.controls import OPEN_ENDED, Controls, Drag
from teleop.live.page.server import HAND, MessageShape, hand_position, sentence_message
from teleop.live.page.session import lost_share
from teleop.people.felt import STIFFNESS, with_stiffness
from teleop.people.journal import Journal, of_kind
from teleop.people.plan import QuestionKind, StudyQuestion, TaskKind
from teleop.people.schedule import Step, StepKind, Trial, next_step, trials_of
from teleop.people.scores import PAIRS, TLX_ITEMS
from teleop.people.session import TrialOutcome, answer_row, break_row, session_row, trial_row
from teleop.people.study import Study, intervals
from teleop.people.trials.records import HALFWAY, REST, STILL, Movement, begin_trial, keep, measure
from teleop.people.trials.rig import Rig
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.storage.strict_json import json_text, list_of, real, text, whole

LONGEST_CODE = 40  # characters
RECORDING = 3.0  # s for the records of a trial to be whole
LATE_TURNS = 4  # one after the other, and the three processes are started anew
SHAPES = {
    "hand": HAND,
    "screen": MessageShape({"refresh": real}, ("refresh",)),
    "consent": MessageShape({"code": text}, ("code",)),
    "next": MessageShape(),
    "answer": MessageShape({"interval": whole(low=1, high=2)}, ("interval",)),
    "answers": MessageShape({"ratings": list_of(real, most=100), "chosen": list_of(whole(low=0), most=100),
                             "points": list_of(real, most=100), "texts": list_of(text, most=100)}),
    "focus": MessageShape(),
    "stop": MessageShape(),
    "withdraw": MessageShape(),
}
"""What a screen may send, by the type of the message."""
TASKS = {
    TaskKind.REACH: "Bring the robot into the blue band, as quickly and as exactly as you can, and hold it there.",
    TaskKind.PRESS: "Press the wall until the hand reaches the blue mark, and hold it there.",
    TaskKind.COMPARE: "Press two walls, one after the other. Then say which of the two was stiffer.",
    TaskKind.FREE: "Move the handle as you like, and press the wall.",
}


ASKED = {STIFFNESS: "Which wall was stiffer?", "delay": "In which of the two was the robot later?",
         "": "In which of the two was it more?"}
_KEYS = {"hand": "hand", "master": "xm", "slave": "xs"}  # by what a plan shows: its name in a message


class Screen(StrEnum):
    """Page of the screen that the participant sees."""

    CONSENT = "consent"
    INSTRUCTIONS = "instructions"
    TURN = "turn"  # between trials
    TRIAL = "trial"
    RECORD = "record"  # the records of a trial are being completed
    ANSWER = "answer"
    BREAK = "break"
    QUESTION = "question"
    STOPPED = "stopped"  # after Stop, and where a trial was cut
    END = "end"
    WITHDRAWN = "withdrawn"


class TrialConduct:
    """Conduct of a session. Times are in s, of the clock `now`.

    `show(text)` sends a picture, which may be lost; `tell(text)` a message, which may not. `mark(text)` sends a marker,
    and `report(text)` a line for the experimenter. `device`: the name of a haptic device; None: a pointer.
    """

    def __init__(self, study: Study, participant: int, journal: Journal, rig: Rig, controls: Controls, *,
                 now: Callable[[], float], show: Callable[[str], None], tell: Callable[[str], None],
                 report: Callable[[str], None], mark: Callable[[str], None], device: str | None = None) -> None:
        self.study, self.plan, self.participant, self._journal = study, study.plan, participant, journal
        self._rig, self._controls, self._device = rig, controls, device
        self._now, self._show, self._tell, self._report, self._mark = now, show, tell, report, mark
        self._drag = Drag()
        self._refresh: float | None = None
        self._began = now()
        self._since = now()  # when this screen began
        self._step: Step | None = None
        self._scenes: list[tuple[dict[str, str], Scene]] = []  # knobs and scene of each interval of the trial
        self._interval = 0
        self._first_tick: int | None = None  # of the interval
        self._ordered: Sequence[float] | None = None  # newest order to the hand
        self._recorded: list[dict[str, Path]] = []  # records of the trial's intervals, before they are kept
        self._stale: list[Path] = []  # records of turns that were done again
        self._spans: list[tuple[int, int]] = []  # ticks of each interval
        self._outcome = TrialOutcome()
        self._turn_from = now()  # when the turn began, whenever it is ordered
        self._is_turning = False  # the turn is ordered
        self._late = 0  # turns one after the other
        self._answered_from = 0.0
        self.screen = Screen.INSTRUCTIONS if journal.rows else Screen.CONSENT

    @property
    def is_over(self) -> bool:
        """True if there is nothing left to do."""
        return self.screen in (Screen.END, Screen.WITHDRAWN)

    # messages of the screen

    def greeting(self) -> list[str]:
        """The messages for a screen that has just been opened."""
        return [self.picture_of_stage(), self.screen_message()]

    def hear(self, page: Hashable, message: dict[str, Any]) -> None:
        """Take a message of the screen. Raises `Garbage` or `Refused`."""
        kind, now = message["type"], self._now()
        if kind == "hand":
            self._move(page, message["to"], now)
        elif kind == "screen":
            self._refresh = round(message["refresh"], 1) if 1.0 <= message["refresh"] <= 1000.0 else None
        elif kind == "focus":
            self._note_focus()
        elif kind == "stop":
            self._stop()
        elif kind == "withdraw":
            self._withdraw()
        elif kind == "consent" and self.screen is Screen.CONSENT:
            self._consent(message["code"].strip())
        elif kind == "next" and self.screen in (Screen.INSTRUCTIONS, Screen.STOPPED):
            self._next(now)
        elif kind == "next" and self.screen is Screen.BREAK:
            self._end_break(now)
        elif kind == "answer" and self.screen is Screen.ANSWER:
            self._answer(message["interval"], now)
        elif kind == "answers" and self.screen is Screen.QUESTION:
            assert self._step is not None
            self._journal.append(answer_row(self.plan, self._step, message))
            self._next(now)

    def forget(self, page: Hashable) -> None:
        """Take note that the screen is gone: a trial that it was in is cut."""
        self._drag.let_go(page)
        self._note_focus()
        if self.screen in (Screen.TURN, Screen.TRIAL):
            self._cut("The trial was interrupted. It begins again when you go on.")

    def _move(self, page: Hashable, to: Sequence[float] | None, now: float) -> None:
        if self.screen is not Screen.TRIAL:
            return
        if to is None:
            self._drag.let_go(page)
        else:
            self._drag.move(page, hand_position(to, self._scenes[self._interval][1].axes), now)

    def _note_focus(self) -> None:
        if self.screen in (Screen.TURN, Screen.TRIAL, Screen.ANSWER):
            self._outcome = replace(self._outcome, focus_lost=True)

    def _consent(self, code: str) -> None:
        if not 1 <= len(code) <= LONGEST_CODE or not code.isprintable():
            raise Refused(f"The code has 1 to {LONGEST_CODE} letters and digits; type the one that you were given.")
        try:
            self.study.check_code(self.participant, code)
        except Refused:
            raise Refused("This code belongs to somebody else; type the one that you were given, or ask.") from None
        self._journal.append(session_row(self.plan, self.participant, code))
        self._go_to(Screen.INSTRUCTIONS)

    def _answer(self, interval: int, now: float) -> None:
        self._outcome = replace(self._outcome, answer=interval, time=round(now - self._answered_from, 4))
        self._mark(f"answer {interval}")
        self._go_to(Screen.RECORD)

    def _end_break(self, now: float) -> None:
        assert self._step is not None
        if now - self._since < self._step.seconds:
            raise Refused("The break goes on; the button works when it is over.")
        self._journal.append(break_row(self._step, round(now - self._since, 3)))
        self._next(now)

    # the steps

    def _next(self, now: float) -> None:
        """Go on with the step that comes next in the journal."""
        self._step = step = next_step(self.plan, self.study.key.felt, self.participant, self._journal.rows)
        if step.trial is not None:
            self._begin_trial(step.trial)
        elif step.kind is StepKind.BREAK:
            self._go_to(Screen.BREAK)
        elif step.kind is StepKind.QUESTION:
            self._go_to(Screen.QUESTION)
        else:
            self._go_to(Screen.END)

    def _begin_trial(self, trial: Trial) -> None:
        again = begin_trial(self.study.trial_folder(self.participant, trial.number))
        self._outcome = TrialOutcome(again=again, modality="visual" if self._device is None else "haptic",
                                     device=self._device or "pointer")
        self._scenes = [trial_scene(self._controls.name, knobs) for knobs in intervals(self.study, trial)]
        self._recorded, self._spans, self._interval = [], [], 0
        self._report(f"trial {trial.number} of {trials_of(self.plan)}, condition {trial.letter}"
                     + (f", run again ({again})" if again else ""))
        self._begin_turn()

    def _begin_turn(self) -> None:
        self._is_turning, self._late = False, 0
        self._tell(self.picture_of_stage())
        if self.screen is Screen.RECORD:  # the screen shows the turn since then, and its time counts from there
            self._turn_from, self.screen = self._since, Screen.TURN
        else:
            self._turn_from = self._now()
            self._go_to(Screen.TURN)

    def step(self, now: float) -> None:
        """Go on by a sixtieth of a second."""
        if self.screen is Screen.TURN:
            self._turn(now)
        elif self.screen is Screen.TRIAL:
            self._run_trial(now)
        elif self.screen is Screen.RECORD:
            self._record(now)

    def _turn(self, now: float) -> None:
        """Turn in one fixed time, whatever changes; a turn that takes longer is done again."""
        if self._rig.lost:
            self._is_turning, self._turn_from = False, now
            self._rig.begin()
        elif not self._is_turning:
            self._order_turn()
        elif now - self._turn_from >= self.plan.turn and self._rig.is_ready:
            self._begin_interval(now)
        elif now - self._turn_from >= self.plan.turn:
            self._late += 1
            self._outcome = replace(self._outcome, late_turn=True)
            if self._late >= LATE_TURNS:
                self._rig.lost = True
                return
            self._turn_from = now
            self._order_turn()
            self._go_to(Screen.TURN)

    def _order_turn(self) -> None:
        if self._late:  # an end may be about to write there yet, so it is removed with the trial's
            self._stale.append(self._rig.folders["m"])
        knobs, scene = self._scenes[self._interval]
        self._rig.turn(knobs, home_of(scene))
        self._is_turning = True

    def _begin_interval(self, now: float) -> None:
        self._first_tick = self._rig.tick
        self._drag, self._ordered = Drag(), None
        assert self._step is not None
        assert self._step.trial is not None
        self._mark(f"trial {self._step.trial.number} interval {self._interval + 1}")
        self._go_to(Screen.TRIAL)

    def _run_trial(self, now: float) -> None:
        if self._rig.lost:
            self._cut("The robot had to be started again. The trial begins again when you go on.")
            return
        to = self._drag.target(now)
        if to is not None and to != self._ordered:
            self._rig.steer(to)
            self._ordered = to
        if (picture := self.picture()) is not None:
            self._show(picture)
        if now - self._since >= self.plan.task.seconds or self._has_arrived():
            self._end_interval(now)

    def _has_arrived(self) -> bool:
        """True if a reach has come to rest, beyond half of its distance."""
        assert self._step is not None
        trial, count = self._step.trial, round(REST / self._scenes[0][1].dt)
        if self.plan.task.kind is not TaskKind.REACH or trial is None:
            return False
        path = [at[0] for at in self._rig.path("s", count)]
        return len(path) == count and max(path) - min(path) <= STILL and path[0] >= HALFWAY * trial.level

    def _end_interval(self, now: float) -> None:
        last = self._rig.tick
        self._recorded.append(self._rig.folders)
        self._spans.append((self._first_tick or 0, last or 0))
        self._interval += 1
        self._mark("end")
        if self._interval < len(self._scenes):
            self._begin_turn()
            return
        self._rig.let_go()
        self._answered_from = now
        self._go_to(Screen.ANSWER if self.plan.task.kind is TaskKind.COMPARE else Screen.RECORD)

    def _record(self, now: float) -> None:
        """Write the trial's line as soon as its records are whole."""
        if not self._rig.lost and not self._rig.is_recorded and now - self._since < RECORDING:
            self._rig.end_record()
            return
        assert self._step is not None
        assert self._step.trial is not None
        trial = self._step.trial
        movements = []
        try:
            for i, (folders, span) in enumerate(zip(self._recorded, self._spans, strict=True)):
                keep(folders, self.study.records(self.participant, trial)[i])
                movements.append(measure(self.plan.task.kind, trial, folders, span, self._scenes[i][1].dt))
        except (Refused, OSError) as error:
            self._report(f"trial {trial.number}: the record is not whole ({type(error).__name__})")
            self._cut("The trial could not be recorded. It begins again when you go on.")
            return
        self._write(trial, measured(self._outcome, movements, self._rig.live))
        self._next(now)

    def _write(self, trial: Trial, outcome: TrialOutcome) -> None:
        outcome = replace(outcome, refresh=self._refresh, seconds=round(self._now() - self._began, 3))
        self._journal.append(trial_row(self.plan, trial, outcome))
        self._drop_records()

    def _drop_records(self) -> None:
        self._rig.drop([*self._stale, *(folders["m"] for folders in self._recorded)])
        self._recorded, self._stale = [], []

    # stop, cut and withdrawn

    def _stop(self) -> None:
        """Bring the force to zero, and mark the trial that goes on."""
        self._rig.let_go()
        self._mark("stop")
        if self.screen in (Screen.TURN, Screen.TRIAL, Screen.ANSWER, Screen.RECORD):
            assert self._step is not None
            assert self._step.trial is not None
            self._write(self._step.trial, replace(self._outcome, stopped=True, answer=None, time=None))
            self._report(f"trial {self._step.trial.number}: stopped by the participant")
            self._go_to(Screen.STOPPED)

    def _cut(self, sentence: str) -> None:
        """Give up a trial, which is run again."""
        self._rig.let_go()
        self._drop_records()
        self._mark("cut")
        self._go_to(Screen.STOPPED)
        self._tell(sentence_message("warn", sentence))

    def _withdraw(self) -> None:
        """Remove all that there is of the person."""
        if self.screen is Screen.WITHDRAWN:
            return
        self._rig.let_go()
        self._journal.close()
        self.study.withdraw(self.participant)
        self._report("the participant has withdrawn: all that was recorded of the person is removed")
        self._go_to(Screen.WITHDRAWN)

    # what the screen is sent

    def _go_to(self, screen: Screen) -> None:
        self.screen, self._since = screen, self._now()
        self._tell(self.screen_message())

    def screen_message(self) -> str:
        """The message that says what is to be shown, and what can be done there.

        While the records of a trial are completed it shows the turn to the next one, if there is one: how long that
        takes goes by the law, and is not seen.
        """
        fields: dict[str, Any] = {}
        plan, step, name = self.plan, self._step, self.screen
        done = len(of_kind(self._journal.rows, StepKind.TRIAL.value)) if self.screen is not Screen.WITHDRAWN else 0
        following = None
        if self.screen is Screen.RECORD:
            assert step is not None
            assert step.trial is not None
            rows = [*self._journal.rows, trial_row(plan, step.trial, self._outcome)]
            following = next_step(plan, self.study.key.felt, self.participant, rows).trial
            name, done = Screen.RECORD if following is None else Screen.TURN, done + 1
        if self.screen is Screen.CONSENT:
            fields = {"text": plan.consent}
        elif self.screen is Screen.ANSWER:
            fields = {"text": ASKED.get(plan.task.knob, ASKED[""])}
        elif self.screen is Screen.INSTRUCTIONS:
            fields = {"text": plan.task.text or TASKS[plan.task.kind], "training": plan.training,
                      "pointer": self._device is None, "resumed": done > 0}
        elif following is not None:
            fields = {"seconds": plan.turn, "interval": 1, "intervals": len(self._scenes),
                      "training": following.training}
        elif self.screen is Screen.TURN:
            fields = {"seconds": plan.turn, "interval": self._interval + 1, "intervals": len(self._scenes),
                      "training": step is not None and step.trial is not None and step.trial.training}
        elif self.screen is Screen.TRIAL:
            fields = {"seconds": plan.task.seconds, "interval": self._interval + 1, "intervals": len(self._scenes),
                      "text": plan.task.text or TASKS[plan.task.kind]}
        elif self.screen is Screen.BREAK and step is not None:
            fields = {"seconds": max(0.0, step.seconds - (self._now() - self._since))}
        elif self.screen is Screen.QUESTION and step is not None:
            fields = question_fields(plan.questions[step.question])
        return json_text({"type": "screen", "screen": name.value, "done": done, "trials": trials_of(plan),
                          "noun": "wall" if with_stiffness(plan) else "part", **fields})

    def picture_of_stage(self) -> str:
        """The message with what stands still: axes, span, the wall and the target, as far as the plan shows them."""
        scene = self._scenes[min(self._interval, len(self._scenes) - 1)][1] if self._scenes else self._controls.first
        stage = self._controls.stage(scene)
        shown = self.plan.task.show
        trial = None if self._step is None else self._step.trial
        target: dict[str, Any] | None = None
        if trial is not None and self.plan.task.kind is TaskKind.REACH:
            target = {"at": trial.level, "width": trial.width, "of": "slave"}
        elif trial is not None and self.plan.task.kind is TaskKind.PRESS and self._device is None:
            hand: Any = scene.per_axis("hand")[0]
            target = {"at": trial.level / hand.k, "width": 0.0, "of": "hand"}
        span = stage["span"] if target is None else max(stage["span"], 2.5 * abs(target["at"]))
        return json_text({"type": "stage", "axes": stage["axes"], "span": span, "target": target,
                          "wall": stage["wall"] if "wall" in shown else None})

    def picture(self) -> str | None:
        """The message with where hand, master and slave are, as far as the plan shows them; None before they are."""
        places = self._rig.places()
        if places["master"] is None:
            return None
        shown = {key: places[each] for each, key in _KEYS.items() if each in self.plan.task.show}
        return json_text({"type": "rows", **{key: [round(x, 5) for x in at] for key, at in shown.items() if at}})


def question_fields(question: StudyQuestion) -> dict[str, Any]:
    """Fields of a question that the screen needs."""
    if question.kind is QuestionKind.TLX:
        return {"kind": "tlx", "items": list(TLX_ITEMS), "pairs": [list(pair) for pair in PAIRS] * question.weighted}
    return {"kind": question.kind.value, "items": list(question.items), "points": question.points}


def measured(outcome: TrialOutcome, movements: Sequence[Movement], live: Mapping[str, Mapping[str, Any]]
             ) -> TrialOutcome:
    """The outcome of a trial with what was measured in its intervals: of two the worse, of the movement the last."""
    last = movements[-1]
    delays = [each.delay for each in movements if each.delay is not None]
    return replace(outcome, time=last.time if outcome.time is None else outcome.time, end=last.end,
                   overshoot=last.overshoot, peak_force=max(each.peak_force for each in movements),
                   delay=max(delays, default=None), loss=lost_share(live),
                   skipped=max(each.skipped for each in movements))


def trial_scene(name: str, knobs: Mapping[str, object]) -> tuple[dict[str, str], Scene]:
    """The knobs of an interval as texts, and its scene, which goes on as long as it has to. Raises `Refused`."""
    typed = live_knobs(name, {**{key: knob_text(value) for key, value in knobs.items()}, "duration": OPEN_ENDED})
    return typed, both_ends(load_scene(name, **typed))


def knob_text(value: object) -> str:
    """A knob as it is typed.

    >>> knob_text(0.05), knob_text("wave"), knob_text((1.0, 2.0)), knob_text(True)
    ('0.05', 'wave', '1.0,2.0', 'true')
    """
    if isinstance(value, tuple):
        return ",".join(map(knob_text, value))
    return value if isinstance(value, str) else str(value).lower() if isinstance(value, bool) else repr(value)


def home_of(scene: Scene) -> tuple[float, ...]:
    """Place of the hand before anything moves, m per axis."""
    reference: Any = scene.reference
    if reference is None:
        return (0.0,) * scene.axes
    return tuple(path[0] for path in reference.samples(scene.axes, 1, scene.dt_ns))

