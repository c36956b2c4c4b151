"""Options that the commands share: the scene, its axes and ranges, and how a refusal leaves the process."""

from __future__ import annotations

import os
import sys
import warnings
from argparse import Action, ArgumentParser, ArgumentTypeError, Namespace, _SubParsersAction
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from teleop.errors import Refused, enumerated, nearest, number
from teleop.scene.axes import AxisLabels, unit_on

DONE, FAULT, WRONG, FORCED, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes; FORCED: a device's force may still be on

FORMATS = ("png", "pdf", "svg")  # of a plot


class Parser(ArgumentParser):
    """An argument parser that refuses in one sentence where argparse would print its usage and exit."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse as argparse does, with a sentence on an argument that the command does not take."""
        parsed, extra = self.parse_known_args(args, namespace)
        if extra:
            self._refuse(extra[0], getattr(parsed, "do", None), getattr(parsed, "action", None))
        return parsed

    def _refuse(self, argument: str, command: str | None, action: str | None) -> NoReturn:
        """Say which other commands have an option that this one has not, or which of its own is near."""
        commands = commands_of(self)
        command_parser = commands.get(command or "", self)
        if actions := commands_of(command_parser):
            commands = {**commands, **actions}
            command_parser = actions.get(action or "", command_parser)
        name = argument.partition("=")[0]
        others = [another.prog for another in commands.values() if name in another._option_string_actions]
        if not name.startswith("-"):
            why = f"{command_parser.prog} does not take the argument {argument!r}"
        elif others:
            why = f"{command_parser.prog} has no option {name}, an option of {enumerated(others)}"
        else:
            options = command_parser._option_string_actions
            why = f"{command_parser.prog} has no option {name}; {nearest(name, options.keys() - {'-h', '--help'})}"
            if name.startswith("--") and "--set" in options:
                why += f" (a knob is given by --set {name[2:]}=VALUE)"
        raise Refused(f"{why}; see {command_parser.prog} --help")

    def error(self, message: str) -> NoReturn:
        raise Refused(f"{message}; see {self.prog} --help")

    def _check_value(self, action: Action, value: Any) -> None:
        """Check a value as argparse does, and that it is not empty."""
        if action.choices is not None and value not in action.choices:
            what = str(action.metavar or (action.option_strings or [action.dest])[0]).lower()
            raise Refused(f"there is no {what} {value!r}; {nearest(value, action.choices)}")
        if value == "":
            where = " ".join([*action.option_strings[:1], str(action.metavar)])
            raise Refused(f"{where} must not be empty: it is {action.help}")


def commands_of(parser: ArgumentParser) -> dict[str, ArgumentParser]:
    """The commands of a parser, or the actions of a command's, by their names."""
    return next((dict(each.choices) for each in parser._actions if isinstance(each, _SubParsersAction)), {})


def scene_options(parser: ArgumentParser, *, default: str | None = None, seed: bool = True) -> None:
    """Add SCENE (which may be left out if there is a `default`), --set, --link and, unless there are many, --seed."""
    parser.add_argument(
        "scene", metavar="SCENE", nargs=None if default is None else "?", default=default,
        help="a scene's name (see `teleop list`) or the path of a .py file with a function `scene`"
        + (f"; left out: {default}" if default else ""),
    )
    parser.add_argument(
        "--set", metavar="NAME=VALUE", action="append", default=[],
        help="a knob of the scene, its law (law=pfra, or law=FILE.py for one of your own) or a knob of the law "
        "(law.b=4); may be repeated",
    )
    if seed:
        parser.add_argument(
            "--seed", metavar="N", type=seed_number, default=0, help="keys every random draw of the link; left out: 0"
        )
    parser.add_argument(
        "--link", metavar="SPEC",
        help="another link in place of the scene's, for example 'delay(0.05) | bernoulli(0.02)'; "
        "'delay(0.05) ; delay(0.2)' differs forth and back, none is no link",
    )


def json_option(added: ArgumentParser, what: str = "print one JSON object and nothing else") -> None:
    """Let a command take --json."""
    added.add_argument("--json", action="store_true", help=what)


def out_option(added: ArgumentParser, stem: str) -> None:
    """Let a command take --out, for a new folder."""
    added.add_argument("--out", metavar="DIR", help=f"the new folder to write; default runs/{stem}-NUMBER")


