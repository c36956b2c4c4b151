"""The link between the two ends: its effects on packets, one small file per effect.

`channel.link` names whole links (`parse_link`, `describe`, `Link`), `channel.schedule` draws the arrivals
of all packets, at once or as they are sent, and `channel.relay` is the core of the live relay.
"""

from __future__ import annotations

import teleop

if getattr(teleop, "DISTRIBUTION", None) != "bilateral-teleop":
    raise ImportError(
        f"the `teleop` imported from {getattr(teleop, '__file__', None)} is another project's: two packages "
        "on the index use this import name and overwrite each other's files, so make an environment of its "
        "own (python -m venv env) and there `pip install bilateral-teleop`"
    )
