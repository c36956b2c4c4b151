"""Numbers and ranges as they are typed behind an option."""

from __future__ import annotations

from math import inf, isfinite

from teleop.errors import Refused, number


def typed_number(option: str, text: str, *, example: str, above: float | None = None) -> float:
    """The finite number that was typed behind `option`; `example` is one that would do. Raises `Refused`.

    >>> typed_number("--tol", "1e-3", example="0.01")
    0.001
    """
    try:
        found = float(text)
    except ValueError:
        raise Refused(f"{option} {text} is no number; write for example {option} {example}") from None
    return number(option, found, above=above)


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
