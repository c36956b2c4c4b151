"""A metric of the user's own: the value of a run by it, or what is wrong with it in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from numbers import Real
from traceback import format_exception, walk_tb
from typing import TYPE_CHECKING, Any

from teleop.errors import Refused
from teleop.law.contract import file_line

if TYPE_CHECKING:
    from teleop.simulation.result import Result

LONGEST = 80  # characters of a value that a sentence shows


class MetricMistake(Refused):
    """A metric that raised, which is the cause, or that returned no number. It ends its sweep."""


class SentMistake:
    """A mistake that may go to another process, where its cause is a `Raised` with the traceback as text.

    It is no exception itself: dask has those pickled with their causes, which may be of a class that cannot be made
    again.
    """

    def __init__(self, error: MetricMistake) -> None:
        self.error = error

    def __reduce__(self) -> tuple[Any, ...]:
        """What it is made of again in another process."""
        cause = self.error.__cause__
        return _again, (str(self.error), None if cause is None else "".join(format_exception(cause)))


class Raised(Exception):
    """What a metric raised in another process; the text is its traceback there."""


def asked(metric: Callable[[Result], float], result: Result, row: Mapping[str, Any]) -> float:
    """The metric's value for the run of `row` (`row`, `seed` and the knobs). Raises `MetricMistake`."""
    try:
        value: Any = metric(result)
    except (Exception, SystemExit) as error:
        said = " ".join(_text(str, error).split())
        raise MetricMistake(_sentence(metric, _innermost(metric, error), row,
                                      f"raised {type(error).__name__}{': ' * bool(said)}{said}")) from error
    if getattr(value, "shape", None) == () and hasattr(value, "item"):  # of numpy
        value = value.item()
    if not isinstance(value, Real):
        what = f"returned {_shown(value)}, which is no number (write a float, nan where there is none)"
        raise MetricMistake(_sentence(metric, _first_line(metric), row, what))
    return float(value)


def _sentence(metric: Callable[..., Any], place: str, row: Mapping[str, Any], what: str) -> str:
    knobs = {**{name: value for name, value in row.items() if name not in ("row", "seed")}, "seed": row["seed"]}
    at = ", ".join(f"{name}={_shown(value)}" for name, value in knobs.items())
    name = metric.__name__
    return (f"metric {name}{place} {what}, in row {row['row']} ({at}); mend it and sweep again: with out=FOLDER the "
            f"rows before it are kept there, and mended=[{name!r}] goes on behind them")


def _innermost(metric: Callable[..., Any], error: BaseException) -> str:
    """The innermost line in the metric's own file, where that is known, " (path:line)"."""
    own = getattr(getattr(metric, "__code__", None), "co_filename", None)
    lines = [line for frame, line in walk_tb(error.__traceback__) if frame.f_code.co_filename == own]
    return file_line(own, lines[-1]) if own is not None and lines else ""


def _first_line(metric: Callable[..., Any]) -> str:
    code = getattr(metric, "__code__", None)
    return "" if code is None else file_line(code.co_filename, code.co_firstlineno)


def _shown(value: object) -> str:
    text = value if isinstance(value, str) and value.isidentifier() else " ".join(_text(repr, value).split())
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def _text(of: Callable[[Any], str], value: object) -> str:
    try:
        return of(value)
    except Exception:  # of a class of the user's own, whose text may be what is broken
        return f"a {type(value).__name__}"


def _again(text: str, traceback: str | None) -> SentMistake:
    mistake = MetricMistake(text)
    if traceback is not None:
        mistake.__cause__ = Raised(f"\n{traceback}")
    return SentMistake(mistake)
