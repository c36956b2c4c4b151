"""Report of runs: of one its table, figures, events and knobs; of several the same side by side."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.errors import enumerated, plural
from teleop.report.figures import figures
from teleop.report.markup import Markup, element, facts, table
from teleop.report.page import Section, flattened, heading, made_by, parameters, with_unit
from teleop.report.strips import Strip, strips
from teleop.scene.catalogue import units_of
from teleop.scene.library import known_scenes
from teleop.simulation.metrics import METRICS, resolved
from teleop.terminal.plotting import can_draw
from teleop.terminal.run_table import heading as headed
from teleop.terminal.run_table import rows, what
from teleop.terminal.table import si

if TYPE_CHECKING:
    from teleop.simulation.result import Result

MOST_EVENTS = 16  # of a run that are listed
MOST_TITLE = 34  # characters over a panel
PANELS, PARTS = 12, 6  # of a figure of several runs, of the parts of a page
SWINGING = ("limit cycle", "unstable", "diverged")
COLUMNS = 6  # runs side by side in one table; of more each is a row
COMPARED = ("x_err_rms", "x_err_max", "f_err_rms", "f_m_max", "f_env_max", "f_m_end", "f_env_end", "felt_share",
            "felt_drag", "drift_end", "jerk_rms", "T_fwd_mean", "T_bwd_mean", "queue_fwd_end", "queue_bwd_end",
            "E_link_min", "E_port_min", "energy_out", "g_m_min", "g_s_min")
FEW = ("x_err_rms", "f_m_max", "f_env_end", "f_m_end", "T_fwd_mean", "E_port_min")  # of each where runs are rows


class RunView(NamedTuple):
    """A run to tell of: what it is called, and what it left, with its document."""

    name: str
    result: Result
    document: Mapping[str, Any]


def of_one(run: RunView) -> Section:
    """Run to be shown."""
    result = run.result
    events = _events(result)
    blocks = [*figures(lambda: strips([_strip("", result)])), heading("Results"), facts(rows(result)),
              *_event_table(events), *parameters(result.parameters, _units(result)), *made_by(run.document)]
    how = what(result).removeprefix(headed(result)).lstrip(", ")
    return Section(title=headed(result), under=f"{how}; folder {run.name}", status=result.status,
                   sentence=result.sentence, blocks=blocks)


def in_a_notebook(result: Result) -> Markup:
    """The figures of a run over time, for a page whose style is not ours; without matplotlib a sentence."""
    if not can_draw():
        return element("p", None, "Strips over time need matplotlib: pip install 'bilateral-teleop[plot]'.")
    drawn = figures(lambda: strips([_strip("", result)]))
    return element("div", {"style": "font:10px sans-serif;fill:currentColor;max-width:60rem"}, *drawn)


def of_several(runs: Sequence[RunView], title: str = "", under: str = "", before: Sequence[Markup] = (),
               most: int = PANELS, noun: str = "run") -> Section:
    """Runs side by side: one table, or what is given `before` the figures; a figure a quantity with a panel for each.

    Of more than `most` runs those with most to see have a panel.
    """
    differing = _differing([run.result for run in runs])
    titles = [_title(run, differing[i], i) for i, run in enumerate(runs)]
    shown = most_to_see([run.result for run in runs], most)
    drawn = [_strip(titles[i], runs[i].result) for i in shown]
    hidden = [str(i + 1) for i in range(len(runs)) if i not in shown]
    note = [element("p", {"class": "sub"}, f"The figures show the {len(shown)} {noun}s with most to see: those that "
                    f"swing, then those with the greatest forces. Left out: {plural(len(hidden), noun)} "
                    f"{enumerated(hidden)}.")] if hidden else []
    notes = [(titles[i], note) for i, run in enumerate(runs) for note in run.result.notes]
    same = {name: value for name, value in flattened(runs[0].result.parameters).items() if name not in differing[0] and
            not (name.startswith("law.") and "law" in differing[0])}
    scenes = list(dict.fromkeys(run.result.scene for run in runs))
    blocks = [*(before or [_compared(runs, titles, differing)]), *note, *figures(lambda: strips(drawn)),
              *([heading("Notes"), facts(notes)] if notes else []),
              *parameters(same, _units(runs[0].result), "Parameters that all have"), *_commands(runs, titles)]
    ended = ", ".join(f"{sum(run.result.status == status for run in runs)} {status}" for status in
                      dict.fromkeys(run.result.status for run in runs))
    return Section(title=title or f"{', '.join(scenes)}: {len(runs)} runs", under=under or ", ".join(
        run.name for run in runs), sentence=f"{plural(len(runs), noun)}: {ended}", blocks=blocks)


def most_to_see(results: Sequence[Result], most: int) -> list[int]:
    """The positions, in order, of the `most` runs with most to see.

    Those come first that swing or diverge, then those with the greatest force at either end, and of equal ones, which
    are at a cap, the roughest.
    """
    def interest(i: int) -> tuple[bool, float, float]:
        got = results[i].metrics
        return (results[i].status in SWINGING, max(got.get("f_m_max", 0.0), got.get("f_env_max", 0.0)),
                got.get("jerk_rms", 0.0))

    return sorted(sorted(range(len(results)), key=interest, reverse=True)[:most])


def _strip(title: str, result: Result) -> Strip:
    return Strip(title, result.trace, result.dt, [(t, f"{end}: {kind}, {why}") for t, end, kind, why in
                                                  _events(result)], result.labels)


def _events(result: Result) -> list[tuple[float, str, str, str]]:
    """Events at the ends of a live run, in order: time (s), end, event and cause."""
    events_found = []
    for end in ("master", "slave"):
        knobs_of_run = result.extra.get(end)
        for event in (knobs_of_run.get("events") or ()) if isinstance(knobs_of_run, Mapping) else ():
            events_found.append((event["k"] * result.dt, end, event["what"], event["why"]))
    return sorted(events_found, key=lambda event: event[0])


def _event_table(events: Sequence[tuple[float, str, str, str]]) -> list[Markup]:
    if not events:
        return []
    summary = [(f"{t:.3f} s", end, what_, why) for t, end, what_, why in events[:MOST_EVENTS]]
    if len(events) > MOST_EVENTS:
        summary.append(("", "", "", f"and {len(events) - MOST_EVENTS} more, which events.jsonl of each end has"))
    return [heading("Events"), table((), summary, numbers=False)]


def _units(result: Result) -> dict[str, str]:
    """The units of the knobs of a built-in scene; that of a file is not run for it."""
    names = flattened(result.parameters)
    return units_of(result.scene, [*names]) if result.scene in known_scenes() else {}


def _differing(results: Sequence[Result]) -> list[dict[str, str]]:
    """Knobs of each run in which not all are alike, with the scene where that differs; the law first."""
    flat = [{"scene": result.scene, **_differences(result), "seed": str(result.seed)} for result in results]
    for each in flat:  # by its name, as it is typed: its numbers are its own defaults
        each["playout"] = each.get("playout", "").partition("(")[0].lower()
    if len({each.get("law") for each in flat}) > 1:  # of other laws the parameters are others
        for each in flat:
            knobs_of_run = {name: each.pop(name) for name in [*each] if name.startswith("law.")}
            each["law's parameters"] = ", ".join(f"{name[4:]} {value}" for name, value in knobs_of_run.items())
    names = list(dict.fromkeys(name for each in flat for name in each))
    names.sort(key=lambda name: (name != "scene", not name.startswith("law")))
    summary: list[dict[str, str]] = [{} for _ in flat]
    for name in names:
        values = [each.get(name, "") for each in flat]
        if len(set(values)) > 1:
            for one, value in zip(summary, values, strict=True):
                one[name] = value
    return summary


def _differences(result: Result) -> dict[str, str]:
    """The knobs of a run, each with its unit."""
    units = _units(result)
    return {name: with_unit(value, units.get(name, "")) for name, value in
            flattened(result.parameters).items()}


def _title(run: RunView, differing: Mapping[str, str], i: int) -> str:
    """Title of the panel of a run: the knobs in which it differs, or as many of them as are short."""
    words = [value if name in ("law", "scene") else f"{name} {value}" for name, value in differing.items()
             if value and not name.startswith("law'")]
    if not words or (len(", ".join(words)) > MOST_TITLE - 4 and not run.name.isdecimal()):
        words = [run.name]  # of a page's part it is a number
    while len(words) > 1 and len(", ".join(words)) > MOST_TITLE - 4:
        words.pop()
    return f"{i + 1}: {', '.join(words)}"[:MOST_TITLE]


def _compared(runs: Sequence[RunView], titles: Sequence[str], differing: Sequence[Mapping[str, str]]) -> Markup:
    """A column a run; of many runs a row each, with the figures that matter most."""
    names = [name for name in COMPARED if any(name in run.result.metrics for run in runs)]
    if len(runs) > COLUMNS:
        few = [name for name in FEW if name in names]
        return table(["", "status", *[_name_parts(name) for name in few]],
                     [[title, run.result.status, *[_value(run.result, name) for name in few]]
                      for title, run in zip(titles, runs, strict=True)])
    lines = [[name, *[each[name] for each in differing]] for name in differing[0]]
    lines.append(["status", *[run.result.status for run in runs]])
    lines.append(["outcome", *[run.result.sentence for run in runs]])
    lines += [[_name_parts(name), *[_value(run.result, name) for run in runs]] for name in names]
    lines += [[f"packets lost {way}", *[str(run.result.packets[way].lost) if way in run.result.packets else "" for run
                                        in runs]] for way in ("fwd", "bwd")
              if any(way in run.result.packets for run in runs)]
    return table(["", *titles], lines, even=True)


_WORDS = {
    "x_err_rms": "tracking error, rms", "x_err_max": "tracking error, greatest", "f_err_rms": "force error, rms",
    "f_m_max": "greatest force on the hand", "f_env_max": "greatest force on the environment",
    "f_m_end": "force felt at the end", "f_env_end": "force touched at the end",
    "felt_share": "felt stiffness, of the environment's", "felt_drag": "felt drag", "drift_end": "drift at the end",
    "jerk_rms": "change of the felt force, rms", "T_fwd_mean": "delay fwd", "T_bwd_mean": "delay bwd",
    "queue_fwd_end": "queue fwd at the end", "queue_bwd_end": "queue bwd at the end",
    "E_link_min": "link energy, least", "E_port_min": "port energy, least", "energy_out": "energy given out",
    "g_m_min": "least gain, master's watchdog", "g_s_min": "least gain, slave's watchdog",
}


def _name_parts(name: str) -> str:
    return _WORDS[name]


def _value(result: Result, name: str) -> str:
    if name not in result.metrics:
        return "-"
    unit, value = result.labels.unit(METRICS[name].unit), float(resolved(result.metrics)[name])
    return f"{100.0 * value:.3g} %" if unit == "1" else si(value, unit)


def _commands(runs: Sequence[RunView], titles: Sequence[str]) -> list[Markup]:
    """The command of each run, and the versions, once where all have the same."""
    versions = [run.document.get("versions") for run in runs]
    if all(one == versions[0] for one in versions):
        summary = [facts(_command_rows(runs, titles))]
        return [heading("Made by"), *summary, *made_by({"versions": versions[0]})[1:]]
    every: list[Markup] = []
    for title, run in zip(titles, runs, strict=True):
        every += [element("p", {"class": "sub"}, title), *made_by(run.document)[1:]]
    return [heading("Made by"), *every]


def _command_rows(runs: Sequence[RunView], titles: Sequence[str]) -> Iterator[tuple[str, str]]:
    from shlex import join

    commands = [run.document.get("command") for run in runs]
    if all(command == commands[0] for command in commands):
        titles, commands = ["command"], commands[:1]
    for title, command in zip(titles, commands, strict=True):
        if isinstance(command, list) and command:
            yield title, element("code", None, join(map(str, command)))


def of_parts(
    name: str, runs: Sequence[RunView], begun: Sequence[tuple[int, str]], document: Mapping[str, Any]
) -> Section:
    """The parts of a page called `name` that was turned while it ran, in order; each with its first tick and why."""
    if len(runs) == 1:
        return replace(of_one(runs[0]), title=f"{headed(runs[0].result)}, on the page", under=f"folder {name}")
    differing = _differing([run.result for run in runs])
    knobs = [", ".join(f"{key} {value}" for key, value in each.items() if value and not key.startswith("law") and
                       key != "duration") for each in differing]
    few = [metric for metric in ("x_err_rms", "f_m_max", "f_m_end", "f_env_end")
           if any(metric in run.result.metrics for run in runs)]
    lines = [[str(i + 1), why, f"{max(k, 0) * run.result.dt:.1f} s", f"{run.result.ticks * run.result.dt:.1f} s",
              headed(run.result).rpartition(", law ")[2], knobs[i], run.result.status,
              *[_value(run.result, metric) for metric in few]]
             for i, (run, (k, why)) in enumerate(zip(runs, begun, strict=True))]
    head = ["part", "began by", "at", "for", "law", "knobs", "status", *[_name_parts(metric) for metric in few]]
    summary = table(head, lines, numbers=False)
    return of_several(runs, f"{document['scene']}, {len(runs)} parts on the page", f"folder {name}", [summary],
                      PARTS, "part")
