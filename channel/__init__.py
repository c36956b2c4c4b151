"""The link between the two ends: its effects on packets, one small file per effect.

    from channel import Bernoulli, Delay
    link = Delay(0.05) | Bernoulli(0.02)

`parse_link` and `describe` read and write links as text, `check_effect` tries an effect of your own.
`channel.schedule` draws the arrivals of all packets, at once or as they are sent, and `channel.relay` is the core
of the live relay.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

try:
    from teleop.version import DISTRIBUTION as DISTRIBUTION
except ImportError as error:  # another project's package has the same name
    raise ImportError(
        "`channel` found another package called teleop in place of its own; install bilateral-teleop in an "
        "environment of its own: python -m venv own && own/bin/python -m pip install bilateral-teleop"
    ) from error

if TYPE_CHECKING:
    from channel.bernoulli import Bernoulli
    from channel.blackout import Blackout
    from channel.conformance import check_effect
    from channel.delay import Delay
    from channel.duplicate import Duplicate
    from channel.effect import Chain, Effect, probability, seconds
    from channel.gamma import GammaJitter
    from channel.gilbert_elliott import GilbertElliott
    from channel.in_order import InOrder
    from channel.left_out import LeftOut, LeftOutTicks
    from channel.link import Link, describe, parse_link
    from channel.mahimahi import Mahimahi
    from channel.normal import NormalJitter
    from channel.ping_log import PingLog
    from channel.recorded import Recorded
    from channel.rng import Ints, Rng
    from channel.schedule import by_time, later, nanoseconds
    from channel.uniform import UniformJitter

__all__ = [
    "Bernoulli", "Blackout", "Chain", "Delay", "Duplicate", "Effect", "GammaJitter", "GilbertElliott",
    "InOrder", "Ints", "LeftOut", "LeftOutTicks", "Link", "Mahimahi", "NormalJitter", "PingLog", "Recorded", "Rng",
    "UniformJitter", "by_time", "check_effect", "describe", "later", "nanoseconds", "parse_link", "probability",
    "seconds",
]
_HOMES = {  # the module of each name, under this package
    "bernoulli": ("Bernoulli",),
    "blackout": ("Blackout",),
    "conformance": ("check_effect",),
    "delay": ("Delay",),
    "duplicate": ("Duplicate",),
    "effect": ("Chain", "Effect", "probability", "seconds"),
    "gamma": ("GammaJitter",),
    "gilbert_elliott": ("GilbertElliott",),
    "in_order": ("InOrder",),
    "left_out": ("LeftOut", "LeftOutTicks"),
    "link": ("Link", "describe", "parse_link"),
    "mahimahi": ("Mahimahi",),
    "normal": ("NormalJitter",),
    "ping_log": ("PingLog",),
    "recorded": ("Recorded",),
    "rng": ("Ints", "Rng"),
    "schedule": ("by_time", "later", "nanoseconds"),
    "uniform": ("UniformJitter",),
}


if not TYPE_CHECKING:  # a type checker goes by the imports above, and finds a name that is misspelt

    def __getattr__(name: str) -> object:
        from teleop.naming import public_name

        return public_name(__name__, _HOMES, name)


def __dir__() -> list[str]:
    return sorted(__all__)  # and not what this file needs for itself
