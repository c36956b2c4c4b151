"""The plan of an experiment with people: what is asked of whom, how often, and how it is analysed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from hashlib import sha256
from typing import Any

from teleop.storage.strict_json import json_text


class Design(StrEnum):
    """Design: each person meets every condition, or one."""

    WITHIN = "within"
    BETWEEN = "between"


class Order(StrEnum):
    """Order in which a person meets the conditions."""

    WILLIAMS = "williams"
    RANDOM = "random"


class TaskKind(StrEnum):
    """Kind of a trial."""

    REACH = "reach"  # the slave is brought to a target
    PRESS = "press"  # the wall is pressed with a force
    COMPARE = "compare"  # two intervals with walls of two stiffnesses: which is stiffer
    FREE = "free"  # nothing is asked but the questions behind


class LevelMethod(StrEnum):
    """Method by which the levels of a comparison are chosen."""

    CONSTANT = "constant"
    STAIRCASE = "staircase"
    QUEST = "quest"


class QuestionKind(StrEnum):
    """Kind of a question."""

    TLX = "tlx"
    LIKERT = "likert"
    TEXT = "text"


class Measure(StrEnum):
    """A number of a person in a condition, which contrasts compare."""

    W = "w"  # Weber fraction of felt stiffness
    BIAS = "bias"  # towards the second interval, in ln of felt stiffness
    CORRECT = "correct"  # share of correct answers
    TIME = "time"  # s, geometric mean
    OVERSHOOT = "overshoot"  # m of a reach, N of a press
    PEAK_FORCE = "peak_force"  # N
    THROUGHPUT = "throughput"  # bit/s, ISO 9241-411
    TLX = "tlx"  # workload, 0 to 100


ON_A_LOG_SCALE = (Measure.W, Measure.TIME)  # measures that are ratios: compared by their logarithms
OF_TASK = {
    TaskKind.REACH: (Measure.TIME, Measure.OVERSHOOT, Measure.THROUGHPUT, Measure.CORRECT, Measure.PEAK_FORCE,
                     Measure.TLX),
    TaskKind.PRESS: (Measure.OVERSHOOT, Measure.PEAK_FORCE, Measure.TIME, Measure.TLX),
    TaskKind.COMPARE: (Measure.W, Measure.BIAS, Measure.CORRECT, Measure.TIME, Measure.PEAK_FORCE, Measure.TLX),
    TaskKind.FREE: (Measure.TLX, Measure.PEAK_FORCE, Measure.TIME),
}
UNITS = {Measure.TIME: "s", Measure.PEAK_FORCE: "N", Measure.THROUGHPUT: "bit/s"}


class Correction(StrEnum):
    """Correction of p values for the number of contrasts."""

    HOLM = "holm"
    NONE = "none"


class After(StrEnum):
    """Place of a question in the session."""

    CONDITION = "condition"
    SESSION = "session"


@dataclass(frozen=True, kw_only=True, slots=True)
class Participants:
    """Numbers of people who take part."""

    least: int
    most: int
    multiple_of: int = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class StudyCondition:
    """A condition: its name, which nobody sees before the study is unblinded, and its knobs."""

    name: str
    knobs: Mapping[str, object]


SHOWN = ("hand", "master", "slave", "wall")


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialTask:
    """Work of a person in a trial, and what differs from trial to trial within a condition.

    compare: `levels` are stiffnesses (N/m) of the scene's knob `knob`, each beside `standard`, in a changing order.
    Every level `repeats` times (constant stimuli), or for so many `trials` as the answers decide: `down` correct
    answers lead to the next level, one wrong answer back (staircase, levels from the easiest to the hardest), or the
    level from which most is expected (quest). reach: each of `distances` with each of `widths`, m. press: `forces`, N.
    """

    kind: TaskKind
    seconds: float = 2.6  # of an interval, which has the trial's hand
    intervals: int = 1
    knob: str = "k_e"
    standard: float = 0.0
    levels: tuple[float, ...] = ()
    method: LevelMethod = LevelMethod.CONSTANT
    repeats: int = 1
    trials: int = 40
    down: int = 2
    distances: tuple[float, ...] = ()
    widths: tuple[float, ...] = ()
    forces: tuple[float, ...] = ()
    text: str = ""  # the instruction that the participant reads; empty: the task's own
    show: tuple[str, ...] = SHOWN  # what the participant sees of the robot

    @property
    def per_condition(self) -> int:
        """Trials of a person in a condition, training apart."""
        if self.kind is TaskKind.COMPARE and self.method is not LevelMethod.CONSTANT:
            return self.trials
        return self.repeats * max(1, len(self.targets))

    @property
    def targets(self) -> tuple[tuple[float, float], ...]:
        """The level of each trial of a round, and the width of its target where it has one."""
        if self.kind is TaskKind.REACH:
            return tuple((distance, width) for distance in self.distances for width in self.widths)
        return tuple((level, 0.0) for level in (self.forces if self.kind is TaskKind.PRESS else self.levels))


@dataclass(frozen=True, kw_only=True, slots=True)
class StudyQuestion:
    """A question of a questionnaire: NASA-TLX with its six items, a scale with `items`, or a text."""

    kind: QuestionKind
    items: tuple[str, ...] = ()
    points: int = 7
    weighted: bool = False
    after: After = After.CONDITION


@dataclass(frozen=True, kw_only=True, slots=True)
class Exclusion:
    """Rules by which trials, and people, are left out of the analysis; a rule that is not named leaves nothing out."""

    shortest: float | None = None  # s, a trial's answer comes no sooner
    longest: float | None = None  # s
    most_skipped: float | None = None  # share of the ticks
    most_loss: float | None = None  # share of the packets, beyond the link's own
    focus_lost: bool = False  # a trial during which the page was not in front
    again: bool = False  # a trial that was cut, and run again
    least_correct: float | None = None  # share of a person's answers
    least_trials: float | None = None  # share of a person's trials that are left by the rules before


@dataclass(frozen=True, kw_only=True, slots=True)
class Analysis:
    """The primary analysis: a measure, and the pairs of conditions between which it is compared."""

    primary: Measure
    contrasts: tuple[tuple[str, str], ...]
    correction: Correction = Correction.HOLM
    alpha: float = 0.05
    lapse: float = 0.02  # share of answers by chance that a person's fit reckons with


@dataclass(frozen=True, kw_only=True, slots=True)
class Power:
    """The least effect of interest, in standard deviations of the difference, and the power to find it with."""

    d_z: float
    power: float = 0.8


@dataclass(frozen=True, kw_only=True, slots=True)
class Simulated:
    """People as the simulation has them: means, spread between people, and what conditions and places change."""

    w: float = 0.15  # Weber fraction of felt stiffness, of one interval
    bias: float = 0.0  # towards the second interval, in ln of felt stiffness
    lapse: float = 0.02  # share of answers by chance
    spread: float = 0.2  # standard deviation between people, of ln w and of ln of their times
    within: float = 0.1  # the same between conditions of one person
    learning: float = 0.0  # change of ln w and of ln of times with each place
    pause: float = 0.2  # s, Fitts: time = pause + slope log2(distance/width + 1)
    slope: float = 0.15  # s/bit
    effects: Mapping[str, float] = field(default_factory=dict)  # of a condition by its name, on ln w and ln of times


@dataclass(frozen=True, kw_only=True, slots=True)
class StudyPlan:
    """The plan of a study. `teleop.people.plan_file` reads and checks it."""

    name: str
    design: Design
    order: Order
    scene: str
    knobs: Mapping[str, object]
    seed: int
    turn: float
    participants: Participants
    conditions: tuple[StudyCondition, ...]
    task: TrialTask
    training: int
    break_every: int  # trials; 0: no breaks
    break_seconds: float
    questions: tuple[StudyQuestion, ...]
    exclusion: Exclusion
    analysis: Analysis
    power: Power | None
    simulated: Simulated
    consent: str
    source: str  # the file's text

    @property
    def digest(self) -> str:
        """The digest of all that the plan says, whatever its comments and its line ends."""
        import tomllib

        return sha256(json_text(_ordered(tomllib.loads(self.source))).encode()).hexdigest()

    @property
    def rows(self) -> int:
        """Number of people who make a balanced set."""
        n = len(self.conditions)
        if self.design is Design.BETWEEN:
            return n
        return 1 if self.order is Order.RANDOM else 2 * n if n % 2 and n > 1 else n

    @property
    def conditions_each(self) -> int:
        """Number of conditions that each person meets."""
        return 1 if self.design is Design.BETWEEN else len(self.conditions)

    def condition(self, name: str) -> StudyCondition:
        """The condition of this name."""
        return next(each for each in self.conditions if each.name == name)


def _ordered(value: Any) -> Any:
    """The value with all its tables in the order of their keys."""
    if isinstance(value, dict):
        return {key: _ordered(value[key]) for key in sorted(value)}
    return [_ordered(each) for each in value] if isinstance(value, list) else value
