"""Figures of a run beside figures that are printed somewhere, to the digits that are printed."""

from __future__ import annotations

from typing import Any

import numpy as np

from teleop import load_scene, run


def digits(text: str) -> int:
    """How many significant digits a printed number has.

    >>> digits("0.00291242"), digits("8.0"), digits("1.07034")
    (6, 2, 6)
    """
    return len(text.lstrip("-").replace(".", "").lstrip("0"))


def printed(value: float, like: str) -> str:
    """A number as it would be printed beside `like`."""
    return f"{value:#.{digits(like)}g}"


def figures(law: Any, scene: str, delay: float, duration: float = 2.0) -> tuple[float, float, float]:
    """x_err_rms (m), the greatest |f_m| (N) and E_port at the end (J)."""
    done = run(load_scene(scene, law=law, delay=delay, duration=duration))
    return done.metrics["x_err_rms"], float(np.abs(done.trace["f_m"]).max()), float(done.trace["E_port"][-1])


def assert_printed(law: Any, scene: str, delay: float, *wanted: str) -> None:
    """The figures of two seconds are those that are printed."""
    got = figures(law, scene, delay)
    assert [printed(value, like) for value, like in zip(got, wanted, strict=True)] == list(wanted)


def tracking_mm(law: Any, scene: str) -> tuple[float, float]:
    """x_err_rms in mm and the greatest |f_env| in N, of ten seconds over 50 ms each way."""
    done = run(load_scene(scene, law=law, delay=0.05, duration=10.0))
    return 1e3 * done.metrics["x_err_rms"], float(np.abs(done.trace["f_env"]).max())
