"""A session's lines: what a trial, a break and a questionnaire leave in the journal, and what each answer must be."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from teleop.errors import Refused
from teleop.people.felt import STIFFNESS
from teleop.people.plan import Measure, QuestionKind, StudyPlan, TaskKind
from teleop.people.schedule import LETTERS, Step, StepKind, Trial
from teleop.people.scores import PAIRS, TLX_ITEMS
from teleop.storage.strict_json import Misshapen, list_of, one_of, optional, real, record, text, truth, whole

VISUAL, HAPTIC = "visual", "haptic"  # modalities of a device
SHOWN_AFTER = 0.1  # s: a page shows the master 37 to 80 ms after the event, whatever the link does


def check_modality(plan: StudyPlan, measure: Measure, modalities: Iterable[object]) -> None:
    """Refuse a study of what no pointer can show; a mouse displays no force. Raises `Refused`."""
    if VISUAL not in set(modalities) or plan.task.kind is not TaskKind.COMPARE:
        return
    if plan.task.knob == STIFFNESS and measure in (Measure.W, Measure.BIAS, Measure.CORRECT):
        raise Refused("a pointer displays no force, so its trials say nothing of felt stiffness; take a haptic device, "
                      "--device NAME, or a task reach or press")
    steps = [abs(level - plan.task.standard) for level in plan.task.levels]
    if plan.task.knob == "delay" and min(steps) < SHOWN_AFTER:
        raise Refused(f"a page shows the master 58 ms after the event, 37 to 80, so {min(steps):g} s of delay cannot "
                      f"be judged with a pointer; take steps of {SHOWN_AFTER:g} s at least, or a haptic device "
                      "(--device NAME)")


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialOutcome:
    """Outcome of a trial; None where it does not exist, or was not measured."""

    answer: int | None = None  # the interval that was stiffer, 1 or 2
    time: float | None = None  # s: of the reach or press, or from the end of the last interval to the answer
    end: float | None = None  # m, where the reach ended
    overshoot: float | None = None  # m of a reach, N of a press
    peak_force: float | None = None  # N, against the hand
    delay: float | None = None  # s, measured, round trip
    loss: float | None = None  # share of the packets
    skipped: float | None = None  # share of the ticks
    device: str = "simulated"
    modality: str = "simulated"  # visual for a pointer, haptic for a device that renders force
    refresh: float | None = None  # Hz, of the screen
    focus_lost: bool = False  # the page was not in front all the time
    late_turn: bool = False  # the turn before took longer than the plan's time, and was done again
    stopped: bool = False  # Stop: the force went to zero
    again: int = 0  # how often this trial was cut before, and run again
    seconds: float | None = None  # since the session began


def session_row(plan: StudyPlan, participant: int, code: str, *, simulated: bool = False) -> dict[str, Any]:
    """The first line of a journal."""
    return {"kind": "session", "study": plan.name, "plan": plan.digest, "participant": participant, "code": code,
            "simulated": simulated}


def trial_row(plan: StudyPlan, trial: Trial, outcome: TrialOutcome) -> dict[str, Any]:
    """The line of a trial."""
    return {"kind": StepKind.TRIAL.value, **asdict(trial), **asdict(outcome),
            "correct": is_correct(plan, trial, outcome)}


def is_correct(plan: StudyPlan, trial: Trial, outcome: TrialOutcome) -> bool | None:
    """True for the stiffer interval, or an end within the target; None where nothing is right or wrong."""
    if plan.task.kind is TaskKind.COMPARE and outcome.answer is not None:
        return outcome.answer == (2 if trial.second == (trial.level > plan.task.standard) else 1)
    if plan.task.kind is TaskKind.REACH and outcome.end is not None:
        return abs(outcome.end - trial.level) <= 0.5 * trial.width
    return None


_TRIAL = record({
    "number": whole(low=1), "letter": one_of(*LETTERS), "place": whole(low=1), "training": truth, "level": real,
    "width": real, "second": truth, "answer": optional(whole(low=1, high=2)), "correct": optional(truth),
    **{name: optional(real) for name in ("time", "end", "overshoot", "peak_force", "delay", "loss", "skipped")},
    "focus_lost": truth, "stopped": truth, "again": whole(low=0)})
_ANSWER = record({"question": whole(low=0), "letter": one_of("", *LETTERS), "place": whole(low=0)}, {
    "ratings": list_of(real), "chosen": list_of(whole(low=0, high=5)), "points": list_of(real), "texts": list_of(text)})


def check_row(plan: StudyPlan, row: Mapping[str, Any], where: str) -> None:
    """Refuse a line that no session of this plan writes. Raises `Refused`."""
    try:
        if row["kind"] == StepKind.TRIAL:
            _TRIAL(row, "the trial")
            if plan.task.kind is TaskKind.COMPARE and row["level"] not in plan.task.levels:
                raise Misshapen(f"the plan has no level {row['level']:g}")
        if row["kind"] == StepKind.QUESTION:
            _ANSWER(row, "the answer")
            step = Step(kind=StepKind.QUESTION, question=row["question"], letter=row["letter"], place=row["place"])
            if step.question >= len(plan.questions):
                raise Misshapen(f"the plan has {len(plan.questions)} questions")
            answer_row(plan, step, row)
    except (Misshapen, Refused) as error:
        raise Refused(f"{where} is no line of this study ({error}); put it back from a copy") from None


def break_row(step: Step, seconds: float) -> dict[str, Any]:
    """The line of a break that lasted so long."""
    return {"kind": StepKind.BREAK.value, "letter": step.letter, "place": step.place, "seconds": seconds}


def answer_row(plan: StudyPlan, step: Step, answers: Mapping[str, Any]) -> dict[str, Any]:
    """The line of a questionnaire's answers: `ratings` and `chosen`, `points`, or `texts`. Raises `Refused`."""
    question = plan.questions[step.question]
    count, low, high, key = {
        QuestionKind.TLX: (len(TLX_ITEMS), 0, 100, "ratings"),
        QuestionKind.LIKERT: (len(question.items), 1, question.points, "points"),
        QuestionKind.TEXT: (len(question.items), 0, 0, "texts"),
    }[question.kind]
    values = answers.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise Refused(f"question {step.question + 1} has {count} {key}; answer each of them")
    if question.kind is QuestionKind.TEXT:
        return {"kind": StepKind.QUESTION.value, "question": step.question, "letter": step.letter, "place": step.place,
                "texts": [str(each)[:4000] for each in values]}
    if not all(isinstance(each, int | float) and not isinstance(each, bool) and low <= each <= high for each in values):
        raise Refused(f"question {step.question + 1}: each answer lies between {low} and {high}; answer it again")
    row = {"kind": StepKind.QUESTION.value, "question": step.question, "letter": step.letter, "place": step.place,
           key: values}
    if question.weighted:
        chosen = answers.get("chosen")
        if not isinstance(chosen, list) or len(chosen) != len(PAIRS) or not all(
                each in pair for each, pair in zip(chosen, PAIRS, strict=True)):
            raise Refused(f"question {step.question + 1} compares {len(PAIRS)} pairs of items; choose one of each")
        row["chosen"] = chosen
    return row
