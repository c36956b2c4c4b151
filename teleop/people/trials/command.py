"""Command `teleop study run`: serve the screen of a participant until the session is over, or Ctrl-C."""

from __future__ import annotations

import asyncio
import shutil
import time
from argparse import Namespace
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from secrets import randbits
from tempfile import mkstemp
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.live.devices.opening import find_device
from teleop.live.page.command import NEEDS, before_others, begin_page, check_port, page_address, page_bytes, say
from teleop.live.page.controls import Controls
from teleop.live.page.session import Start, size_text
from teleop.live.process import output
from teleop.live.process.interrupt import Interrupt
from teleop.people.felt import knobs_of
from teleop.people.journal import NAME, of_kind, read_journal
from teleop.people.plan import StudyPlan
from teleop.people.plan_file import read_plan
from teleop.people.schedule import disk_of, seconds_of, trials_of
from teleop.people.session import VISUAL, check_modality
from teleop.people.study import STUDY, Study, check_lock, check_participant, create_study, open_study
from teleop.people.trials.markers import lsl_markers, silent
from teleop.people.trials.records import private_file
from teleop.people.trials.rig import Rig, private_folder
from teleop.scene.scene import Scene
from teleop.terminal.answer import Answer
from teleop.terminal.table import duration, facts

if TYPE_CHECKING:  # both need websockets
    from teleop.live.page.server import Clients
    from teleop.people.trials.conduct import TrialConduct

DOCUMENT = Path(__file__).with_name("screen.html")
LAST = "study.json"  # port and token of the last screen
MOST_AXES = 3  # that are shown
PERIOD = 1.0 / 60.0  # s between two pictures
OVER = 0.5  # s for the last message to reach the screen
ROOM = 1.5  # of what a session needs on the disk, that has to be free
NO_HANDLES = ("simulated", "csv")  # devices without a person
TROUBLE = "trouble.txt"  # of a session: sentences of the three processes, which may name a law


def run(args: Namespace, head: Callable[[StudyPlan, str], dict[str, Any]]) -> Answer:
    """Carry a participant's session on to its end. Raises `Refused`."""
    try:
        from teleop.people.trials.conduct import SHAPES, TrialConduct
    except ImportError as error:
        if (error.name or "").partition(".")[0] != "websockets":
            raise
        raise Refused(NEEDS.replace("teleop demo --page", "teleop study run")) from error
    from teleop.live.page.server import Clients, Requests

    path, number = Path(args.plan), args.participant
    check_port(args.port)
    plan = read_plan(path)
    check_lock(path, plan)
    check_participant(plan, number)
    check_device(plan, args.device)
    folder = Path(args.out or Path("runs") / f"study-{plan.name}")
    is_there = (folder / STUDY).exists()
    rows = read_journal(folder / f"sub-{number:02d}" / NAME) if is_there else []
    if bool(rows) != args.resume:
        raise Refused(f"participant {number} has begun already; add --resume to go on" if rows else
                      f"participant {number} has not begun yet; leave --resume out")
    controls = Controls(plan.scene, shared_knobs(plan))
    check_scenes(plan, controls.first)
    needed = disk_of(plan)
    free = shutil.disk_usage(next(each for each in (folder, *folder.absolute().parents) if each.is_dir())).free
    if free < ROOM * needed:
        raise Refused(f"a session leaves {size_text(needed)}, and the disk of {folder} has {size_text(free)} left; "
                      "free some space")
    mark = lsl_markers(plan.name, number) if args.lsl else silent
    study = open_study(folder, plan, simulated=False) if is_there else create_study(plan, folder, entropy=randbits(192))
    port, token = page_address(args.port, LAST)
    way = Path(mkstemp(suffix=".html")[1]) if args.open else None
    records = private_folder(study.folder / f".live-{number:02d}")
    try:
        with output.live(), Interrupt() as interrupt, study.journal(number) as journal, before_others(
                wanted=args.realtime):
            say(f"participant {number}: {trials_of(plan)} trials, about {duration(seconds_of(plan))}, "
                f"{size_text(needed)} on the disk")
            start = Start(plan.scene, plan.seed + number, args.realtime, device=args.device)
            rig = Rig(start, shared_knobs(plan), records, partial(_note_trouble, study, number))
            conduct = TrialConduct(
                study, number, journal, rig, controls, now=time.monotonic, report=say, mark=mark, device=args.device,
                show=lambda text: clients.show(text),  # noqa: PLW0108 - their host is the conduct, made first
                tell=lambda text: clients.tell(text))  # noqa: PLW0108 - as above
            clients = Clients(Requests(page_bytes(DOCUMENT), token), conduct, time.monotonic, shapes=SHAPES,
                              longest=1 << 16, most=1)
            asyncio.run(_serve(clients, conduct, rig, interrupt, port, partial(begin_page, token, way, last_page=LAST)))
    finally:
        shutil.rmtree(records, ignore_errors=True)
        if way is not None:
            way.unlink(missing_ok=True)
    return _answer(study, number, head)


