"""The command `teleop stability`, and its plots: roots and open loop of a scene, and its margins over a knob.

The open loop is L_j(w) = -z^-d l_j(z) at z = e^(jwT), of which `teleop.analysis.models.loop` says what l_j is: the
eigenvalues of both ends in series, the delay between them, with the sign that makes -1 the critical point of Nyquist's
criterion. Its phase margin is the least rotation, either way, that brings an L_j of magnitude 1 to -1.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import ceil, log10, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from teleop.analysis.models.by_axis import alike, couples
from teleop.analysis.models.linear import LinearScene, linear_scene
from teleop.analysis.models.loop import gains, in_order, indent, sampled_loop
from teleop.analysis.models.one_port_loop import cut_open, gain_and_mode, one_port
from teleop.analysis.models.peak import Points, Reals
from teleop.analysis.models.roots import MOST_STATES, Roots, dominant, greatest, states
from teleop.analysis.stability.assess import Stability
from teleop.analysis.stability.report import StabilityAnswer, ask, own_value, summary, table
from teleop.errors import Refused
from teleop.scene.loading import load_scene
from teleop.scene.scene import Scene
from teleop.simulation.result import write_npz
from teleop.terminal import plotting as plot
from teleop.terminal.answer import Answer, Task, WithUnit, command_of, interrupts_wait, titled
from teleop.terminal.options import DONE, INTERRUPTED, knobs_from
from teleop.terminal.progress import shown_for
from teleop.terminal.table import si

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NEAREST = 40  # roots that the s-plane is scaled to
MOST_TURNS = 30  # of the Nyquist plot that are still told apart
WIDE = 30.0  # times the growth rate of the slowest: from there on the axes are logarithmic outside
FAINT = 0.05  # of the magnitude: below, the Nyquist plot is at its middle
AT_REST = 1e-6  # from z = 1
COLOURS = (plot.BLUE, plot.ORANGE, plot.GREEN, plot.PURPLE, plot.SKY, plot.GREY)
FAR = 1080.0  # degrees of phase that are shown
DRAWN = 200  # roots of a loop with more states than a dense matrix has
SLOWEST = 0.01  # Hz
PLACES = 1500  # of the frequencies by equal ratios
MOST_PLACES = 40_000  # with those that a delay asks for


class OpenLoop(NamedTuple):
    """The open loop over frequency, and where it passes 1 in magnitude and -1 in phase."""

    frequency: Reals  # Hz, (n,)
    L: Points  # (n, branches)
    delay: float  # s, the round trip that is in it
    phase_margin: float | None  # rad; None: its magnitude is nowhere 1, or the loop is unstable
    gain_crossover: float | None  # Hz, where that is; of an unstable loop the slowest
    phase_crossover: float | None  # Hz, where the gain margin is


class Picture(NamedTuple):
    """Numbers that are drawn of one scene."""

    roots: Roots
    period: float  # s, after which a motion z^k is taken
    loop: OpenLoop | None  # None: the loop cannot be cut open, see `cut_open`


class MarginCurves(NamedTuple):
    """Margins over values of a knob, each (n,); nan where there is none."""

    values: Reals
    growth: Reals  # 1/s, of the dominant mode
    gain_margin: Reals
    phase_margin: Reals  # rad


def picture(scene: Scene, *, unstable: bool, gain_margin: float | None, seed: int = 0) -> Picture:
    """The numbers behind the plot of a scene of that verdict and gain margin. Refused if it is not linear."""
    linear = linear_loop(scene, seed)
    if scene.slave is None and (linear is None or states(linear) <= MOST_STATES):
        whole = one_port(scene)
        z = whole.roots()
        roots, period = Roots(z[np.argsort(-np.abs(z))], len(z), True), whole.dt * len(whole.ticks)
        return Picture(roots, period, linear and open_loop(linear, unstable=unstable, gain_margin=gain_margin))
    assert linear is not None
    loop = open_loop(linear, unstable=unstable, gain_margin=gain_margin)
    return Picture(greatest(linear, DRAWN), linear.dt, loop)


def linear_loop(scene: Scene, seed: int) -> LinearScene | None:
    """The scene as two ends and the delay between them; None for a loop that cannot be cut so."""
    if scene.slave is None:
        return cut_open(scene)
    return linear_scene(scene, seed=seed)


def open_loop(linear: LinearScene, *, unstable: bool, gain_margin: float | None) -> OpenLoop:
    """The open loop from `SLOWEST` to half the rate, as finely as its delay turns it."""
    d, top = linear.round_trip, 0.5 / linear.dt
    even = np.linspace(0.0, top, min(32 * d + 2, MOST_PLACES))[1:]
    f = np.union1d(np.geomspace(min(SLOWEST, 1e-3 * top), top, PLACES), even)
    z = np.exp(2j * pi * linear.dt * f)
    L = -in_order(gains(linear.master, linear.slave, z)) * np.exp(-2j * pi * linear.dt * d * f)[:, None]
    margin, crossover = _phase_margin(linear)
    return OpenLoop(f, L, d * linear.dt, None if unstable else margin, crossover, _phase_crossover(f, L, gain_margin))


def _phase_margin(linear: LinearScene) -> tuple[float | None, float | None]:
    """The least angle (rad) to -1 where the magnitude is 1, and that frequency (Hz)."""
    d, angles = linear.round_trip, []
    for crossing in sampled_loop(linear).crossings(d):
        if crossing.at.imag > 2.0 * indent(linear):
            psi = (crossing.log - d * crossing.at).imag
            angles.append((abs((psi + pi) % (2.0 * pi) - pi), crossing.at.imag / (2.0 * pi * linear.dt)))
    return min(angles) if angles else (None, None)


def _phase_crossover(f: Reals, L: Points, gain_margin: float | None) -> float | None:
    """The frequency (Hz) at which the gain margin brings an L_j to -1; 0 for what rests."""
    if gain_margin is None or gain_margin == 1.0:
        return None if gain_margin is None else 0.0
    passed = (L.imag[1:] * L.imag[:-1] <= 0.0) & (L.real[1:] < 0.0) & (L.real[:-1] < 0.0)
    i, j = np.nonzero(passed)
    ends = [(float(f[k]), float(abs(size))) for k in (0, -1) for size in L[k] if abs(np.angle(-size)) < 1e-2]
    crossings = ends + [(float(f[a]), float(abs(L[a, b]))) for a, b in zip(i, j, strict=True)]
    near = min(crossings, key=lambda one: abs(np.log(max(one[1], 1e-300) * gain_margin)), default=None)
    return near[0] if near is not None and abs(near[1] * gain_margin - 1.0) < 0.2 else None


def sweep(make: Callable[[float], Scene], values: Sequence[float], *, seed: int = 0,
          tell: Callable[[int], None] | None = None) -> MarginCurves:
    """The dominant growth rate and both margins at values of a knob. `tell` is called with how many are done."""
    rows = []
    for i, value in enumerate(values):
        rows.append(_margins(make(value), seed))
        if tell is not None:
            tell(i + 1)
    growth, gain, phase = np.array(rows, dtype=float).reshape(-1, 3).T
    return MarginCurves(np.array(values, dtype=float), growth, gain, phase)


def _margins(scene: Scene, seed: int) -> tuple[float | None, float | None, float | None]:
    """Growth of the dominant mode (1/s), gain and phase margin (rad) of one scene; of several axes the worst of each.

    Of a scene that is unstable on some axes the gain margin is that of those, as in `Stability`.
    """
    if scene.axes > 1 and not couples(scene):
        every = [_margins(single, seed) for single, _ in alike(scene)]
        shaky = [each for each in every if each[0] is not None and each[0] > 0.0] or every
        return (max((a for a, _, _ in every if a is not None), default=None),
                min((b for _, b, _ in shaky if b is not None), default=None),
                None if len(shaky) < len(every) else min((c for _, _, c in every if c is not None), default=None))
    linear = linear_loop(scene, seed)
    if scene.slave is None:
        margin = gain_and_mode(scene, linear)
        mode, gain, unstable = margin.mode, margin.gain_margin, margin.unstable
    else:
        from teleop.analysis.models.margins import gain_margin, integrators

        assert linear is not None
        mode, gain = dominant(linear, integrators(linear)), gain_margin(linear)
        unstable = sampled_loop(linear).outside(linear.round_trip)
    phase = None if linear is None or unstable else _phase_margin(linear)[0]
    return mode and mode.growth, gain, phase


def numbers(drawn: Picture) -> dict[str, Any]:
    """The keys of the JSON document on a picture."""
    loop = drawn.loop
    return {
        "roots": {"drawn": len(drawn.roots.z), "total": drawn.roots.total, "complete": drawn.roots.complete},
        "open_loop": loop and {
            "phase_margin": WithUnit(loop.phase_margin, "rad"), "gain_crossover": WithUnit(loop.gain_crossover, "Hz"),
            "phase_crossover": WithUnit(loop.phase_crossover, "Hz"),
        },
    }


def curves(drawn: Picture, swept: MarginCurves | None) -> dict[str, Any]:
    """The arrays: `roots` z, `frequency` and `L` of the open loop, and of a knob `swept_values` and what is over it."""
    arrays: dict[str, Any] = {"roots": drawn.roots.z}
    if drawn.loop is not None:
        arrays |= {"frequency": drawn.loop.frequency, "L": drawn.loop.L}
    return arrays if swept is None else arrays | {f"swept_{name}": each for name, each in swept._asdict().items()}


def draw(answer: StabilityAnswer, drawn: Picture, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw roots and open loop as `path` in each of `formats`; returns the files."""
    title = f"{plot.literal(titled(answer.scene))}\n{plot.literal(answer.sentence)}"
    if drawn.loop is None or not (drawn.loop.L != 0.0).any():
        why = "no open loop: the force is renewed slowly, or the law reads the force that acts on its device"
        if drawn.loop is not None:
            why = "no open loop: one of the ends sends nothing back"
        figure = plot.new_figure((7.5, 9.0), f"{title}\n{why}")
        grid = figure.add_gridspec(4, 1)
    else:
        figure = plot.new_figure((13.0, 9.0), title)
        grid = figure.add_gridspec(4, 2)
        magnitude = figure.add_subplot(grid[0, 1])
        phase = figure.add_subplot(grid[1, 1], sharex=magnitude)
        _bode(magnitude, phase, answer, drawn.loop)
        _nyquist(figure.add_subplot(grid[2:, 1]), answer, drawn.loop)
    _s_plane(figure.add_subplot(grid[:2, 0]), answer, drawn)
    _z_plane(figure.add_subplot(grid[2:, 0]), drawn)
    return plot.save(figure, path, formats)


