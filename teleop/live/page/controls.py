"""Controls of the page: the scene's law, link and stiffness, the switches between them, the drag and the clutch."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from teleop.errors import Refused, nearest, number
from teleop.law import find_law, known_laws, law_name
from teleop.live.page.rows import RecordTail
from teleop.scene.knobs import knobs_of
from teleop.scene.library import import_bundled, scene_function
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.notes import untuned
from teleop.simulation.result import law_with_gains, parameters
from teleop.stages.slave_units import places_of_slave

OPEN_ENDED = "86400"  # s; a page goes on until Ctrl-C
LOOKED_AT = 10.0  # s of the scene's own motion, for the span that is shown
LEAST_SPAN = 0.06  # m
HIGHEST = {"delay": 0.5, "jitter": 0.2, "loss": 0.5}  # s, s, share
SWUNG = 0.15  # of the span that is shown, by which the hand swings where nobody moves it ...
SCALES = (0.25, 4.0)  # of the slave's motion, set while it runs
FREE = 0.6  # ... but no more than this share of the way to the wall
GROUPS = ("Passive over any link", "Passive with enough damping", "No claim over a delay")
DAMPED = ("wave_position", "p_d", "pd_d", "pp")  # of the second group; the first claims a ledger over any link
LABELS = {"delay": ("delay each way", "s"), "jitter": ("jitter, at most", "s"), "loss": ("loss", ""),
          "k_e": ("stiffness", "N/m"), "scale": ("scale of the slave\u2019s motion", "")}


class LinkSettings(NamedTuple):
    """Link in three numbers: s, s, share."""

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    @property
    def text(self) -> str:
        """The text for `--link`, without the effects that are 0.

        >>> LinkSettings(0.05, 0.02).text, LinkSettings().text
        ('delay(0.05) | uniform(0.02)', 'delay(0.0)')
        """
        parts = [f"{effect}({value!r})" for effect, value in zip(("delay", "uniform", "bernoulli"), self, strict=True)
                 if value > 0.0]
        return " | ".join(parts) or "delay(0.0)"

    @property
    def words(self) -> str:
        """The link in words.

        >>> LinkSettings(0.15).words, LinkSettings(0.05, 0.02, 0.01).words
        ('150 ms each way', '50 ms each way, up to 20 ms of jitter, 1 % of the packets dropped')
        """
        jitter, loss = f"up to {1e3 * self.jitter:g} ms of jitter", f"{100 * self.loss:g} % of the packets dropped"
        return ", ".join([f"{1e3 * self.delay:g} ms each way", *[jitter] * (self.jitter > 0.0),
                          *[loss] * (self.loss > 0.0)])


class HandSwing(NamedTuple):
    """Motion of the hand before anybody moves it: about a position by these amplitudes, m or rad per axis."""

    about: tuple[float, ...]
    by: tuple[float, ...]


class Choice(NamedTuple):
    """Settings chosen on the page; None: the setting with which the scene was started."""

    law: str | None = None
    link: LinkSettings | None = None
    k_e: float | None = None


class Slider(NamedTuple):
    """Slider of the page. `low` and `high` are its ends; `log`: its scale; `running`: it moves without a switch."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    value: float
    log: bool
    running: bool = False