def plot_option(added: ArgumentParser, what: str) -> None:
    """Let a command take --plot and --format, to draw `what`."""
    added.add_argument("--plot", action="store_true", help=f"draw {what} into the folder, named with -2, -3, ... where "
                       "that name is taken (needs the extra `plot`); left out: nothing is drawn")
    added.add_argument("--format", metavar="FORMATS", type=formats, help=f"of the plot: {', '.join(FORMATS)}, several "
                       "joined by commas; draws, as --plot does; left out: png")


def realtime_option(parser: ArgumentParser) -> None:
    """Let a live command take --no-realtime, as `args.realtime`."""
    parser.add_argument("--no-realtime", dest="realtime", action="store_false",
                        help="do not ask the system for real-time scheduling (SCHED_FIFO) and locked memory; left "
                        "out: ask, go on without where it refuses, and say what it gave (see `teleop doctor`)")


def tick_options(parser: ArgumentParser) -> None:
    """Let a live command take --rate and --spin, for the ticks of its ends."""
    parser.add_argument("--rate", metavar="HZ", type=float,
                        help="tick at this rate, a whole part of the scene's; the law gets that tick, and the other "
                        "end may keep its own")
    parser.add_argument("--spin", action="store_true",
                        help="wake a little before each tick and wait for it awake: on time to microseconds, for a "
                        "share of a core")


def knobs_from(args: Namespace) -> dict[str, str]:
    """The knobs that were given, as texts: those of --set, the last one counts, and --link as `link`."""
    knobs: dict[str, str] = {}
    for text in args.set:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise Refused(f"--set {text} gives no knob a value; write for example --set delay=0.1")
        knobs[name.strip()] = value.strip()
    return knobs if args.link is None else {**knobs, "link": args.link}


def guarded(work: Callable[[], int]) -> int:
    """Carry out `work` and return its exit code, or say in one sentence on stderr why it was not done.

    A refusal is exit code 2, and so is what the operating system refuses; Ctrl-C is 130. A reader of the
    output that has seen enough (`| head`) is no error. What is a bug keeps its traceback.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by whoever started this, as a service manager may: nobody listens
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115 (it is open as long as the process)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = partial(_warn, warnings.showwarning)
            code = work()
        print(end="", flush=True)  # what fails here would otherwise fail after us, where nobody can say it
        return code
    except Refused as refused:
        return complain(str(refused), WRONG)
    except KeyboardInterrupt:
        return complain("interrupted; nothing half-written is left, so just type it again", INTERRUPTED)
    except BrokenPipeError:
        return _let_go_of_output(DONE)
    except MemoryError:
        return complain("out of memory; a shorter duration or a greater dt needs less", WRONG)
    except OSError as error:
        code = complain(f"the system refused ({error}); see to that and type it again", WRONG)
        return _let_go_of_output(code)


def _warn(python: Callable[..., None], message: Warning | str, category: type[Warning], *where: Any) -> None:
    """Say a warning of this package as a sentence; any other is told with its place, as Python does."""
    if category.__module__.startswith("teleop."):
        complain(str(message), DONE)
    else:
        python(message, category, *where)


def complain(sentence: str, code: int) -> int:
    """Say `sentence` on stderr; returns `code`."""
    from teleop.terminal import screen
    from teleop.terminal.table import printable

    ours = screen.painted("teleop:", screen.NOTICE if code == DONE else screen.BAD, sys.stderr)
    print(ours, printable(" ".join(sentence.splitlines())), file=sys.stderr)
    return code


def _let_go_of_output(code: int) -> int:
    """Point standard output at nothing, so that the interpreter's own flush at the end cannot fail."""
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def whole(text: str) -> int:
    """A count that is at least 1, as argparse's `type`."""
    if not (text.isascii() and text.isdecimal()) or int(text) < 1:
        raise ArgumentTypeError(f"must be a whole number of at least 1, not {text!r}; write for example 3")
    return int(text)


def formats(text: str) -> tuple[str, ...]:
    """The formats of a plot, joined by commas, each once, as argparse's `type`."""
    named = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",")))
    if not {*named} <= {*FORMATS}:
        raise ArgumentTypeError(f"must be one or several of {', '.join(FORMATS)}, joined by commas, not {text!r}; "
                                "write for example pdf,svg")
    return named


