"""Gains by search: waves that let a hard wall be felt over 50 ms each way, for the least drag. Run it as it stands.

Asked for: a steady force of at least 3 N, of the 6 N with which the hand's spring would press a rigid wall on the
spot; an overshoot of at most 2 %; both also with 20 ms more each way, as a queue against jitter takes. The scene
`hard_wall` has the gains that are found here.
"""

from __future__ import annotations

import numpy as np

from teleop import Result, sweep

GAINS = ("law.b", "law.K", "law.B")
AXES: dict[str, list[object]] = {"law.b": [2.0, 10.0, 15.0, 20.0, 30.0], "law.K": [500.0, 1000.0, 2000.0],
                                 "law.B": [10.0, 20.0, 40.0], "delay": [0.05, 0.07]}


def overshoot(result: Result) -> float:
    """The greatest force against the hand over that at the end, less one."""
    return float(result.trace["f_m"].max() / result.trace["f_m"][-1] - 1.0)


def drag(result: Result) -> float:
    """The greatest force against the hand before the wall can be felt there, N."""
    first = np.flatnonzero(result.trace["f_env"])[0] + round(result.metrics["T_bwd_mean"] / result.dt)
    return float(np.abs(result.trace["f_m"][:first]).max())


def bounce(result: Result) -> float:
    """Time that the slave is off the wall after it first touched it, s."""
    touches = result.trace["f_env"] != 0.0
    return float(np.count_nonzero(~touches[touches.argmax():]) * result.dt)


if __name__ == "__main__":
    table = sweep("hard_wall", AXES, metrics=["f_m_end", overshoot, drag, bounce], fixed={"duration": 4.0})
    both = list(zip(table.where(delay=0.05), table.where(delay=0.07), strict=True))
    best, _ = min((pair for pair in both if all(
        row["status"] == "ok" and row["f_m_end"] >= 3.0 and row["overshoot"] <= 0.02 for row in pair
    )), key=lambda pair: pair[0]["drag"])
    for row, queued in both:
        if sum(row[gain] != best[gain] for gain in GAINS) < 2:  # what each gain does by itself
            print(", ".join(f"{gain[4:]} {row[gain]:g}" for gain in GAINS), end=": ")
            print(f"{row['f_m_end']:.2f} N ({queued['f_m_end']:.2f} N queued), {row['overshoot']:.1%} of overshoot",
                  f"({queued['overshoot']:.1%}), {row['drag']:.2f} N of drag, {1e3 * row['bounce']:.0f} ms off it")
    print("chosen:", *(f"{gain}={best[gain]:g}" for gain in GAINS))