class Controls:
    """Controls of the scene `name`, which take the place of its typed knobs where a page has touched them.

    `robot`: a MuJoCo model in place of the simulated slave, which brings what it touches with it. Raises `Refused` for
    a scene that cannot be shown.
    """

    def __init__(self, name: str, knobs: Mapping[str, str], robot: str | None = None) -> None:
        self.name, self._robot = name, robot
        self._declared = knobs_of(scene_function(name))
        if "duration" in knobs:
            raise Refused("a page goes on until Ctrl-C, so duration sets nothing; leave it out")
        if "duration" not in self._declared:
            raise Refused(f"a page goes on until Ctrl-C, and scene {name} has no knob duration to be made so long by; "
                          "give its function the parameter `duration: knob.Duration = 10.0`")
        self._typed = {**knobs, "duration": OPEN_ENDED}
        self._short = load_scene(name, **{**knobs, "duration": repr(LOOKED_AT)})
        self.scale = 1.0  # of the slave's motion, as a page has set it
        if self._short.operator is None and self._short.slave is not None and "clutch_ramp" not in knobs:
            self._typed["clutch_ramp"] = "0.05"  # between the handle and its law, where the scale is
        self.first = self.scene(Choice())

    def knobs(self, choice: Choice) -> dict[str, str]:
        """Write all knobs of the scene of this choice as texts. Raises `Refused`."""
        knobs = dict(self._typed)
        if choice.law is not None:  # with its defaults: the gains of another law do not fit
            knobs = {key: value for key, value in knobs.items() if key != "law" and not key.startswith("law.")}
            knobs["law"] = choice.law
        if choice.link is not None:
            knobs = {key: value for key, value in knobs.items()
                     if key not in self._declared or not self._declared[key].knob.link}
            knobs["link"] = choice.link.text
        if choice.k_e is not None:
            knobs["k_e"] = repr(choice.k_e)
        return live_knobs(self.name, knobs)

    def scene(self, choice: Choice) -> Scene:
        """Load the scene of this choice. Raises `Refused`."""
        return both_ends(load_scene(self.name, **self.knobs(choice)))

    def chosen(self, choice: Choice, message: Mapping[str, Any]) -> Choice:
        """Apply a page's message to a choice. Raises `Refused` for a law or a number that is not offered."""
        sliders = {slider.name: slider for slider in self.sliders(choice)}
        values = {}
        for key, value in message.items():
            if key in LABELS and key != "scale":
                if key not in sliders:
                    raise Refused(f"scene {self.name} has no knob {key}; {', '.join(sliders)} can be changed")
                values[key] = number(key, value, low=sliders[key].low, high=sliders[key].high, unit=sliders[key].unit)
        if "law" in message:
            law, offered = message["law"], [each["name"] for each in self.laws]
            if law not in offered:  # never a file: what a page names is not run
                raise Refused(f"scene {self.name} has no law {law[:40]!r} to switch to; {nearest(law, offered)}")
            choice = choice._replace(law=None if law == law_name(self.first.laws[0]) else law)
        if "k_e" in values:
            choice = choice._replace(k_e=values.pop("k_e"))
        if values:
            choice = choice._replace(link=self.link(choice)._replace(**values))
        return choice

    def link(self, choice: Choice) -> LinkSettings:
        """The link of a choice in three numbers: of the scene's own the forward ones, as far as it has them."""
        if choice.link is not None:
            return choice.link
        link: Any = self.first.link
        effects = {} if link is None else {type(each).__name__: each for each in link.in_direction(0)}
        return LinkSettings(*[getattr(effects.get(kind), field, 0.0) for kind, field in
                              (("Delay", "delay"), ("UniformJitter", "width"), ("Bernoulli", "p"))])

    def sliders(self, choice: Choice) -> list[Slider]:
        """The sliders of the scene, at their values in this choice."""
        first = self.link(Choice())
        sliders = [Slider(name, *LABELS[name], 0.0, max(HIGHEST[name], getattr(first, name)),
                          getattr(self.link(choice), name), False) for name in HIGHEST]
        k_e = self.first.knobs.get("k_e")
        if isinstance(k_e, float) and k_e > 0.0 and self._robot is None:
            label, unit = LABELS["k_e"][0], self._declared["k_e"].knob.unit
            sliders.append(Slider("k_e", label, unit, k_e / 100.0, k_e * 10.0, choice.k_e or k_e, True))
        if self.first.operator is not None:
            sliders.append(Slider("scale", *LABELS["scale"], *SCALES, self.scale, True, running=True))
        return sliders

    def set_scale(self, to: float) -> float:
        """Set the scale of the slave's motion. Raises `Refused` for one that is not offered."""
        if self.first.operator is None:
            raise Refused(f"scene {self.name} has no operator's clutch, in which a scale is set; give it a time, for "
                          "example --set clutch_ramp=0.05")
        self.scale = number("scale", to, low=SCALES[0], high=SCALES[1])
        return self.scale

    @cached_property
    def laws(self) -> list[dict[str, str]]:
        """Name and sentence of each law that this scene can have; a law of its own, without a known name, is first."""
        from teleop.scene.catalogue import names

        sentences, laws = names()["laws"], []
        first = law_name(self.first.laws[0])
        for name in [*([first] if first not in sentences else []), *sorted(known_laws())]:
            try:
                if name != first:
                    self.scene(Choice(law=name))
            except Refused:  # a one-port law, or one that asks for more than the scene has
                continue
            laws.append({"name": name, "says": sentences.get(name, "the scene's own"), "group": _group(name)})
        return sorted(laws, key=lambda law: (GROUPS.index(law["group"]), law["name"]))

    def words(self, choice: Choice, scene: Scene) -> str:
        """The choice in words: law, link, and a stiffness that was set."""
        link: Any = scene.link
        effects = () if link is None else (*link.in_direction(0), *link.in_direction(1))
        three = {type(each).__name__ for each in effects} <= {"Delay", "UniformJitter", "Bernoulli"}
        describe = import_bundled("channel.link").describe
        stiffness = [] if choice.k_e is None else [f"stiffness {choice.k_e:g} {self._declared['k_e'].knob.unit}"]
        return ", ".join([law_name(scene.laws[0]), self.link(choice).words if three else describe(link), *stiffness])

    def hello(self, choice: Choice, scene: Scene) -> dict[str, Any]:
        """Message that describes the scene of a choice to the page."""
        describe = import_bundled("channel.link").describe
        return {
            "type": "hello", "scene": self.name, "dt": scene.dt, "laws": self.laws,
            "law": law_name(scene.laws[0]), "gains": law_with_gains(parameters(scene)["law"]),
            "notes": untuned(scene), "sliders": [slider._asdict() for slider in self.sliders(choice)],
            "f_max": most_forces(scene)[0], **self.stage(scene), **self._axes(scene),
            "link": "no link" if scene.link is None else describe(scene.link), "words": self.words(choice, scene),
            "energy": None if not scene.energy else "link" if scene.has_waves else "ports",
        }

    def stage(self, scene: Scene) -> dict[str, Any]:
        """Describe what is seen before anything moves: axes, the first one's wall, and the span to show."""
        return {"axes": scene.axes, "wall": self._walls(scene)[0], "span": max(self.spans)}

    @cached_property
    def _paths(self) -> Sequence[Sequence[float]]:
        """The scene's own motion of the hand, m or rad per axis; empty without one."""
        reference: Any = self._short.reference
        paths: Sequence[Sequence[float]] = () if reference is None else reference.samples(
            self._short.axes, self._short.ticks, self._short.dt_ns)
        return paths

    @cached_property
    def spans(self) -> list[float]:
        """Span of each axis to show, m or rad: its wall, its own motion, and room beside them."""
        most = [max(map(abs, path)) for path in self._paths] or [0.0] * self._short.axes
        return [float(f"{2.5 * max(LEAST_SPAN / 2.5, abs(wall or 0.0), far):.2g}")
                for far, wall in zip(most, self._walls(self._short), strict=True)]

    @property
    def swing(self) -> HandSwing | None:
        """Swing of the hand by which the slave stays in free space at the scale that is set; None: the scene's own."""
        swing, scale = self._swing, max(1.0, self.scale)
        return None if swing is None else swing._replace(by=tuple([each / scale for each in swing.by]))

    @cached_property
    def _swing(self) -> HandSwing | None:
        """Swing of the hand in free space, where the scene's own motion comes to rest; None where it goes on."""
        last = round(1.0 / self._short.dt)  # the ticks of the last second
        if any(min(path[-last:]) != max(path[-last:]) for path in self._paths):
            return None
        about = tuple([path[0] for path in self._paths]) or (0.0,) * self._short.axes
        walls = self._walls(self._short)
        return HandSwing(about, tuple([
            min(SWUNG * span, span if wall is None else FREE * abs(wall - at)) / (1 + i % 2)
            for i, (at, wall, span) in enumerate(zip(about, walls, self.spans, strict=True))]))

    def _walls(self, scene: Scene) -> list[float | None]:
        """Walls of the axes, m; None: no surface. Of a robot's models only the bundled one has those of its scene."""
        return [_wall(scene, i) if self._robot in (None, "mujoco") else None for i in range(scene.axes)]

    def _axes(self, scene: Scene) -> dict[str, Any]:
        """Names, units, walls, caps and spans of several axes, or of one that turns; nothing of one along a line."""
        if scene.axes == 1 and not scene.units:
            return {}
        return {"names": scene.axis_names, "units": scene.axis_units, "caps": most_forces(scene), "spans": self.spans,
                "walls": self._walls(scene)}