def _legend(axes: Axes, **where: Any) -> None:
    axes.legend(fontsize=8, framealpha=0.85, edgecolor="none", **where)


def _motions(drawn: Picture) -> tuple[Any, Any]:
    """Growth (1/s) and frequency (Hz) of the roots in the upper half, the greatest first."""
    z = drawn.roots.z
    z = z[(np.abs(z) > 1e-6) & (z.imag >= -1e-12)]
    rate = np.log(z) / drawn.period
    return rate.real, np.abs(rate.imag) / (2.0 * pi)


def _marks(axes: Axes, x: Any, y: Any, z: Any, dominant: complex | None) -> None:
    """Roots at (x, y), those that grow, that rest and the dominant one marked."""
    rests = np.abs(z - 1.0) <= AT_REST
    grows = (np.abs(z) > 1.0) & ~rests
    axes.plot(x[~grows & ~rests], y[~grows & ~rests], "x", color=plot.BLUE, markersize=6, label="decays")
    if grows.any():
        axes.plot(x[grows], y[grows], "x", color=plot.FAILS, markersize=6, label="grows")
    if rests.any():
        axes.plot(x[rests], y[rests], "s", color=plot.BLACK, markersize=6, fillstyle="none", label="rests at z = 1")
    if dominant is not None:
        nearest = np.abs(z - dominant).argmin()
        axes.plot(x[nearest], y[nearest], "o", color=plot.FAILS if grows[nearest] else plot.GREEN, markersize=12,
                  fillstyle="none", markeredgewidth=1.6, label="dominant mode")


