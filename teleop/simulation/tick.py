"""The tick, written once: the text from which every run is made, in virtual time and live.

`END` is one end's tick. Both ends are made from it, and both ways of running are made from both: the
loop of virtual time holds the two ends' lines, and a live process holds one end's. So a law, its
observer, its watchdog and its ledgers see the same arithmetic in the same order wherever they run.

How to read the text. A line ending in `#? a !b` stays only in a scene that has the feature a and not
b; the rest is not there to be paid for. A line with `@` is repeated for each axis, and
`<<f@>>` lists the axes on one line. `{e}` is the end, m or s.

A force that is infinite becomes NaN before the cap, which would make a plausible one of it: it must be seen.

In virtual time the watchdog is part of the text. A live end has more causes to let go than silence, and its gain g
comes from the one place that knows them all, `teleop.protocol.guard`, which calls the same `watch`.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from teleop.law import functions_of, reads
from teleop.scene.playout import repeats
from teleop.scene.scene import Scene

if TYPE_CHECKING:
    from teleop.stages.device import Device

START = """
c_enc_{e} = given.c_enc_{e}                                    #? encoder_{e}
q_{e}@ = encode(c_enc_{e}, x_{e}@)                             #? encoder_{e}
c_est_{e} = given.c_est_{e}; est_{e}@ = given.est_{e}[{i}]; v_hat_{e}@ = {zero}  #? velocity_{e}
c_obs = given.c_obs                                            #? observe_{e}
v_before_{e}@ = {v}; f_h_hat@ = {zero}                            #? observe_{e}
s_{e}@, rx_{e}@ = begin_{e}(law, start_at({x}, {v}, {touch}, dt))  #? !alone
s_{e}@ = begin_{e}(law, start_at({x}, {v}, {touch}, dt))       #? alone
f_{e}@ = {zero}
line_{e}@ = given.line_{e}                                     #? late_{e}
every_{e} = given.every_{e}; slow_{e}@ = {zero}                #? slow_{e}
c_pc = given.c_pc; E_po@ = 0.0                                 #? popc_{e}
newest_{e} = -1                                                #? newest_{e}
heard_{e} = -1; g_{e} = 1.0; calm_{e} = inf                    #? watchdog !live
c_dog = given.c_dog                                            #? watchdog !live
c_cap = given.c_cap                                            #? cap
c_speed = given.c_speed                                        #? v_max
c_power = given.c_power; E_left_{e} = c_power.full             #? power
x_before_{e}@ = {x}                                            #? dx_{e}
x_was_{e}@ = x_{e}@                                            #? energy encoder_{e}
E_in_{out} = E_out_{in} = 0.0                                  #? waves
E_port_{e} = 0.0                                               #? energy
"""

END = """
age_{e} = (k - newest_{e}) * dt if newest_{e} >= 0 else inf    #? age_{e} !compiled
age_{e} = where(came(newest_{e}), (k - newest_{e}) * dt, inf)  #? age_{e} compiled
q_{e}@ = encode(c_enc_{e}, x_{e}@)                             #? encoder_{e}
v_hat_{e}@, est_{e}@ = estimate_{e}(c_est_{e}, est_{e}@, {x}, span)  #? velocity_{e}
dx_{e}@ = {x} - x_before_{e}@; x_before_{e}@ = {x}             #? dx_{e}
E_port_{e} = E_port_{e} + f_{e}@ * dx_{e}@                     #? energy !encoder_{e}
E_port_{e} = E_port_{e} + f_{e}@ * (x_{e}@ - x_was_{e}@); x_was_{e}@ = x_{e}@  #? energy encoder_{e}
E_po@ = E_po@ + f_{e}@ * dx_{e}@                               #? popc_{e}
f_h_hat@ = observe(c_obs, f_h_hat@, v_before_{e}@, {v}, f_{e}@)  #? observe_{e}
v_before_{e}@ = {v}                                            #? observe_{e}
at@ = new(At, ({x}, {v}, {touch}, f_{e}@, {dx}, {fresh}, {age}, dt))  #? !kernel
at@ = At({x}, {v}, {touch}, f_{e}@, {dx}, {fresh}, {age}, dt)  #? kernel
sum@ = sums_{e}(law, s_{e}@, at@, rx_{e}@)                     #? sums_{e}
over = {over}                                                  #? sums_{e}
push@, tx_{e}@, s_{e}@ = law_{e}(law, s_{e}@, at@, rx_{e}@, over)  #? sums_{e}
push@, tx_{e}@, s_{e}@ = law_{e}(law, s_{e}@, at@, rx_{e}@)    #? !sums_{e} !alone
push@, s_{e}@ = law_{e}(law, s_{e}@, at@)                      #? alone
line_{e}@ = line_{e}@ + (push@,); push@ = line_{e}@[0]; line_{e}@ = line_{e}@[1:]  #? late_{e}
push@ = slow_{e}@ = slow_{e}@ if k % every_{e} else push@      #? slow_{e}
push@ = push@ + damp(c_pc, E_po@, {v})                         #? popc_{e}
heard_{e} = k if got_{e} else heard_{e}                        #? watchdog !aged !compiled !live
heard_{e} = k if got_{e} and k - newest_{e} <= c_dog.age else heard_{e}  #? aged !compiled !live
heard_{e} = where(got_{e}, k, heard_{e})                       #? watchdog !aged compiled
heard_{e} = where(k - newest_{e} <= c_dog.age, where(got_{e}, k, heard_{e}), heard_{e})  #? aged compiled
g_{e}, calm_{e} = watch(c_dog, g_{e}, calm_{e}, k - heard_{e})  #? watchdog !live
push@ = g_{e} * push@                                          #? watched
push@ = push@ + 0.0 * push@                                    #? cap
push@ = fade(c_speed, push@, {along})                          #? v_max
E_left_{e} = pay(E_left_{e}, f_{e}@ * {moved})                 #? power
E_left_{e} = refill(c_power, E_left_{e})                       #? power
push@ = ration(c_power, E_left_{e}, push@, {along})            #? power
f_{e}@ = cap(c_cap, push@, f_{e}@)                             #? cap
f_{e}@ = push@                                                 #? !cap
wave = rx_{e}@.{rx_wave} * {fresh}; E_out_{in} = E_out_{in} + half_dt * (wave * wave)  #? waves
wave = tx_{e}@.{tx_wave}; E_in_{out} = E_in_{out} + half_dt * (wave * wave)            #? waves
"""

LIVE = """
def live(scene, given, law, dt, x0, v0, touch0):
    def observer_over(ticks):                                           #? observe_{e}
        # after a stall the force was held over several ticks at once  #? observe_{e}
        return coefficients(scene.observer, scene.master.mass, scene.master.damping, ticks * dt)  #? observe_{e}
    half_dt = 0.5 * dt
    <<x_{e}@>>, = x0; <<v_{e}@>>, = v0
    <<{sensor}@>>, = touch0                                    #? felt_{e}
    [START {e}]
    c_tick = c_obs                                             #? observe_{e}
    c_once = c_cap                                             #? cap
    k, x, v, touch, got_{e}, newest, rx, g_{e}, held, since = yield
    k_before = k - 1
    while True:
        c_obs = c_tick if k == k_before + 1 else observer_over(k - k_before)  #? observe_{e}
        span = (k - k_before) * dt                             #? velocity_{e}
        # let go after a stall: what it could have slewed in the meantime it slews now  #? cap
        late = since if g_{e} <= 0.0 else 1                    #? cap
        c_cap = c_once if late == 1 else c_once._replace(step=c_once.step * late)  #? cap
        k_before = k
        <<x_{e}@>>, = x; <<v_{e}@>>, = v; <<f_{e}@>>, = held
        <<{sensor}@>>, = touch                                 #? felt_{e}
        if got_{e}:
            newest_{e} = newest                                #? age_{e}
            <<rx_{e}@>>, = rx
        [END {e}]
        k, x, v, touch, got_{e}, newest, rx, g_{e}, held, since = yield (<<f_{e}@>>,), (<<tx_{e}@>>,), ({row_e},)