def _group(name: str) -> str:
    """The group of a law, which says what holds over a delay."""
    law = find_law(name) if name in known_laws() else None
    if "any link" in getattr(law, "claims", {}).values():
        return GROUPS[0]
    return GROUPS[1 if name in DAMPED else 2]


def most_forces(scene: Scene) -> list[float | None]:
    """The force cap of each axis, in its unit; None: there is none."""
    return [getattr(cap, "f_max", None) for cap in scene.per_axis("cap")]


def _wall(scene: Scene, i: int) -> float | None:
    """Position of the surface that the slave meets on an axis, m; None: no surface, or one on both sides."""
    environment: Any = scene.environments[i] if scene.environments else None
    still = getattr(environment, "environment", environment)
    return float(still.at) if hasattr(still, "side") else None


REST = 0.2  # s between two switches
PATIENCE = 8.0  # s for all to answer: a hand that is aligned takes its time
PROCESSES = frozenset({"channel", "slave", "master"})


class SwitchRequest(NamedTuple):
    """Order to the three processes to go on with another choice. `again`: from the scene's start."""

    choice: Choice
    again: bool


class SwitchQueue:
    """Queue of switches: one at a time, and of those asked for meanwhile the newest. Times are in s.

    Both ends answer a switch with `turned`, the channel too; 0.2 s after all have, the next may go. Without an answer,
    or with a refusal, the three can no longer be known to agree, and are started anew. `choice`: the settings that the
    three run with, or will when they have answered.
    """

    def __init__(self, choice: Choice) -> None:
        self.choice = choice
        self.under_way: SwitchRequest | None = None
        self._before = choice  # their choice before the switch that is under way
        self._waiting: SwitchRequest | None = None
        self._answers: set[str] = set()
        self._since = float("-inf")  # time at which the switch began, or was over

    @property
    def wanted(self) -> Choice:
        """The newest choice that was requested."""
        return self.choice if self._waiting is None else self._waiting.choice

    def ask(self, choice: Choice, *, again: bool = False, align: bool = False) -> None:
        """Request a switch; a restart that waits already is kept with a later request.

        `align`: switch even to the same choice, so that the master is brought to the slave.
        """
        again = again or (self._waiting is not None and self._waiting.again)
        self._waiting = SwitchRequest(choice, again) if again or align or choice != self.choice else None

    def next(self, now: float) -> SwitchRequest | None:
        """Return the switch to order now, if there is one; it is under way from then on."""
        if self.under_way is not None or self._waiting is None or now - self._since < REST:
            return None
        self.under_way, self._waiting = self._waiting, None
        self._before, self.choice = self.choice, self.under_way.choice
        self._answers, self._since = set(), now
        return self.under_way

    def take_answer(self, name: str, now: float) -> SwitchRequest | None:
        """Note that a process has switched; return the switch if it was the last of the three."""
        self._answers.add(name)
        if self.under_way is None or not self._answers >= PROCESSES:
            return None
        done, self.under_way, self._since = self.under_way, None, now
        return done

    def late(self, now: float) -> bool:
        """True if a switch has been under way for too long."""
        return self.under_way is not None and now - self._since > PATIENCE

    def give_up(self) -> None:
        """Drop the switch under way, which has failed, and go back to the choice before it."""
        self.under_way, self.choice = None, self._before

    def restart(self, now: float) -> None:
        """Begin anew with the newest choice, as all three processes do."""
        self.choice, self._waiting, self.under_way, self._since = self.wanted, None, None, now


