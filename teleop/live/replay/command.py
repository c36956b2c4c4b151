"""Command `teleop replay`: run the law of each end of a live run again, and compare its answers with the record."""

from __future__ import annotations

import warnings
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import Refused, enumerated, number_of
from teleop.live.records.end_result import NAMES
from teleop.live.records.reader import FILE, read_record
from teleop.live.records.record import check_one_run
from teleop.live.replay.rerun import Difference, EndFolder, OpenLoopForces, command_open_loop, difference, read_end
from teleop.scene.axes import FORCE_UNIT, labels_of
from teleop.scene.loading import load_scene, stored_scene
from teleop.scene.scene import Scene
from teleop.simulation.result import write_arrays
from teleop.storage.files import replacing
from teleop.storage.folder import new_folder
from teleop.storage.strict_json import write_document
from teleop.terminal.answer import Answer, finite, scene_head, titled
from teleop.terminal.options import DONE, FAULT, TOGETHER, by_unit, knobs_from
from teleop.terminal.plotting import BLUE, DARK, RED, UNDER, asked_formats, grid_lines, literal, new_figure, save
from teleop.terminal.run_plot import LINES
from teleop.terminal.table import facts, si

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

OPEN_LOOP = ("open loop: each end reads the motion that was recorded, which another force would have changed, holds "
             "what it held, and has the guard's gain that it had")
ALONE = "of one end alone: it hears the messages that it heard"
BOTH = "each end hears what the other end's law would have sent, when the recorded messages came"
COLOURS = {"m": BLUE, "s": RED}


class ForceFigures(NamedTuple):
    """The force of one end as it was and as it would have been, N; in several axes of the axis where it is greatest."""

    rms_recorded: float
    rms: float
    rms_difference: float
    greatest_difference: float
    at: float  # s


def command(args: Namespace) -> Answer:
    """Replay the run, or say what another law would have commanded. Raises `Refused`."""
    formats, typed = asked_formats(args), knobs_from(args)
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        folders = _folders(Path(args.run), None if args.slave is None else Path(args.slave))
        base, scene, seed = _scenes(folders, typed, trust=args.trust)
        ends = [read_end(folder, base) for folder in folders]
    if len(ends) == 2:
        check_one_run(dict(zip("ms", folders, strict=True)),
                      dict(zip("ms", [end.header for end in ends], strict=True)), ("scene", "knobs", "mode"))
    notes = [*dict.fromkeys(str(one.message) for one in warned)]  # a record is read twice
    title = titled(scene)
    answers = command_open_loop(ends, base, scene) if typed or formats or args.out else {}
    if typed:
        rows, document = _summarize(answers, scene, len(ends))
        sentence, status, code = f"what {title} would have commanded, {OPEN_LOOP}", "open loop", DONE
        rows += [("", OPEN_LOOP), ("", ALONE if len(ends) == 1 else BOTH)]
        notes += [f"{NAMES[e]}: {number_of(one.unknown, 'message')} that it played in the run came from ticks that the "
                  "other folder does not have, as of a process that was killed or started again; it plays a gap in the "
                  "place of each" for e, one in answers.items() if one.unknown]
    else:
        differences = {NAMES[end.e]: difference(end, base) for end in ends}
        rows, document = _compare(differences, ends, base)
        differ = [name for name, one in differences.items() if one is not None]
        sentence = "; ".join(f"{name}: {text}" for name, text in rows)
        status, code = ("differs", FAULT) if differ else ("same", DONE)
    rows += [("note", note) for note in notes]
    full = {**scene_head(scene, "replay", sentence=sentence, status=status, seed=seed, command=args.typed),
            "run": [str(folder) for folder in folders], **document, "notes": notes}
    answer = Answer(facts([("replay", f"{', '.join(map(str, folders))} ({title})"), *rows]), full, code)
    if not answers or not (formats or args.out):
        return answer
    with new_folder(args.out, f"{base.name}-replay") as new:
        plots = []
        with replacing(new.inside / "forces.npz") as file:
            write_arrays(file, _arrays(answers, scene))
        if formats:
            plots = draw(f"replay of {folders[0]}: {title}", answers, scene, new.inside / "replay", formats,
                         open_loop=bool(typed))
        write_document(new.inside / "summary.json", full)
    return answer.kept_in(new.path).with_plots(new.path, plots)


def _folders(run: Path, slave: Path | None) -> list[Path]:
    """The folders of the ends: that of one end, or both of a demo, or two that were given."""
    if slave is not None:
        return [run, slave]
    if (run / FILE).is_file():
        return [run]
    both = [run / name for name in NAMES.values()]
    if all((one / FILE).is_file() for one in both):
        return both
    raise Refused(f"{run} holds no record of a live end; give the folder that a live end or a demo wrote, or that of a "
                  "master and that of its slave")


def _scenes(folders: Sequence[Path], typed: Mapping[str, str], *, trust: bool) -> tuple[Scene, Scene, int]:
    """The scene that the run had, the one with what was typed, and the seed."""
    header = read_record(folders[0])[0]
    base = stored_scene(header["scene"], header["knobs"], trust=trust)
    return base, load_scene(header["scene"], **{**header["knobs"], **typed}) if typed else base, header["seed"]