def _dominant(answer: StabilityAnswer) -> complex | None:
    mode = getattr(answer.assessment, "mode", None)
    return None if mode is None else complex(mode.z.real, abs(mode.z.imag))


def _s_plane(axes: Axes, answer: StabilityAnswer, drawn: Picture) -> None:
    growth, frequency = _motions(drawn)
    z = np.exp((growth + 2j * pi * frequency) * drawn.period)
    _marks(axes, growth, frequency, z, _dominant(answer))
    axes.axvline(0.0, color=plot.DARK, linewidth=0.8)
    order = np.sort(growth)[::-1]
    if order.size:
        left, right = order[min(NEAREST, order.size) - 1], max(order[0], 0.0)
        width = max(right - left, 1e-3 * abs(right), 1e-9)
        axes.set_xlim(left - 0.08 * width, right + 0.12 * width)
        seen = frequency[growth >= left]
        high = max(float(seen.max()), 1e-9)
        axes.set_ylim(-0.04 * high, 1.08 * high)
        slowest = abs(order[0]) if abs(order[0]) * drawn.period > 1e-6 else float(np.abs(order[1:2]).max(initial=0.0))
        if -left > WIDE * slowest > 0.0:  # the slow ones apart, the fast ones on the same page
            first = max(0.01 * high, float(frequency[growth.argmax()]))
            slow, low = (10.0 ** ceil(log10(each)) for each in (slowest, first))
            axes.set_xscale("symlog", linthresh=slow)
            axes.set_yscale("symlog", linthresh=low)
            axes.set_xlim(1.6 * left, max(1.6 * right, 0.3 * slow))
            axes.set_ylim(-0.1 * low, 2.0 * high)
        else:
            axes.locator_params(axis="x", nbins=6)
    hidden = int((growth < order[min(NEAREST, order.size) - 1]).sum()) if order.size else 0
    beyond = f", {hidden} more to the left" if hidden else ""
    axes.set_title(f"roots as motions, log z/T{beyond}", fontsize=10)
    axes.set_xlabel("growth rate (1/s)")
    axes.set_ylabel("frequency (Hz)")
    plot.grid_lines(axes)
    _legend(axes, loc="best")


