"""A metric of your own: how fast the hand's force rises, and what work the hand does. Run it as it stands."""

from __future__ import annotations

import numpy as np

from teleop import Result, sweep


def strike(result: Result) -> float:
    """The greatest rise of the hand's force within 10 ms, N."""
    f_m = result.trace["f_m"].reshape(len(result.trace["t"]), -1)  # one row a tick, one column an axis
    span = round(0.01 / result.dt)
    return float(np.abs(f_m[span:] - f_m[:-span]).max(initial=0.0))  # of a shorter run 0


def work(result: Result) -> float:
    """The work that the hand has done on the master by the end of the run, J."""
    trace = result.trace
    return float((trace["f_h"] * trace["v_m"]).sum() * result.dt)


if __name__ == "__main__":
    axes: dict[str, list[object]] = {"law": ["wave", "pfra"], "k_e": [100.0, 1000.0]}
    table = sweep("soft_tissue", axes, metrics=[strike, work, "x_err_rms"], fixed={"delay": 0.05})
    for law, k_e, blow, done in zip(table["law"], table["k_e"], table["strike"], table["work"], strict=True):
        print(f"{law:<5} {k_e:5g} N/m: {blow:6.3f} N within 10 ms, the hand did {done:6.3f} J")