def _compare(differences: Mapping[str, Difference | None], ends: Sequence[EndFolder], scene: Scene
               ) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    rows, document = [], {}
    for end, (name, one) in zip(ends, differences.items(), strict=True):
        ticks = f"{end.ticks:,} ticks"
        if one is None:
            rows.append((name, f"{ticks}, forces and messages the same to the bit"))
        else:
            rows.append((name, f"differs at tick {one.k} (t = {one.k * scene.dt_ns / 1e9:.3f} s) in {one.field}: "
                               f"{one.recorded!r} was recorded, {one.replayed!r} replayed"))
        document[name] = {"ticks": end.ticks, "difference": None if one is None else {
            **one._asdict(), "recorded": one.recorded, "replayed": one.replayed}}
    return rows, document


def _summarize(answers: Mapping[str, OpenLoopForces], scene: Scene, ends: int
               ) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    rows, document = [], {}
    for e, one in answers.items():
        figures, axis = force_figures(one, scene.dt_ns), _worst_axis(one)
        unit = FORCE_UNIT[scene.axis_units[axis]]
        most = figures.greatest_difference
        apart = (f"they differ by {si(figures.rms_difference, unit)} rms, at most {si(most, unit)} at "
                 f"t = {figures.at:.3f} s") if most else "the same at every tick"
        along = f" along {scene.axis_names[axis]}" * (scene.axes > 1)
        rows.append((NAMES[e], f"f_{e}{along} rms {si(figures.rms, unit)}, recorded {si(figures.rms_recorded, unit)}; "
                               f"{apart}"))
        force: dict[str, Any] = {key: finite(value) for key, value in figures._asdict().items()}
        force |= {"axis": scene.axis_names[axis], "unit": unit} if scene.axes > 1 else {}
        document[NAMES[e]] = {"ticks": len(one.k), "force": force, "heard": "recorded" if ends == 1 else "exchanged"}
    return rows, document


def force_figures(one: OpenLoopForces, dt_ns: int) -> ForceFigures:
    """Figures of one end's forces; NaN of no ticks."""
    import numpy as np

    if not len(one.k):
        nan = float("nan")
        return ForceFigures(nan, nan, nan, nan, nan)
    apart, axis = one.commanded - one.recorded, _worst_axis(one)
    i = int(np.argmax(np.abs(apart[:, axis])))
    with np.errstate(all="ignore"):  # of a law that gives what is not finite
        was, now, rest = [float(np.sqrt(np.mean(each[:, axis] ** 2))) for each in (one.recorded, one.commanded, apart)]
    return ForceFigures(was, now, rest, float(abs(apart[i, axis])), float(one.k[i] * dt_ns / 1e9))


def _worst_axis(one: OpenLoopForces) -> int:
    """The axis on which the forces differ most; 0 of no ticks."""
    import numpy as np

    return int(np.argmax(np.max(np.abs(one.commanded - one.recorded), axis=0))) if len(one.k) else 0


def _arrays(answers: Mapping[str, OpenLoopForces], scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Times (s) and forces (N) of each end."""
    arrays: dict[str, Any] = {}
    for e, one in answers.items():
        arrays |= {f"t_{e}": one.k * scene.dt_ns / 1e9, f"f_{e}_recorded": one.recorded,
                   f"f_{e}_commanded": one.commanded}
    return arrays


def draw(title: str, answers: Mapping[str, OpenLoopForces], scene: Scene, path: Path, formats: Sequence[str], *,
         open_loop: bool) -> list[Path]:
    """Draw a panel for each end and unit as `path` in each of `formats`; returns the files. Raises `Refused`.

    Of more axes than share a panel, those are drawn whose force differs most from the recorded one, as a share of it.
    """
    labels, shown = labels_of(scene), _axes_shown(answers, scene.axes)
    heading = f"{title}, open loop" if open_loop else title
    if len(shown) < scene.axes:
        heading += (f"; {len(shown)} of {scene.axes} axes, those whose force differs most: "
                 f"{enumerated([scene.axis_names[i] for i in shown])}")
    rows = [(e, one, unit, axes) for e, one in answers.items()
            for unit, axes in by_unit("N", shown, labels, scene.axes).items()]
    figure = new_figure((9.5, 2.4 * len(rows) + 0.8), fill(literal(heading), 110))
    panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (e, one, unit, chosen) in zip(panels, rows, strict=True):
        t = one.k * scene.dt_ns / 1e9
        for i in chosen:
            name = f"$f_{e}$" + (f", {literal(scene.axis_names[i])}" if scene.axes > 1 else "")
            line = LINES[shown.index(i)]
            axes.plot(t, one.recorded[:, i], color=DARK, linestyle=line, label=f"{name} recorded", **UNDER)
            axes.plot(t, one.commanded[:, i], color=COLOURS[e], linestyle=line, linewidth=1.1,
                      label=f"{name} {'commanded' if open_loop else 'replayed'}")
        axes.set_ylabel(f"{NAMES[e]}'s force ({unit})")
        grid_lines(axes)
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)
    panels[-1].set_xlabel("time (s)")
    return save(figure, path, formats)


def _axes_shown(answers: Mapping[str, OpenLoopForces], axes: int) -> list[int]:
    import numpy as np

    if axes <= TOGETHER:
        return list(range(axes))
    with np.errstate(all="ignore"):  # of a law that gives what is not finite, and of no force at all
        share = np.nansum([np.nan_to_num(np.abs(one.commanded - one.recorded).sum(axis=0) /
                                         np.abs(one.recorded).sum(axis=0)) for one in answers.values()], axis=0)
    return sorted(np.argsort(-share, kind="stable")[:TOGETHER].tolist())