async def _serve(clients: Clients, conduct: TrialConduct, rig: Rig, interrupt: Interrupt, port: int,
                 listening: Callable[[int], None]) -> None:
    """Serve until the session is over or a signal comes."""
    listening(await clients.serve(port))
    rig.begin()
    try:
        due = time.monotonic()
        while interrupt.name is None and not conduct.is_over:
            rig.read()
            conduct.step(time.monotonic())
            due = max(due + PERIOD, time.monotonic())
            await asyncio.sleep(due - time.monotonic())
        if conduct.is_over:
            await asyncio.sleep(OVER)
    finally:
        await rig.leave(interrupt)
        await clients.close("the session was ended where it was started")


def _answer(study: Study, number: int, head: Callable[[StudyPlan, str], dict[str, Any]]) -> Answer:
    study.write_tables()
    plan = study.plan
    path = study.home(number) / NAME
    rows = read_journal(path)
    done = len(of_kind(rows, "trial"))
    if not path.exists():
        sentence = "withdrawn: nothing of the person is left"
    elif not rows:
        sentence = "no consent was given"
        shutil.rmtree(study.home(number), ignore_errors=True)
    else:
        sentence = f"{done} of {trials_of(plan)} trials"
    is_whole = done == trials_of(plan)
    after = f"teleop study analyse {study.folder}" if is_whole or not rows else (
        f"teleop study run PLAN.toml --participant {number} --resume")
    text = facts([("study", plan.name), ("participant", f"{number}: {sentence}"), ("next", after)])
    document = {**head(plan, sentence), "participant": number, "trials": done, "of": trials_of(plan)}
    return Answer(text, document).kept_in(study.folder)


def check_scenes(plan: StudyPlan, first: Scene) -> None:
    """Refuse a plan with a trial that the running ends could not turn to. Raises `Refused`."""
    from teleop.people.trials.conduct import trial_scene

    if first.axes > MOST_AXES:
        raise Refused(f"the screen shows up to {MOST_AXES} axes, and scene {plan.scene} has {first.axes}; take a scene "
                      "with fewer")
    for condition in plan.conditions:
        for level in (plan.task.standard, *plan.task.levels):
            _, scene = trial_scene(plan.scene, knobs_of(plan, condition, level))
            if (scene.dt_ns, scene.axes) != (first.dt_ns, first.axes):
                raise Refused(f"condition {condition.name!r} has other ticks or axes than the scene, and a trial goes "
                              "on with both; leave them out of its set")


def check_device(plan: StudyPlan, device: str | None) -> None:
    """Refuse a plan that the device cannot carry out; None: a pointer. Raises `Refused`."""
    if device is None:
        check_modality(plan, plan.analysis.primary, [VISUAL])
        return
    find_device("m", device)
    if device.partition(":")[0] in NO_HANDLES:
        raise Refused(f"--device {device} puts no handle into anybody's hand; name a haptic device, or leave --device "
                      "out for a mouse")


def shared_knobs(plan: StudyPlan) -> dict[str, str]:
    """The knobs that all trials share, but for law and duration: what may stand on a command line."""
    from teleop.people.trials.conduct import knob_text

    return {name: knob_text(value) for name, value in plan.knobs.items()
            if name.partition(".")[0] not in ("law", "duration")}


def _note_trouble(study: Study, number: int, sentence: str) -> None:
    """Say that something went wrong; what exactly may name a law, and goes to a file as private as the key."""
    path = study.home(number) / TROUBLE
    with suppress(OSError), private_file(path) as file:
        file.write(f"{sentence}\n".encode())
    say(f"slave, channel and master are started again; {path} says why, and may name a condition")
