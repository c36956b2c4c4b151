"""Plans for tests, as texts and as plans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from teleop.people.plan import LevelMethod, StudyCondition, StudyPlan
from teleop.people.plan_file import read_plan

TEXT = """
name = "small"
scene = "hard_wall"
set = {delay = 0.02, duration = 4.0}
seed = 5
[participants]
least = 4
most = 8
multiple_of = 2
[[condition]]
name = "smooth"
set = {law = "wave"}
[[condition]]
name = "stiff"
set = {law = "pp", "law.K" = 1000.0, "law.B" = 10.0}
[task]
kind = "compare"
standard = 500.0
levels = [350.0, 700.0, 1000.0]
repeats = 4
[training]
trials = 2
[breaks]
every = 6
seconds = 30
[[question]]
kind = "tlx"
weighted = true
[[question]]
kind = "text"
after = "session"
items = ["Anything else?"]
[exclusion]
least_correct = 0.5
[analysis]
primary = "w"
contrasts = [["smooth", "stiff"]]
[simulated]
w = 0.15
"""

REACH = """
name = "reaches"
scene = "free_motion"
[participants]
least = 2
most = 8
[[condition]]
name = "smooth"
set = {law = "wave"}
[[condition]]
name = "stiff"
set = {law = "pp"}
[task]
kind = "reach"
distances = [0.02, 0.05]
widths = [0.004]
repeats = 3
[[question]]
kind = "likert"
items = ["It moved as I wanted."]
[analysis]
primary = "time"
contrasts = [["smooth", "stiff"]]
"""


def plan_of(text: str) -> StudyPlan:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "plan.toml"
        path.write_text(text)
        return read_plan(path)


def comparison(conditions: int = 2, method: LevelMethod = LevelMethod.CONSTANT) -> StudyPlan:
    """The plan of a comparison, with so many conditions, by this method."""
    plan = plan_of(TEXT)
    if method is not LevelMethod.CONSTANT:
        plan = replace(plan, task=replace(plan.task, method=method, levels=(1000.0, 850.0, 700.0, 600.0), trials=12))
    return replace(plan, conditions=tuple(StudyCondition(name=f"c{i}", knobs={}) for i in range(conditions)))