def _z_plane(axes: Axes, drawn: Picture) -> None:
    around = np.exp(1j * np.linspace(0.0, 2.0 * pi, 721))
    axes.plot(around.real, around.imag, color=plot.DARK, linewidth=0.8)
    z = drawn.roots.z
    _marks(axes, z.real, z.imag, z, None)
    count, total = len(z), drawn.roots.total
    which = f"all {total}" if count == total else f"{count} of {total}, those of greatest magnitude"
    if not drawn.roots.complete:
        which = f"{count} of {total}, of greatest magnitude; between them some may be missing"
    axes.set_title(f"roots z of the sampled loop: {which}", fontsize=10)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("Re z")
    axes.set_ylabel("Im z")
    plot.grid_lines(axes)


def _describe_gain(answer: StabilityAnswer) -> str:
    gain = getattr(answer.assessment, "gain_margin", None)
    if gain is None:
        return "no gain margin"
    return f"gain margin {gain:.4g} ({20.0 * log10(gain):+.3g} dB)"


def _bode(magnitude: Axes, phase: Axes, answer: StabilityAnswer, loop: OpenLoop) -> None:
    f, size = loop.frequency, np.abs(loop.L)
    loud = size.max(axis=0) > 0.0
    for j in np.flatnonzero(loud):
        colour = COLOURS[j % len(COLOURS)]
        name = f"$|L_{j + 1}|$" if loud.sum() > 1 else "$|L|$"
        magnitude.plot(f, 20.0 * np.log10(np.maximum(size[:, j], 1e-12)), color=colour, linewidth=1.2, label=name)
        angle = np.degrees(np.unwrap(np.angle(loop.L[:, j])))
        angle -= 360.0 * np.ceil((angle[0] - 179.0) / 360.0)  # from -180 on, not 180
        phase.plot(f, angle, color=colour, linewidth=1.2)
    magnitude.axhline(0.0, color=plot.DARK, linewidth=0.8)
    phase.axhline(-180.0, color=plot.DARK, linewidth=0.8)
    if loop.gain_crossover is not None:
        words = "|L| = 1" if loop.phase_margin is None else f"phase margin {np.degrees(loop.phase_margin):.3g} deg"
        for axes in (magnitude, phase):
            axes.axvline(loop.gain_crossover, color=plot.GREEN, linestyle="--", linewidth=1.0,
                         label=f"{words}, {si(loop.gain_crossover, 'Hz')}" if axes is magnitude else None)
    gain = getattr(answer.assessment, "gain_margin", None)
    if loop.phase_crossover and gain is not None:
        for axes in (magnitude, phase):
            axes.axvline(loop.phase_crossover, color=plot.FAILS, linestyle=":", linewidth=1.2,
                         label=f"{_describe_gain(answer)}, {si(loop.phase_crossover, 'Hz')}" if axes is magnitude
                         else None)
        magnitude.plot([loop.phase_crossover] * 2, [0.0, -20.0 * log10(gain)], color=plot.FAILS, linewidth=2.0)
    else:
        magnitude.plot([], [], " ", label=_describe_gain(answer) + (" at rest" if gain == 1.0 else ""))
    top = 20.0 * log10(max(float(size.max()), 1e-9))
    magnitude.set_ylim(max(min(-40.0, top - 20.0), top - 120.0), max(top, 0.0) + 8.0)
    angles = [line.get_ydata() for line in phase.get_lines()[:int(loud.sum())]]
    low = min((float(np.min(each)) for each in angles), default=-360.0)
    high = max((float(np.max(each)) for each in angles), default=0.0)
    phase.set_ylim(max(low - 30.0, -FAR), min(high + 30.0, FAR))
    step = 90.0 if high - max(low, -FAR) < 500.0 else 180.0
    phase.set_yticks(np.arange(step * np.ceil(max(low - 30.0, -FAR) / step), min(high + 30.0, FAR) + 1.0, step))
    title = "open loop L" if low >= -FAR else "open loop L; the delay makes its phase fall on below the axis"
    magnitude.set_title(title, fontsize=10)
    magnitude.set_ylabel("magnitude (dB)")
    phase.set_ylabel("phase (deg)")
    phase.set_xlabel("frequency (Hz)")
    magnitude.tick_params(labelbottom=False)
    for axes in (magnitude, phase):
        axes.set_xscale("log")
        plot.grid_lines(axes)
    _legend(magnitude, loc="lower left")


