"""Abbott and Okamura 2005: the stiffness that an encoder, a sampling rate, damping and friction allow."""

from __future__ import annotations

from teleop.analysis.passivity.one_port import one_port
from teleop.studies.reproduce.publication import NumberSource, Publication, Replication, wall

DEVICES = ((0.8, 0.02, 5e-5), (0.8, 0.02, 1e-5), (0.1, 0.04, 3e-5))  # N s/m, N, m
NEAR = 1e-3


def rerun() -> list[Replication]:
    """The greatest passive stiffness of three devices, and the verdict on either side of it."""
    numbers = []
    for b, friction, step in DEVICES:
        most = min(2.0 * b / 1e-3, 2.0 * friction / step)
        device = f"b = {b:g} N s/m, f_c = {friction:g} N, D = {step * 1e6:g} um"
        knobs = {"b": b, "friction": friction, "step": step}
        for factor, expected in ((1.0 - NEAR, "passive"), (1.0 + NEAR, "not passive")):
            verdict = one_port(wall(most * factor, **knobs)).passive
            numbers.append(Replication(f"{device}: a wall of {most * factor:.5g} N/m", expected, {
                True: "passive", False: "not passive", None: "not known"}[verdict], "", f"{NEAR:.1%} from the bound"))
    return numbers


PUBLICATION = Publication(
    name="abbott_okamura",
    kind=NumberSource.FORMULA,
    source="J. J. Abbott and A. M. Okamura, Effects of position quantization and sampling rate on virtual-wall "
           "passivity, IEEE Trans. Robotics 21(5), 2005",
    about="a sampled spring behind an encoder of step D is passive if K <= min(2 b/T, 2 f_c/D)",
    setting="scene virtual_wall with encoder and Coulomb friction, 1 kHz; the verdict is that of teleop passivity, a "
            "thousandth below and above the printed bound",
    rerun=rerun,
)