HOLDS = 1.0  # s

Position = tuple[float, ...]  # m, per axis


class _Pointer(NamedTuple):
    to: Position
    moved: float  # time at which it came to another position, s
    heard: float  # time of its page's last message, s


class Drag:
    """Pointers of all pages that drag, by their page: the hand follows the one that moved last.

    A page that drags repeats its pointer every quarter of a second, though it is still. A page that is silent for
    `HOLDS`, having vanished or been put behind other windows, has let go: until then the hand stays where it was.
    """

    def __init__(self) -> None:
        self._pointers: dict[Hashable, _Pointer] = {}

    def move(self, page: Hashable, to: Position, now: float) -> None:
        """Note that the pointer of `page` is at `to`, at the time `now` (s)."""
        before = self._pointers.get(page)
        same = before is not None and before.to == to
        self._pointers[page] = _Pointer(to, before.moved if before is not None and same else now, now)

    def let_go(self, page: Hashable) -> None:
        """Forget the pointer of `page`, which is up."""
        self._pointers.pop(page, None)

    def target(self, now: float) -> Position | None:
        """Target of the hand; None: nobody drags."""
        for page, pointer in list(self._pointers.items()):
            if now - pointer.heard > HOLDS:
                del self._pointers[page]
        newest = max(self._pointers.values(), key=lambda pointer: pointer.moved, default=None)
        return None if newest is None else newest.to


