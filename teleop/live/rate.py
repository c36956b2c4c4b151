"""What a live end is asked of its ticks: the rate, a whole part of its scene's, and the clock or packets."""

from __future__ import annotations

from teleop.errors import Refused, number
from teleop.protocol.guard import UNNAMED
from teleop.protocol.manifest import MOST_EVERY
from teleop.scene.playout import Fixed, Integral, Playout, as_typed, integrates
from teleop.scene.scene import Scene


def ticks_of(scene: Scene, rate: float | None, *, lockstep: bool, spin: bool) -> int:
    """The ticks of the scene to one of an end that ticks at `rate` (Hz); None: the scene's own.

    Raises `Refused`, also where what is asked of the clock is asked of an end that goes by packets.
    """
    if lockstep and spin:
        raise Refused("--spin is for ends that tick by the clock, and with --lockstep they tick by packets; leave one "
                      "of them out")
    if lockstep and scene.deadband is not None:
        raise Refused("with --lockstep each end waits for the other's packet of every tick, and a deadband leaves "
                      "packets out; leave one of them out")
    if rate is None:
        return 1
    number("--rate", rate, above=0.0)
    every: int = round(1.0 / (rate * scene.dt))
    if every > MOST_EVERY:
        raise Refused(f"--rate {rate:g} is less than a {MOST_EVERY}th of the scene's {1.0 / scene.dt:g} Hz; "
                      "set the scene's dt instead")
    if every < 1 or abs(every * rate * scene.dt - 1.0) > 1e-6:
        own = 1.0 / scene.dt
        raise Refused(f"--rate {rate:g} is no whole part of the scene's {own:g} Hz; write for example --rate "
                      f"{own / 2:g}, or set the scene's dt")
    if every != 1 and scene.has_waves and not integrates(scene.played_as):
        raise Refused(f"--rate {rate:g} is not the scene's, and ends at different rates exchange waves by their "
                      f"integral; write --set playout={as_typed(_integrated(scene.played_as))} at both ends")
    if lockstep and every != 1:
        raise Refused("--lockstep runs both ends at the scene's own rate; leave out --rate")
    dog = scene.watchdog or UNNAMED
    if every * scene.dt > dog.timeout:
        raise Refused(f"--rate {rate:g} sends a message every {every * scene.dt:g} s, which the other end takes "
                      f"for silence: its watchdog's timeout is {dog.timeout:g} s; write a higher --rate, or a longer "
                      "timeout in the scene")
    return every


def _integrated(playout: Playout) -> Playout:
    return Fixed(playout.delay, Integral()) if isinstance(playout, Fixed) else Integral()
