"""The tick, written once: the text from which every run is made, in virtual time and live.

`END` is one end's tick. Both ends are made from it, and both ways of running are made from both: the
loop of virtual time holds the two ends' lines, and a live process holds one end's. So a law, its
observer, its watchdog and its ledgers see the same arithmetic in the same order wherever they run.

How to read the text. A line ending in `#? a !b` stays only in a scene that has the feature a and not
b; the rest is not there to be paid for. A line with `@` is repeated for each axis, and
`<<f@>>` lists the axes on one line. `{e}` is the end, m or s.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from teleop.law import At, reads
from teleop.playout import repeats
from teleop.scene import Scene

START = """
c_obs = coefficients(scene.observer, scene.master.mass, scene.master.damping, dt)  #? observe_{e}
v_before_{e}@ = v_{e}@; f_h_hat@ = 0.0                         #? observe_{e}
s_{e}@, rx_{e}@ = law.{end}_start(start_at(x_{e}@, v_{e}@, {touch}, dt))
f_{e}@ = 0.0
newest_{e} = -1                                                #? age_{e}
heard_{e} = -1; g_{e} = 1.0                                    #? watchdog
c_dog = scene.watchdog.limits(dt)                              #? watchdog
c_cap = scene.cap.limits(dt)                                   #? cap
x_before_{e}@ = x_{e}@                                         #? dx_{e}
E_in_{out} = E_out_{in} = 0.0                                  #? waves
E_port_{e} = 0.0                                               #? energy
"""

END = """
age_{e} = (k - newest_{e}) * dt if newest_{e} >= 0 else inf    #? age_{e}
dx_{e}@ = x_{e}@ - x_before_{e}@; x_before_{e}@ = x_{e}@       #? dx_{e}
E_port_{e} = E_port_{e} + f_{e}@ * dx_{e}@                     #? energy
f_h_hat@ = observe(c_obs, f_h_hat@, v_before_{e}@, v_{e}@, f_{e}@)  #? observe_{e}
v_before_{e}@ = v_{e}@                                         #? observe_{e}
at@ = new(At, (x_{e}@, v_{e}@, {touch}, f_{e}@, {dx}, {fresh}, {age}, dt))
sum@ = sums_{e}(s_{e}@, at@, rx_{e}@)                          #? sums_{e}
over = {over}                                                  #? sums_{e}
push@, tx_{e}@, s_{e}@ = law_{e}(s_{e}@, at@, rx_{e}@, over)   #? sums_{e}
push@, tx_{e}@, s_{e}@ = law_{e}(s_{e}@, at@, rx_{e}@)         #? !sums_{e}
heard_{e} = k if got_{e} else heard_{e}                        #? watchdog
g_{e} = watch(c_dog, g_{e}, k - heard_{e})                     #? watchdog
push@ = g_{e} * push@                                          #? watchdog
f_{e}@ = cap(c_cap, push@, f_{e}@)                             #? cap
f_{e}@ = push@                                                 #? !cap
wave = rx_{e}@.{rx_wave} * {fresh}; E_out_{in} = E_out_{in} + half_dt * (wave * wave)  #? waves
wave = tx_{e}@.{tx_wave}; E_in_{out} = E_in_{out} + half_dt * (wave * wave)            #? waves
"""

LIVE = """
def live(scene, law, dt, x0, v0, touch0):
    def observer_over(ticks):                                           #? observe_{e}
        # after a stall the force was held over several ticks at once  #? observe_{e}
        return coefficients(scene.observer, scene.master.mass, scene.master.damping, ticks * dt)  #? observe_{e}
    half_dt = 0.5 * dt
    law_{e} = law.{end}
    sums_{e} = law.{end}_sums                                  #? sums_{e}
    <<x_{e}@>>, = x0; <<v_{e}@>>, = v0
    <<{sensor}@>>, = touch0                                    #? sense_{e}
    [START {e}]
    k_before = -1; c_tick = c_obs                              #? observe_{e}
    k, x, v, touch, got_{e}, newest, rx = yield
    while True:
        c_obs = c_tick if k == k_before + 1 else observer_over(k - k_before)  #? observe_{e}
        k_before = k                                           #? observe_{e}
        <<x_{e}@>>, = x; <<v_{e}@>>, = v
        <<{sensor}@>>, = touch                                 #? sense_{e}
        if got_{e}:
            newest_{e} = newest                                #? age_{e}
            <<rx_{e}@>>, = rx
        [END {e}]
        k, x, v, touch, got_{e}, newest, rx = yield (<<f_{e}@>>,), (<<tx_{e}@>>,), ({row_e},)