"""

LOOP = """
def loop(given, law, dt, count, x_limit, start_m, start_s, play_m, play_s, size, ref, held, rows_m, rows_s):  #? !kernel
def loop(given, law, dt, count, x_limit, start_m, start_s, play_m, play_s, size, ref, held, {asked}):  #? kernel
    half_dt = 0.5 * dt
    span = dt                                                  #? estimates
    <<x_m@>>, = start_m
    <<x_s@>>, = start_s                                        #? slave
    v_m@ = {zero}; slope@ = {zero}; capped = 0
    v_s@ = {zero}                                              #? slave
    grip = held.grip
    z_m@ = held.z_m                                            #? inner_m
    c@ = held.c[{i}]                                           #? slave
    z_s@ = held.z_s[{i}]                                       #? inner_s
    r@ = ref[{i}]                                              #? hand
    f_h@ = {zero}                                              #? felt_m
    f_h@ = grip_force(grip, x_m@, v_m@, {zero}, {r_0}, slope@)  #? felt_m hand !inner_m
    f_h@ = held_force(grip, x_m@, v_m@, {zero}, {r_0}, slope@, z_m@)  #? hand inner_m
    f_env@ = force@(c@, x_s@, v_s@)                            #? felt_s !inner_s
    f_env@ = force@(c@, x_s@, v_s@, z_s@)                      #? inner_s
    [START m]
    [START s]                                                  #? slave
    [RINGS]                                                    #? link
    tx_m@ = rx_s@; tx_s@ = rx_m@                               #? !link slave
    [SUMS]                                                     #? kernel
    for k in range(count):
        # 1. read: the left limit at t_k, the force of the last tick still acting
        f_h@ = grip_force(grip, x_m@, v_m@, f_m@, {r_k}, slope@)  #? felt_m hand !inner_m
        f_h@ = held_force(grip, x_m@, v_m@, f_m@, {r_k}, slope@, z_m@)  #? hand inner_m
        f_env@ = force@(c@, x_s@, v_s@)                        #? felt_s !inner_s
        f_env@ = force@(c@, x_s@, v_s@, z_s@)                  #? inner_s
        # 2. what the link delivers at this tick
        [DELIVER]                                              #? link
        got_m = got_s = k > 0                                  #? !link slave
        newest_m = k - 1                                       #? !link newest_m
        newest_s = k - 1                                       #? !link newest_s
        rx_m@ = tx_s@; rx_s@ = tx_m@                           #? !link slave
        # 3. the two ends
        [END m]
        rows_m(({row_m},))                                     #? !kernel
        [END s]                                                #? slave
        rows_s(({row_s},))                                     #? slave !kernel
        [MEASURE]                                              #? kernel
        [SEND]                                                 #? link
        # 4. the forces are held for one tick while the plants move exactly
        x_m@, v_m@ = move_gripped(grip, x_m@, v_m@, f_m@, {r_k}, {r_next})  #? hand !inner_m
        x_m@, v_m@, z_m@ = move_held(grip, x_m@, v_m@, f_m@, {r_k}, {r_next}, z_m@)  #? hand inner_m
        slope@ = ({r_next} - {r_k}) / dt                       #? hand felt_m
        x_m@, v_m@, _ = move_free(grip, x_m@, v_m@, -f_m@)     #? !hand !inner_m
        x_m@, v_m@, z_m@ = move_held(grip, x_m@, v_m@, f_m@, 0.0, 0.0, z_m@)  #? !hand inner_m
        x_s@, v_s@, more@ = move@(c@, x_s@, v_s@, f_s@)        #? slave !inner_s
        x_s@, v_s@, more@, z_s@ = move@(c@, x_s@, v_s@, f_s@, z_s@)  #? inner_s
        capped += more@                                        #? slave !kernel
        if not (-x_limit < x_m@ < x_limit and -x_limit < x_s@ < x_limit): break  #? slave !lanes
        if not -x_limit < x_m@ < x_limit: break                #? alone !lanes
        [BOUNDS]                                               #? lanes
    tell(out, alive, count, {measured})                        #? lanes
    else:                                                      #? !lanes
        return count, capped, None, {inner}                    #? !kernel
        return count, {measured}                               #? kernel !lanes
    return k + 1, capped, {places}, {inner}                    #? !kernel
    return -(k + 1), {measured}                                #? kernel !lanes