def _nyquist(axes: Axes, answer: StabilityAnswer, loop: OpenLoop) -> None:
    """The loci of L about -1; with more turns than can be told apart, those of a loop without its delay."""
    size = np.abs(loop.L)
    heard = np.flatnonzero(size.max(axis=1) > FAINT)
    last = int(heard[-1]) + 1 if heard.size else 1
    turns = loop.delay * float(loop.frequency[last - 1])
    L = loop.L[:last]
    title = "Nyquist plot of L"
    if turns > MOST_TURNS:
        L = L * np.exp(2j * pi * loop.delay * loop.frequency[:last])[:, None]
        title = f"Nyquist plot of L without its delay, which turns it {turns:.0f} times about 0"
    for j in np.flatnonzero(size.max(axis=0) > 0.0):
        axes.plot(L[:, j].real, L[:, j].imag, color=COLOURS[j % len(COLOURS)], linewidth=1.1)
        axes.plot(L[:, j].real, -L[:, j].imag, color=COLOURS[j % len(COLOURS)], linewidth=0.6, alpha=0.5)
    around = np.exp(1j * np.linspace(0.0, 2.0 * pi, 361))
    axes.plot(around.real, around.imag, color=plot.DARK, linewidth=0.6, linestyle=":")
    axes.plot([-1.0], [0.0], "+", color=plot.FAILS, markersize=11, markeredgewidth=1.8, label="-1")
    gain = getattr(answer.assessment, "gain_margin", None)
    if gain is not None and turns <= MOST_TURNS:
        axes.plot([-1.0 / gain], [0.0], "o", color=plot.FAILS, markersize=6, label=_describe_gain(answer))
    if loop.phase_margin is not None and turns <= MOST_TURNS:
        angle = pi - loop.phase_margin
        axes.plot([np.cos(angle)] * 2, [np.sin(angle), -np.sin(angle)], "d", color=plot.GREEN, markersize=6,
                  label=f"phase margin {np.degrees(loop.phase_margin):.3g} deg")
    far = min(max(1.25, 1.15 * float(size.max())), max(3.0, 1.3 / (gain or 1.0)))
    axes.set_xlim(-far, far)
    axes.set_ylim(-far, far)
    axes.set_aspect("equal", adjustable="box")
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("Re L")
    axes.set_ylabel("Im L")
    plot.grid_lines(axes)
    _legend(axes, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)


