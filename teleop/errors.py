"""What a wrong request is answered with: one sentence that says what, why and what to type.

`Refused` is the only exception that the command line turns into exit code 2. Misuse found while an
object is made (a negative mass, an unknown name) raises it at once, before anything is computed or
written; what happens *during* a run is a status of the run, never an exception.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import isfinite


class Refused(ValueError):
    """A request that cannot be carried out as it stands; the text is the whole answer."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The sentence's end for an unknown word: the closest known ones, or all of them.

    >>> nearest("wavee", ["wave", "pfra"])
    'did you mean wave?'
    """
    from difflib import get_close_matches

    names = sorted(known)
    close = get_close_matches(word, names, n=3, cutoff=0.5)
    return f"did you mean {' or '.join(close)}?" if close else f"there are: {', '.join(names)}"


def number(name: str, value: object, *, low: float | None = None, above: float | None = None,
           high: float | None = None) -> float:
    """`value` as a float, or `Refused` if it is no finite number in the range.

    `low` and `high` are included in the range, `above` is not. A bool is not a number here.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise Refused(f"{name} must be a number, not {value!r}; write for example {name}=1.0")
    got = float(value)
    if not isfinite(got):
        raise Refused(f"{name} must be finite, not {got}; leave it out to use its default")
    if above is not None and got <= above:
        raise Refused(f"{name} must be above {above:g}, not {got:g}")
    if low is not None and got < low:
        raise Refused(f"{name} must be at least {low:g}, not {got:g}")
    if high is not None and got > high:
        raise Refused(f"{name} must be at most {high:g}, not {got:g}")
    return got
