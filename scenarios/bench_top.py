"""For real machines: no simulated hand and no simulated wall, limits on from the start, and no end but yours.

    python -m master bench_top --device my_handle.py:Handle --peer 127.0.0.1:9001 --set axes=3
    python scenarios/examples/device.py bench_top --listen 127.0.0.1:9001

Masses and damping are those of your devices: an observer of the hand's force goes by the master's, and the conditions
of a law by both. Where no device is named the simulated ones stand in for it, which nothing moves. In virtual time it
needs a duration, and a schedule stands in for the operator's switches.
"""

from __future__ import annotations

from typing import Annotated, Any

from teleop import Cap, Handover, Knob, Law, MassDamper, Operator, Scene, Watchdog, Wave, each_axis, knob

DAY = 86400.0  # s
PerAxis = float | tuple[float, ...]
Times = float | tuple[float, ...]


def scene(
    *,
    law: Law = Wave(),
    axes: Annotated[int, Knob("", "axes of either machine", low=1, high=16)] = 1,
    units: Annotated[str, Knob("", "what the axes count in, m or rad; one for all, or one for each: m,m,rad")] = "m",
    names: Annotated[str, Knob("", "names of the axes, as shoulder,elbow; none: x, y, z or axis1, axis2, ...")] = "",
    m_m: Annotated[PerAxis, Knob("kg", "mass (or inertia, kg m^2) of the master", above=0.0)] = 0.1,
    b_m: Annotated[PerAxis, Knob("N s/m", "viscous damping of the master", low=0.0)] = 0.5,
    m_s: Annotated[PerAxis, Knob("kg", "mass (or inertia, kg m^2) of the slave", above=0.0)] = 0.5,
    b_s: Annotated[PerAxis, Knob("N s/m", "viscous damping of the slave", low=0.0)] = 1.0,
    delay: Annotated[float | None, Knob(
        "s", "delay of an emulated link, each way; none: the network that is there", low=0.0, link=True)] = None,
    f_max: Annotated[PerAxis | None, Knob("N", "most force (or torque, N m) of either end; none: any", low=0.0)] = 5.0,
    slew: Annotated[PerAxis | None, Knob(
        "N/s", "most change of either force (or torque, N m/s); none: any, also a jump", above=0.0)] = 500.0,
    v_max: Annotated[PerAxis | None, Knob(
        "m/s", "speed (or rad/s) from which on an end only brakes; none: it drives at any speed", low=1e-9)] = 0.5,
    power: knob.PowerBudget = None,
    timeout: knob.Timeout = 0.2,
    age: knob.MessageAge = 2.5,
    clutch_ramp: Annotated[float, Knob(
        "s", "time in which the force fades out, and in, where the operator's clutch opens or nobody is there",
        low=0.0)] = 0.05,
    clutch: Annotated[Times, Knob(
        "s", "times at which the clutch opens and closes in turn: 2,3,5,6; beside the device's own", low=0.0)] = (),
    absent: Annotated[Times, Knob("s", "times at which the operator goes and comes in turn", low=0.0)] = (),
    closes_within: Annotated[PerAxis | None, Knob(
        "m", "farthest (or rad) that the ends may be apart when the clutch closes, of a law that compares positions; "
        "none: any", above=0.0)] = None,
    align: Annotated[PerAxis | None, Knob(
        "m/s", "speed (or rad/s) by which the arm is brought to the handle before the clutch closes; 0 on an axis that "
        "counts anew; none: none is", low=0.0)] = None,
    align_most: Annotated[PerAxis | None, Knob(
        "m", "longest way (or rad) of that; none: any", above=0.0)] = None,
    needs_clutch: Annotated[bool, Knob("", "refuse a master's device without a clutch")] = False,
    needs_present: Annotated[bool, Knob("", "refuse a master's device without an operator-present switch")] = False,
    policy: Annotated[PerAxis | None, Knob(
        "N", "most force (or torque, N m) of a policy that may take over; none: no policy", above=0.0)] = None,
    policy_stiffness: Annotated[PerAxis, Knob(
        "N/m", "stiffness (or N m/rad) by which it pulls the master", low=0.0)] = 12.0,
    policy_tank: Annotated[float, Knob("J", "energy tank of that policy", above=0.0)] = 0.3,
    policy_power: Annotated[float, Knob("W", "power that fills it", low=0.0)] = 0.6,
    observer: knob.ObserverBandwidth = 200.0,
    energy: knob.EnergyLedgers = True,
    dt: knob.Tick = 1e-3,
    duration: Annotated[float, Knob("s", "when it ends by itself; a day, that is when you stop it", above=0.0)] = DAY,
) -> Scene:
    """Two machines of yours, up to 16 axes: no simulated hand or wall, caps and watchdog on, clutch and scaling."""
    needs = tuple([name for name, needed in (("clutch", needs_clutch), ("present", needs_present)) if needed])
    each = units.split(",")
    return Scene(
        law=law,
        axes=axes,
        units=tuple(each * axes if len(each) == 1 else each),
        names=tuple(names.split(",")) if names else (),
        master=each_axis(MassDamper, axes, mass=m_m, damping=b_m),
        slave=each_axis(MassDamper, axes, mass=m_s, damping=b_s),
        link=None if delay is None else constant(delay),
        watchdog=None if timeout is None else Watchdog(timeout=timeout, age=age),
        cap=each_axis(Cap.of, axes, f_max=f_max, slew=slew, v_max=v_max, power=power),
        operator=Operator(clutch=knob.spans("clutch", clutch), absent=knob.spans("absent", absent), ramp=clutch_ramp,
                          closes_within=closes_within, needs=needs, align=align, align_most=align_most),
        handover=None if policy is None else Handover(
            f_max=policy, Kp=policy_stiffness, energy=policy_tank, power=policy_power),
        observer=observer,
        energy=energy,
        dt=dt,
        duration=duration,
    )


def constant(delay: float) -> Any:
    """A link that delays by so much (s), each way; most machines have a network between them, and need none."""
    from channel import Delay

    return Delay(delay)
