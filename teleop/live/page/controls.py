"""What can be turned on the page: the law, the link by three numbers, the stiffness of what the slave touches.

A turn is a choice in place of what the scene was started with; what was not touched stays as it was typed.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

from teleop.errors import Refused, nearest, number
from teleop.law import known_laws, law_name
from teleop.scene.knobs import knobs_of
from teleop.scene.library import import_bundled, scene_function
from teleop.scene.loading import live_knobs, load_scene
from teleop.scene.scene import Scene, both_ends
from teleop.simulation.notes import untuned
from teleop.simulation.result import law_with_gains, parameters

OPEN_ENDED = "86400"  # s; a page goes on until Ctrl-C
LOOKED_AT = 10.0  # s of the scene's own motion, for the span that is shown
LEAST_SPAN = 0.06  # m
HIGHEST = {"delay": 0.5, "jitter": 0.2, "loss": 0.5}  # s, s, share
LABELS = {"delay": ("delay each way", "s"), "jitter": ("jitter, at most", "s"), "loss": ("loss", ""),
          "k_e": ("stiffness", "N/m")}


class Link(NamedTuple):
    """A link in three numbers: s, s, share."""

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    @property
    def text(self) -> str:
        """As `--link` takes it, without what is 0.

        >>> Link(0.05, 0.02).text, Link().text
        ('delay(0.05) | uniform(0.02)', 'delay(0.0)')
        """
        parts = [f"{effect}({value!r})" for effect, value in zip(("delay", "uniform", "bernoulli"), self, strict=True)
                 if value > 0.0]
        return " | ".join(parts) or "delay(0.0)"


class Choice(NamedTuple):
    """What was chosen on the page; None: what the scene was started with."""

    law: str | None = None
    link: Link | None = None
    k_e: float | None = None


class Slider(NamedTuple):
    """One that the page shows. `low` and `high` are its ends; `log`: its scale."""

    name: str
    label: str
    unit: str
    low: float
    high: float
    value: float
    log: bool


class Controls:
    """Those of the scene `name` with the knobs that were typed. Raises `Refused` for a scene that cannot be shown."""

    def __init__(self, name: str, knobs: Mapping[str, str]) -> None:
        self.name = name
        self._declared = knobs_of(scene_function(name))
        if "duration" in knobs:
            raise Refused("a page goes on until Ctrl-C, so duration sets nothing; leave it out")
        if "duration" not in self._declared:
            raise Refused(f"a page goes on until Ctrl-C, and scene {name} has no knob duration to be made so long by; "
                          "give its function the parameter `duration: knob.Duration = 10.0`")
        self._typed = {**knobs, "duration": OPEN_ENDED}
        self._short = load_scene(name, **{**knobs, "duration": repr(LOOKED_AT)})
        self.first = self.scene(Choice())

    def knobs(self, choice: Choice) -> dict[str, str]:
        """All knobs of the scene of this choice, as texts. Raises `Refused`."""
        knobs = dict(self._typed)
        if choice.law is not None:  # with its own numbers: those of another law are none of its
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
        """The scene of this choice. Raises `Refused`."""
        return both_ends(load_scene(self.name, **self.knobs(choice)))

    def chosen(self, choice: Choice, message: Mapping[str, Any]) -> Choice:
        """The choice with what a page asks for besides. Raises `Refused` for a law or a number that is not offered."""
        sliders = {slider.name: slider for slider in self.sliders(choice)}
        values = {}
        for key, value in message.items():
            if key in LABELS:
                if key not in sliders:
                    raise Refused(f"scene {self.name} has no knob {key}; {', '.join(sliders)} can be turned")
                values[key] = number(key, value, low=sliders[key].low, high=sliders[key].high, unit=sliders[key].unit)
        if "law" in message:
            law, offered = message["law"], [each["name"] for each in self.laws]
            if law not in offered:  # never a file: what a page names is not run
                raise Refused(f"scene {self.name} has no law {law[:40]!r} to be turned to; {nearest(law, offered)}")
            choice = choice._replace(law=None if law == law_name(self.first.laws[0]) else law)
        if "k_e" in values:
            choice = choice._replace(k_e=values.pop("k_e"))
        if values:
            choice = choice._replace(link=self.link(choice)._replace(**values))
        return choice

    def link(self, choice: Choice) -> Link:
        """The link of a choice in three numbers: of the scene's own, as far as it has them, those forward."""
        if choice.link is not None:
            return choice.link
        own: Any = self.first.link
        effects = {} if own is None else {type(each).__name__: each for each in own.in_direction(0)}
        found = [getattr(effects.get(kind), field, 0.0) for kind, field in
                 (("Delay", "delay"), ("UniformJitter", "width"), ("Bernoulli", "p"))]
        return Link(*found)

    def sliders(self, choice: Choice) -> list[Slider]:
        """What can be turned, at its values in this choice."""
        own = self.link(Choice())
        found = [Slider(name, *LABELS[name], 0.0, max(HIGHEST[name], getattr(own, name)),
                        getattr(self.link(choice), name), False) for name in HIGHEST]
        k_e = self.first.knobs.get("k_e")
        if isinstance(k_e, float) and k_e > 0.0:
            label, unit = LABELS["k_e"][0], self._declared["k_e"].knob.unit
            found.append(Slider("k_e", label, unit, k_e / 100.0, k_e * 10.0, choice.k_e or k_e, True))
        return found

    @cached_property
    def laws(self) -> list[dict[str, str]]:
        """The laws that this scene can have, its own first where it has no name among them: name and sentence."""
        from teleop.scene.catalogue import names

        said, found = names()["laws"], []
        own = law_name(self.first.laws[0])
        for name in [*([own] if own not in said else []), *sorted(known_laws())]:
            try:
                if name != own:
                    self.scene(Choice(law=name))
            except Refused:  # a one-port law, or one that asks for more than the scene has
                continue
            found.append({"name": name, "says": said.get(name, "the scene's own")})
        return found

    def hello(self, choice: Choice, scene: Scene) -> dict[str, Any]:
        """What the page has to know of the scene of a choice."""
        describe = import_bundled("channel.link").describe
        return {
            "type": "hello", "scene": self.name, "axes": scene.axes, "dt": scene.dt, "laws": self.laws,
            "law": law_name(scene.laws[0]), "gains": law_with_gains(parameters(scene)["law"]),
            "notes": untuned(scene), "sliders": [slider._asdict() for slider in self.sliders(choice)],
            "wall": _wall(scene), "f_max": most_forces(scene)[0],
            "span": max(self.spans), **self._axes(scene),
            "link": "no link" if scene.link is None else describe(scene.link),
            "energy": None if not scene.energy else "link" if scene.has_waves else "ports",
        }

    @cached_property
    def spans(self) -> list[float]:
        """How much of each axis is worth showing, m or rad: its wall, its own motion, and room beside them."""
        scene = self._short
        reference: Any = scene.reference
        paths = () if reference is None else reference.samples(scene.axes, scene.ticks, scene.dt_ns)
        most = [max(map(abs, path)) for path in paths] or [0.0] * scene.axes
        return [float(f"{2.5 * max(LEAST_SPAN / 2.5, abs(_wall(scene, i) or 0.0), far):.2g}")
                for i, far in enumerate(most)]

    def _axes(self, scene: Scene) -> dict[str, Any]:
        """Names, units, walls, caps and spans of several axes, or of one that turns; nothing of one along a line."""
        if scene.axes == 1 and not scene.units:
            return {}
        return {"names": scene.axis_names, "units": scene.axis_units, "caps": most_forces(scene), "spans": self.spans,
                "walls": [_wall(scene, i) for i in range(scene.axes)]}


def most_forces(scene: Scene) -> list[float | None]:
    """The force cap of each axis, in its unit; None: there is none."""
    return [getattr(cap, "f_max", None) for cap in scene.per_axis("cap")]


def _wall(scene: Scene, i: int = 0) -> float | None:
    """Where the surface is that the slave meets on an axis, m; None: there is none, or one on both sides."""
    environment: Any = scene.environments[i] if scene.environments else None
    still = getattr(environment, "environment", environment)
    return float(still.at) if hasattr(still, "side") else None