"""

# The link in a run of plain Python: what compiled code does is in `teleop.sweeps.kernels.text`.
RINGS = """
ring_m = [{first_m}] * size; ring_s = [{first_s}] * size
"""

DELIVER = """
seq = play_m[k]; got_m = seq >= 0
if got_m:
    newest_m = seq                                             #? newest_m
    <<rx_m@>> = ring_s[seq % size]
seq = play_s[k]; got_s = seq >= 0
if got_s:
    newest_s = seq                                             #? newest_s
    <<rx_s@>> = ring_m[seq % size]
"""

SEND = """
ring_m[k % size] = <<tx_m@>>; ring_s[k % size] = <<tx_s@>>
"""

BLOCKS = {"START": START, "END": END, "RINGS": RINGS, "DELIVER": DELIVER, "SEND": SEND}
"""The texts that stand within others, as [NAME] or [NAME end]."""


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
    """Which features of the tick's text a scene names; kept with the scene, which does not change."""
    kept: frozenset[str] | None = vars(scene).get("_features")
    if kept is None:
        parts = ("link", "hand", "watchdog", "cap", "passivity", "slave", "observer", "electrical")
        has = frozenset([name for name in parts if getattr(scene, name) is not None])
        has |= {name for name in ("v_max", "power") if getattr(scene.cap, name, None) is not None}
        has |= {"aged"} if getattr(scene.watchdog, "age", None) is not None else set()
        inner_m = scene.master.friction > 0.0 or scene.electrical is not None
        inner_s = scene.slave is not None and (
            scene.slave.friction > 0.0 or any(getattr(one, "inner", False) for one in scene.environments))
        kept = vars(scene)["_features"] = _features(
            functions_of(scene.law), has, repeats(scene.playout), scene.energy, scene.energy and scene.has_waves,
            inner_m, inner_s, _stages(scene.device_m), _stages(scene.device_s))
    return kept