def seed_number(text: str) -> int:
    """A seed, as argparse's `type`."""
    from teleop.simulation.plan import check_seed

    try:
        seed = int(text) if text.isascii() and text.isdecimal() else text
        check_seed(seed)  # type: ignore[arg-type]  # a text is what it refuses
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None
    return int(seed)


if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

TOGETHER = 3  # axes that share a panel, each with a line of its own
APART = 6  # axes in panels of their own
_PORTS = (("f_m", "x_m"), ("f_s", "x_s"))


def axes_of(trace: Mapping[str, Any]) -> int:
    """Number of axes of a trace."""
    return max((column.shape[1] for name in ("x_m", "x_s") if name in trace
                for column in [trace[name]] if column.ndim > 1), default=1)


def most_worked(trace: Mapping[str, Any], most: int) -> list[int]:
    """The axes that are drawn, at most so many, in order of the axes."""
    count = axes_of(trace)
    if count <= most:
        return list(range(count))
    work = work_of(trace)
    return sorted(sorted(range(count), key=lambda i: (-work[i], i))[:most])


def work_of(trace: Mapping[str, Any]) -> NDArray[np.float64]:
    """Work of the stack's forces along each of several axes at both ends, whatever its sign, summed up, J."""
    import numpy as np

    work = np.zeros(axes_of(trace))
    with np.errstate(all="ignore"):  # of a run that diverged
        for force, place in _PORTS:
            if force in trace and place in trace:
                work += np.nansum(np.abs(trace[force][:-1] * np.diff(trace[place], axis=0)), axis=0)
    return work


def left_out(trace: Mapping[str, Any], shown: Sequence[int], labels: AxisLabels) -> str:
    """A sentence on the axes that are not drawn; empty if all are."""
    count = axes_of(trace)
    if len(shown) == count:
        return ""
    names = labels.names_for(count)
    return (f"{len(shown)} of {count} axes are drawn, those over which the forces of the stack did most work: "
            f"{enumerated([names[i] for i in shown])}")


def by_unit(unit: str, shown: Sequence[int], labels: AxisLabels, count: int) -> dict[str, list[int]]:
    """The axes that go on one scale, by their unit, of a quantity whose unit along a line is `unit`."""
    units = labels.units_for(count)
    parsed: dict[str, list[int]] = {}
    for i in shown:
        parsed.setdefault(unit_on(unit, units[i]), []).append(i)
    return parsed


def typed_number(option: str, text: str, *, example: str, above: float | None = None) -> float:
    """The finite number that was typed behind `option`; `example` is one that would do. Raises `Refused`.

    >>> typed_number("--tol", "1e-3", example="0.01")
    0.001
    """
    try:
        parsed = float(text)
    except ValueError:
        raise Refused(f"{option} {text} is no number; write for example {option} {example}") from None
    return number(option, parsed, above=above)


def typed_range(option: str, text: str, *, example: str, what: str = "numbers", low: float = -inf, above: float = -inf
                ) -> tuple[float, float]:
    """LOW:HIGH as it was typed behind `option`: finite, the lower end first and at least `low`, or more than `above`.

    Raises `Refused`; `example` is a range that would do, `what` says what is typed.

    >>> typed_range("--range", "10:1e4", example="1:100")
    (10.0, 10000.0)
    """
    cure = f"write for example {option} {example}"
    first, colon, second = text.partition(":")
    try:
        ends = float(first), float(second)
    except ValueError:
        colon = ""
    if not colon:
        raise Refused(f"{option} {text} is not LOW:HIGH in {what}; {cure}")
    if not (isfinite(ends[0]) and isfinite(ends[1])):
        raise Refused(f"{option} {text} must be finite; {cure}")
    if not ends[0] < ends[1]:
        raise Refused(f"{option} {text} is empty; write the lower end first, for example {option} {example}")
    if ends[0] < low or ends[0] <= above:
        must = f"not go below {low:g}" if ends[0] < low else f"lie above {above:g}"
        raise Refused(f"{option} {text} must {must}; {cure}")
    return ends
