"""File of an arm's position servos, as `teleop identify` writes it: a table [[joint]] for each."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from teleop.errors import Refused, number, number_of
from teleop.physics.servo import Servo
from teleop.storage.toml_tables import check_keys, is_tables, read_toml

KEYS = ("K", "damping", "friction", "lateness", "inertia")  # N m/rad, N m s/rad, N m, s, kg m^2
LINK = 0.25  # of the inertia, beyond the gear


def servos_of_file(path: str | Path, joints: int, **numbers: Any) -> tuple[Servo, ...]:
    """Make the servos of a file that `teleop identify` wrote; `numbers`: the others of each `Servo`.

    `joints`: how many there must be. Half of the lateness is that of the goals. Raises `Refused`.
    """
    tables = read_toml(Path(path), f"the servos' file {path}", "a file that teleop identify wrote").get("joint")
    count = len(tables) if isinstance(tables, list) and is_tables(tables) else 0
    if tables is None or count != joints:
        raise Refused(f"the servos' file {path} is of another arm: it has {number_of(count, 'joint')}, and {joints} "
                      "are needed; name the file of this one")
    servos = []
    for i, table in enumerate(tables):
        where = f"joint {i + 1} of {path}"
        check_keys(table, (*KEYS, "errors"), where)
        if missing := [key for key in KEYS if key not in table]:
            raise Refused(f"{where} has no {missing[0]}; write it anew with teleop identify")
        values = {key: number(f"{key} of {where}", table[key], low=0.0) for key in KEYS}
        late, inertia = values.pop("lateness"), values.pop("inertia")
        servos.append(Servo(**{**values, "inertia": (1.0 - LINK) * inertia, "link": LINK * inertia,
                               "bus": (0.5 * late, 0.5 * late), **numbers}))
    return tuple(servos)
