"""The version of this package, and the name under which it is distributed.

Modules ask here and not `teleop` itself, which offers names of all rooms and so stands above them.
"""

from __future__ import annotations

__version__ = "0.1.0"
DISTRIBUTION = "bilateral-teleop"  # the index has another package that imports as `teleop`