class Clutch:
    """Clutch of all pages, and the distance between master and slave that it leaves.

    While it is open the two ends have no session, and the hand moves the master alone. When it closes, a new session
    counts the positions from where each end is: from then on the master is by an offset beside the slave. A switch
    keeps that offset: the master is brought beside the slave before the next session. `is_open`: as last ordered.
    """

    def __init__(self, scene: Scene) -> None:
        self.is_open = False
        self._scene = scene
        self._held: set[Hashable] = set()
        self._offset = (0.0,) * scene.axes  # m, of the master
        self._switching = False  # the next session begins after a switch, which keeps the offset
        self._begins: float | None = None  # first tick of a session whose offset is not known yet
        self._moved = False  # has the operator's transformer moved the law's position beside the handle's

    def hold(self, page: Hashable, *, held: bool) -> None:
        """Note that a page holds it, or lets it go; it is open while any page holds it."""
        if held:
            self._held.add(page)
        else:
            self._held.discard(page)

    def update(self) -> bool:
        """Update `is_open`; True if it has changed, so that the ends need an order."""
        changed = self.is_open != bool(self._held)
        self.is_open = bool(self._held)
        return changed

    def expect_switch(self, *, again: bool) -> None:
        """Keep the offset over the switch that was ordered, unless it goes back to the scene's start (`again`)."""
        self._switching = not again

    def begin_session(self, k: float) -> None:
        """Note that the master has begun a session at tick k."""
        self._begins, self._switching = None if self._switching and not self._moved else k, False

    def measure(self, tails: Mapping[str, RecordTail]) -> None:
        """Measure the offset as soon as the records have come to the begin of the session."""
        begins = self._begins
        if begins is None or any(not tail.newest or tail.newest[-1][0] < begins for tail in tails.values()):
            return
        positions = self._positions(tails, begins)
        self._begins = None
        if positions is not None:
            self._offset = tuple(a - b for a, b in zip(*positions, strict=True))

    def aligned_position(self, tails: Mapping[str, RecordTail]) -> list[float] | None:
        """Position of the master (m, per axis) at which the hand feels the slave's contact; None: not known."""
        positions = self._positions(tails, float("inf"))
        if positions is None:
            return None
        wanted = [x + offset for x, offset in zip(positions[1], self._offset, strict=True)]
        row, columns = tails["m"].newest[-1], tails["m"].slices
        self._moved = "offset_m" in columns and any(row[columns["offset_m"]])
        if self._moved and (scale := row[columns["scale_m"]][0]) > 0.0:  # of the handle's way, for that of the law
            wanted = [x + (to - (x - beside)) / scale for to, x, beside in
                      zip(wanted, positions[0], row[columns["offset_m"]], strict=True)]
        return wanted

    def _positions(self, tails: Mapping[str, RecordTail], k: float) -> tuple[Position, Position] | None:
        """Positions of master and slave at tick k, in the master's metres."""
        positions = []
        for e in ("m", "s"):
            row = tails[e].at(k) if e in tails else None
            if row is None:
                return None
            places = row[tails[e].slices[f"x_{e}"]]
            positions.append(tuple(places if e == "m" else places_of_slave(self._scene, places)))
        return positions[0], positions[1]