def draw_swept(answer: StabilityAnswer, swept: MarginCurves, path: Path, formats: Sequence[str]) -> list[Path]:
    """Draw growth rate and margins over the knob as `path` in each of `formats`; returns the files."""
    edge = answer.edge
    assert edge is not None
    title = f"{plot.literal(titled(answer.scene))}: stability over {plot.literal(edge.knob)}"
    figure = plot.new_figure((9.5, 8.5), title)
    over = {"growth rate (1/s)": swept.growth, "gain margin (dB)": 20.0 * np.log10(swept.gain_margin),
            "phase margin (deg)": np.degrees(swept.phase_margin)}
    over = {label: each for label, each in over.items() if np.isfinite(each).any()}  # none: see `MarginCurves`
    panels = figure.subplots(len(over), 1, sharex=True, squeeze=False)[:, 0]
    values, growth, last = swept.values, panels[0], panels[-1]
    for axes, (label, each) in zip(panels, over.items(), strict=True):
        axes.plot(values, each, color=plot.BLUE, marker=".", label="dominant mode" if axes is growth else None)
        axes.set_ylabel(label)
    growth.fill_between(values, 0.0, swept.growth, where=list(swept.growth > 0.0), color=plot.FAILS, alpha=0.15,
                        interpolate=True, linewidth=0.0, label="grows")
    scene_value, unit = own_value(answer.scene, edge.knob), answer.unit
    for axes in panels:
        axes.axhline(0.0, color=plot.DARK, linewidth=0.8)
        for i, one in enumerate(edge.all):
            axes.axvline(one.value, color=plot.FAILS, linestyle="--", linewidth=1.1,
                         label=f"critical: {', '.join(f'{each.value:.5g}' for each in edge.all)}{unit}"
                         if i == 0 and axes is growth else None)
        if values[0] <= scene_value <= values[-1]:
            axes.axvline(scene_value, color=plot.GREY, linestyle=":", linewidth=1.1,
                         label=f"the scene's own: {scene_value:.5g}{unit}" if axes is growth else None)
        plot.grid_lines(axes)
    if values[0] > 0.0 and values[-1] > 10.0 * values[0]:
        last.set_xscale("log")
    low, high = float(np.nanmin(swept.growth)), float(np.nanmax(swept.growth))
    if low < -20.0 * max(high, 1e-9) or high > 20.0 * max(-low, 1e-9):
        growth.set_yscale("symlog", linthresh=max(min(abs(low), abs(high)), 1e-2 * max(abs(low), abs(high))))
    last.set_xlabel(plot.literal(f"{edge.knob}{f' ({unit.strip()})' if unit else ''}"))
    _legend(growth, loc="best")
    return plot.save(figure, path, formats)


def find(args: Namespace) -> Task:
    """Judge the scene and find its margins.

    An interrupt of the search for a critical value, or of the margins over its knob, leaves what is known until then.
    Raises `Refused`, and the task KeyboardInterrupt before the search.
    """
    formats = plot.asked_formats(args)
    if formats and args.time:
        raise Refused("a plot shows the roots and the open loop, which a run in virtual time does not have; leave "
                      f"--plot out, or see the motion itself: teleop run {args.scene} --plot")
    knobs = knobs_from(args)
    scene = load_scene(args.scene, **knobs)

    def work() -> Answer:
        with shown_for(args) as show:
            judged = ask(args.scene, knobs, seed=args.seed, in_time=args.time, continuous=args.continuous,
                        knob=args.critical, span=args.range, tol=args.tol, show=show)
        return _with_plots(args, judged) if formats else _answer(args, judged)

    return Task(scene.name, work)


def _answer(args: Namespace, judged: StabilityAnswer, drawn: Mapping[str, Any] | None = None) -> Answer:
    return Answer(table(judged), summary(judged, args.typed, drawn), DONE if judged.finished else INTERRUPTED)


def _with_plots(args: Namespace, judged: StabilityAnswer) -> Answer:
    """The answer with its plots and the numbers behind them."""
    swept = None
    if judged.edge is not None:
        knobs, knob, values = knobs_from(args), judged.edge.knob, judged.places
        try:
            with shown_for(args) as show:
                swept = sweep(lambda value: load_scene(args.scene, **{**knobs, knob: value}), values, seed=args.seed,
                              tell=lambda done: show(done / len(values), f"margins over {knob}"))
        except KeyboardInterrupt:
            judged = judged._replace(cut_short=True)
    stability = judged.assessment
    assert isinstance(stability, Stability)  # `find` refuses the other
    with interrupts_wait():
        drawn = picture(judged.scene, unstable=stability.unstable > 0, gain_margin=stability.gain_margin,
                        seed=args.seed)
    plots = {"stability": partial(draw, judged, drawn)}
    if swept is not None:
        plots["critical"] = partial(draw_swept, judged, swept)
    return _answer(args, judged, numbers(drawn))._replace(
        files={"curves.npz": partial(write_npz, arrays=curves(drawn, swept))}, plots=plots)


command = command_of(find, "stability", always=False)
