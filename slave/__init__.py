"""The robot's side: environments that a slave touches."""

import teleop

if getattr(teleop, "DISTRIBUTION", None) != "bilateral-teleop":
    raise ImportError(
        "`slave` found another package called teleop in place of its own; install bilateral-teleop in an "
        "environment of its own: python -m venv own && own/bin/python -m pip install bilateral-teleop"
    )
