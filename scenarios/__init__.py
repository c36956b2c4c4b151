"""One file is one scene: a function `scene` whose keyword parameters are its knobs."""

import teleop

if getattr(teleop, "DISTRIBUTION", None) != "bilateral-teleop":
    raise ImportError(
        "the package `teleop` in this environment is not the one of bilateral-teleop (the index knows another of that "
        "name); install bilateral-teleop in an environment of its own"
    )
