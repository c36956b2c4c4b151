"""The command `teleop stability`."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping
from functools import partial
from typing import Any

from teleop.analysis.stability.assess import Stability
from teleop.analysis.stability.report import StabilityAnswer, ask, summary, table
from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.simulation.result import write_npz
from teleop.terminal.answer import Answer, Task, command_of, interrupts_wait
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.plotting import asked_formats
from teleop.terminal.progress import shown_for


def find(args: Namespace) -> Task:
    """Judge the scene and find its margins.

    An interrupt of the search for a critical value, or of the margins over its knob, leaves what is known until then.
    Raises `Refused`, and the task KeyboardInterrupt before the search.
    """
    formats = asked_formats(args)
    if formats and args.time:
        raise Refused("a plot shows the roots and the open loop, which a run in virtual time does not have; leave "
                      f"--plot out, or see the motion itself: teleop run {args.scene} --plot")
    knobs = knobs_from(args)
    scene = load_scene(args.scene, **knobs)

    def work() -> Answer:
        with shown_for(args) as show:
            judged = ask(args.scene, knobs, seed=args.seed, in_time=args.time, continuous=args.continuous,
                        knob=args.critical, span=args.range, tol=args.tol, show=show)
        return _with_plots(args, judged) if formats else _answer(args, judged)

    return Task(scene.name, work)


def _answer(args: Namespace, judged: StabilityAnswer, drawn: Mapping[str, Any] | None = None) -> Answer:
    return Answer(table(judged), summary(judged, args.typed, drawn), DONE if judged.finished else INTERRUPTED)


def _with_plots(args: Namespace, judged: StabilityAnswer) -> Answer:
    """The answer with its plots and the numbers behind them."""
    from teleop.analysis.stability.picture import curves, numbers, picture, sweep
    from teleop.analysis.stability.plot import draw, draw_swept

    swept = None
    if judged.edge is not None:
        knobs, knob, values = knobs_from(args), judged.edge.knob, judged.places
        try:
            with shown_for(args) as show:
                swept = sweep(lambda value: load_scene(args.scene, **{**knobs, knob: value}), values, seed=args.seed,
                              tell=lambda done: show(done / len(values), f"margins over {knob}"))
        except KeyboardInterrupt:
            judged = judged._replace(cut_short=True)
    stability = judged.assessment
    assert isinstance(stability, Stability)  # `find` refuses the other
    with interrupts_wait():
        drawn = picture(judged.scene, unstable=stability.unstable > 0, gain_margin=stability.gain_margin,
                        seed=args.seed)
    plots = {"stability": partial(draw, judged, drawn)}
    if swept is not None:
        plots["critical"] = partial(draw_swept, judged, swept)
    return _answer(args, judged, numbers(drawn))._replace(
        files={"curves.npz": partial(write_npz, arrays=curves(drawn, swept))}, plots=plots)


command = command_of(find, "stability", always=False)
