"""Numbers as a person reads them: with an SI prefix, as a duration, with the thousands apart."""

from __future__ import annotations

PREFIX = {-3: "n", -2: "u", -1: "m", 0: "", 1: "k", 2: "M", 3: "G"}  # u: a terminal may know ASCII only


def si(value: float, unit: str) -> str:
    """`value` to three digits with an SI prefix; without a unit, of axes in m and rad together, without a prefix too.

    >>> si(0.03181, "m"), si(-1.1e-2, "J"), si(999.96, "N"), si(0.0, "J"), si(0.0049812, "")
    ('31.8 mm', '-11.0 mJ', '1.00 kN', '0 J', '0.00498')
    """
    if not unit:
        return f"{value:.3g}"
    if value == 0.0:
        return f"0 {unit}"
    digits, _, power = f"{value:.2e}".partition("e")
    if power == "":  # not finite
        return f"{value} {unit}"
    thousands, rest = divmod(int(power), 3)
    if thousands not in PREFIX:
        return f"{value:.2e} {unit}"
    return f"{float(digits) * 10**rest:.{2 - rest}f} {PREFIX[thousands]}{unit}"


def duration(seconds: float) -> str:
    """A time in whole seconds, or in min or h to two digits.

    >>> duration(0.2), duration(41.3), duration(750.0), duration(4e4), duration(3.6e6)
    ('1 s', '41 s', '12 min', '11 h', '1000 h')
    """
    if seconds < 99.5:
        return f"{max(seconds, 1.0):.0f} s"
    return f"{two_digits(seconds / 60.0)} min" if seconds < 99.5 * 60.0 else f"{two_digits(seconds / 3600.0)} h"


def grouped(count: int) -> str:
    """A count with its thousands apart: it is counted at a glance, where 1e+10 has to be read.

    >>> grouped(4800), grouped(10_000_000_000)
    ('4800', '10 000 000 000')
    """
    return f"{count:,}".replace(",", " ") if count >= 10_000 else str(count)


def two_digits(value: float) -> str:
    """A value to two digits, or to a whole number, without an exponent."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}" if value >= 1e-3 else f"{value:.1e}"