"""

LOOP = """
def loop(scene, law, dt, count, x_limit, start_m, start_s, play_m, play_s, size, ref, grip, plants, rows_m, rows_s):
    half_dt = 0.5 * dt
    law_m = law.master; law_s = law.slave
    sums_m = law.master_sums                                   #? sums_m
    sums_s = law.slave_sums                                    #? sums_s
    <<x_m@>>, = start_m; <<x_s@>>, = start_s
    v_m@ = 0.0; v_s@ = 0.0; slope@ = 0.0; capped = 0
    (move@, force@, c@) = plants[{i}]
    r@ = ref[{i}]                                              #? hand
    f_h@ = 0.0                                                 #? sense_m
    f_h@ = grip_force(grip, x_m@, v_m@, 0.0, r@[0], slope@)    #? sense_m hand
    f_env@ = force@(c@, x_s@, v_s@)                            #? sense_s
    [START m]
    [START s]
    ring_m = [None] * size; ring_s = [None] * size             #? link
    tx_m@ = rx_s@; tx_s@ = rx_m@                               #? !link
    for k in range(count):
        # 1. read: the left limit at t_k, the force of the last tick still acting
        f_h@ = grip_force(grip, x_m@, v_m@, f_m@, r@[k], slope@)  #? sense_m hand
        f_env@ = force@(c@, x_s@, v_s@)                        #? sense_s
        # 2. what the link delivers at this tick
        seq = play_m[k]; got_m = seq >= 0                      #? link
        if got_m:                                              #? link
            newest_m = seq                                     #? link age_m
            <<rx_m@>> = ring_s[seq % size]                    #? link
        seq = play_s[k]; got_s = seq >= 0                      #? link
        if got_s:                                              #? link
            newest_s = seq                                     #? link age_s
            <<rx_s@>> = ring_m[seq % size]                    #? link
        got_m = got_s = k > 0                                  #? !link
        newest_m = k - 1                                       #? !link age_m
        newest_s = k - 1                                       #? !link age_s
        rx_m@ = tx_s@; rx_s@ = tx_m@                           #? !link
        # 3. the two ends
        [END m]
        rows_m(({row_m},))
        [END s]
        rows_s(({row_s},))
        ring_m[k % size] = <<tx_m@>>; ring_s[k % size] = <<tx_s@>>  #? link
        # 4. the forces are held for one tick while the plants move exactly
        x_m@, v_m@ = move_gripped(grip, x_m@, v_m@, f_m@, r@[k], r@[k + 1])  #? hand
        slope@ = (r@[k + 1] - r@[k]) / dt                      #? hand sense_m
        x_m@, v_m@, _ = move_free(grip, x_m@, v_m@, -f_m@)     #? !hand
        x_s@, v_s@, more = move@(c@, x_s@, v_s@, f_s@); capped += more
        if not (-x_limit < x_m@ < x_limit and -x_limit < x_s@ < x_limit): break
    else:
        return count, capped, None
    return k + 1, capped, ((<<x_m@>>,), (<<x_s@>>,))
"""


class End(NamedTuple):
    """The names that tell one end's text from the other's."""

    e: str
    end: str
    sensor: str  # the force that is measured there
    out: str  # the direction it sends in
    tx_wave: str
    rx_wave: str

    @property
    def inward(self) -> str:
        return "bwd" if self.out == "fwd" else "fwd"


MASTER = End("m", "master", "f_h", "fwd", "u", "w")
SLAVE = End("s", "slave", "f_env", "bwd", "w", "u")
ENDS = {"m": MASTER, "s": SLAVE}


def features(scene: Scene) -> frozenset[str]:
    """Which features of the tick's text a scene names."""
    law: Any = scene.law
    named = {
        "link": scene.link is not None, "repeats": repeats(scene.playout), "hand": scene.hand is not None,
        "watchdog": scene.watchdog is not None, "cap": scene.cap is not None, "energy": scene.energy,
        "waves": scene.energy and scene.has_waves,
    }
    for end in (MASTER, SLAVE):
        wanted = reads(getattr(law, end.end)) | reads(getattr(law, f"{end.end}_sums", None) or len)
        named[f"sums_{end.e}"] = hasattr(law, f"{end.end}_sums")
        named[f"age_{end.e}"] = "age" in wanted
        named[f"dx_{end.e}"] = "dx" in wanted or scene.energy
        named[f"touch_{end.e}"] = "f" in wanted
    named["observe_m"] = named["touch_m"] and scene.observer is not None
    named["sense_m"] = named["touch_m"] and scene.observer is None
    named["sense_s"] = named["touch_s"]
    return frozenset(name for name, has in named.items() if has)