def _stages(device: Device | None) -> frozenset[str]:
    """What a device has of what may stand between it and the law."""
    if device is None:
        return frozenset()
    named = {"encoder": device.encoder is not None, "velocity": device.velocity is not None, "late": device.delay > 0,
             "slow": device.every > 1}
    return frozenset([name for name, has in named.items() if has])


@lru_cache(maxsize=256)  # the rows of a sweep ask the same again and again
def _features(law: Any, parts: frozenset[str], hold: bool, energy: bool, waves: bool, inner_m: bool, inner_s: bool,
              stages_m: frozenset[str], stages_s: frozenset[str]) -> frozenset[str]:
    alone = "slave" not in parts
    named = {
        "repeats": hold, "energy": energy, "waves": waves, "alone": alone, "popc_m": "passivity" in parts,
        "inner_m": inner_m, "inner_s": inner_s, "watched": "watchdog" in parts,
        **{name: name in parts for name in ("link", "hand", "watchdog", "aged", "cap", "v_max", "power", "slave")},
    }
    for end, stages in ((MASTER, stages_m), (SLAVE, stages_s))[: 1 if alone else 2]:
        wanted = reads(law.force if alone else getattr(law, end.end))
        wanted |= reads(getattr(law, f"{end.end}_sums", None) or len)
        named[f"sums_{end.e}"] = hasattr(law, f"{end.end}_sums")
        named[f"age_{end.e}"] = "age" in wanted and not alone
        named[f"newest_{end.e}"] = named[f"age_{end.e}"] or named["aged"]
        named[f"touch_{end.e}"] = "f" in wanted
        named |= {f"{name}_{end.e}": name in stages for name in ("encoder", "velocity", "late", "slow")}
        named[f"dx_{end.e}"] = ("dx" in wanted or (energy and not named[f"encoder_{end.e}"])
                                or named.get(f"popc_{end.e}", False) or named["power"])
    named["observe_m"] = named["touch_m"] and "observer" in parts
    named["sense_m"] = named["touch_m"] and "observer" not in parts
    named["sense_s"] = named.get("touch_s", False)
    for e in ("m", "s"):
        # A body with an inner state cannot tell its touch afterwards, so it is recorded.
        named[f"felt_{e}"] = named[f"sense_{e}"] or named[f"inner_{e}"]
    named["estimates"] = named.get("velocity_m", False) or named.get("velocity_s", False)
    return frozenset(name for name, has in named.items() if has)


def columns(scene: Scene, e: str) -> list[str]:
    """The names of one end's record, in order; each stands once per axis where it has axes."""
    has, end = features(scene), ENDS[e]
    names = [f"x_{e}@", f"v_{e}@"]
    names += [f"q_{e}@"] * (f"encoder_{e}" in has)
    names += [f"v_hat_{e}@"] * (f"velocity_{e}" in has)
    names += [f"{end.sensor}@"] * (f"felt_{e}" in has)
    names += [f"f_{e}@"]
    names += ["f_h_hat@"] * (f"observe_{e}" in has)
    names += ["E_po@"] * (f"popc_{e}" in has)
    names += [f"g_{e}"] * ("watchdog" in has)
    names += [f"E_left_{e}"] * ("power" in has)
    names += [f"E_in_{end.out}", f"E_out_{end.inward}"] * ("waves" in has)
    names += [f"E_port_{e}"] * ("energy" in has)
    return names