def columns(scene: Scene, e: str) -> list[str]:
    """The names of one end's record, in order; each stands once per axis where it has axes."""
    has, end = features(scene), ENDS[e]
    names = [f"x_{e}@", f"v_{e}@"]
    names += [f"{end.sensor}@"] * (f"sense_{e}" in has)
    names += [f"f_{e}@"]
    names += ["f_h_hat@"] * (f"observe_{e}" in has)
    names += [f"g_{e}"] * ("watchdog" in has)
    names += [f"E_in_{end.out}", f"E_out_{end.inward}"] * ("waves" in has)
    names += [f"E_port_{e}"] * ("energy" in has)
    return names


def loop_text(scene: Scene) -> str:
    """The source of the whole virtual-time loop of this scene."""
    return specialise(LOOP, scene, MASTER)


def live_text(scene: Scene, e: str) -> str:
    """The source of one live end of this scene, a generator."""
    return specialise(LIVE, scene, ENDS[e])


def compiled(scene: Scene, text: str, name: str, instead: Mapping[str, Any] | None = None) -> Callable[..., Any]:
    """The function `name` of a text made here, with the parts of the stack that it names, or others `instead`."""
    has = features(scene)
    from teleop.law import start_at

    parts: dict[str, Any] = {"new": tuple.__new__, "At": At, "start_at": start_at, "inf": float("inf"),
                             "nan": float("nan")}
    if has & {"sums_m", "sums_s"}:
        parts["over_axes"] = over_axes
    if "observe_m" in has:
        from teleop.observer import coefficients, observe

        parts |= {"coefficients": coefficients, "observe": observe}
    if has & {"watchdog", "cap"}:
        from teleop.safety import cap, watch

        parts["watch"], parts["cap"] = watch, cap
    from teleop.plant import grip_force, move_free, move_gripped

    parts |= {"grip_force": grip_force, "move_free": move_free, "move_gripped": move_gripped}
    parts |= instead or {}
    exec(compile(text, f"<{name} of scene {scene.name}>", "exec"), parts)
    function: Callable[..., Any] = parts[name]
    return function


def over_axes(first: Any, *others: Any) -> Any:
    """Field by field sums over the axes, left to right (not `sum`, which compensates from Python 3.12)."""
    total = first
    for other in others:
        total = type(first)(*[a + b for a, b in zip(total, other, strict=True)])
    return total


def specialise(text: str, scene: Scene, end: End) -> str:
    """A text with the lines that this scene needs, its axes unrolled and its names filled in."""
    has = features(scene)
    lines = list(_unroll(_lines(text, scene, end, has), scene.axes))
    return "\n".join(lines) + "\n"


def _lines(text: str, scene: Scene, end: End, has: frozenset[str]) -> Iterator[str]:
    """The lines that this scene needs, with the ends' texts put in and the ends' names filled in."""
    for raw in text.strip("\n").splitlines():
        inner = re.fullmatch(r"( *)\[(START|END) (\S+)\]", raw.replace("{e}", end.e))
        if inner:
            block = {"START": START, "END": END}[inner[2]]
            yield from (inner[1] + line for line in _lines(block, scene, ENDS[inner[3]], has))
            continue
        line, _, wanted = raw.partition("#?")
        line, wanted = line.rstrip(), wanted.replace("{e}", end.e)
        if line and all((w[1:] not in has) if w[0] == "!" else (w in has) for w in wanted.split()):
            yield _named(line, scene, end, has)


def _named(line: str, scene: Scene, end: End, has: frozenset[str]) -> str:
    e = end.e
    sensed, observed = f"sense_{e}" in has, f"observe_{e}" in has
    words = {
        "e": e, "end": end.end, "out": end.out, "in": end.inward, "sensor": end.sensor,
        "tx_wave": end.tx_wave, "rx_wave": end.rx_wave,
        "touch": f"{end.sensor}@" if sensed else "f_h_hat@" if observed else "nan",
        "dx": f"dx_{e}@" if f"dx_{e}" in has else "nan",
        "age": f"age_{e}" if f"age_{e}" in has else "nan",
        "fresh": "True" if "repeats" in has else f"got_{e}",
        "over": "sum0" if scene.axes == 1 else "over_axes(<<sum@>>)",
        "row_e": _row(scene, e), "row_m": _row(scene, "m"), "row_s": _row(scene, "s"), "i": "@",
    }
    return re.sub(r"\{(\w+)\}", lambda found: words[found[1]], line)


def _row(scene: Scene, e: str) -> str:
    return ", ".join(f"<<{name}>>" if "@" in name else name for name in columns(scene, e))


def _unroll(lines: Iterator[str], axes: int) -> Iterator[str]:
    for line in lines:
        flat = re.sub(r"<<(.*?)>>", lambda m: ", ".join(m[1].replace("@", str(i)) for i in range(axes)), line)
        if "@" in flat:
            yield from (flat.replace("@", str(i)) for i in range(axes))
        else:
            yield flat
