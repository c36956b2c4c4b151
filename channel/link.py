"""Links as text and as objects: `delay(0.05) | bernoulli(p=0.02)`; forward and backward parted by `;`.

    link = parse_link("delay(0.05) | gamma(mean=0.01, shape=2) ; delay(0.2)")
    link.arrivals(0, count=10_000, dt_ns=1_000_000, seed=1, size=100)

An effect alone, a chain, and a `Link` of two different directions all answer `arrivals` and `stream`. Effects
are loaded when a text names them.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any

from channel.effect import Chain, Effect
from channel.schedule import Arrivals, Stream, arrivals
from teleop.errors import Refused
from teleop.plugins import find, known

EFFECTS = {
    "bernoulli": "channel.bernoulli:Bernoulli",
    "blackout": "channel.blackout:Blackout",
    "delay": "channel.delay:Delay",
    "duplicate": "channel.duplicate:Duplicate",
    "gamma": "channel.gamma:GammaJitter",
    "gilbert_elliott": "channel.gilbert_elliott:GilbertElliott",
    "in_order": "channel.in_order:InOrder",
    "mahimahi": "channel.mahimahi:Mahimahi",
    "normal": "channel.normal:NormalJitter",
    "ping_log": "channel.ping_log:PingLog",
    "uniform": "channel.uniform:UniformJitter",
}
"""What a text may name, and where it is."""

EXAMPLES = {
    "bernoulli": "bernoulli(0.02)",
    "blackout": "blackout(4.0, 1.0, every=10.0)",
    "delay": "delay(0.05)",
    "duplicate": "duplicate(0.01, after=0.005)",
    "gamma": "gamma(0.01, 2.0)",
    "gilbert_elliott": "gilbert_elliott(0.005, 0.05, loss_good=0.0, loss_bad=1.0)",
    "in_order": "in_order()",
    "mahimahi": "mahimahi('up.txt', queue=2000, start=0.0)",
    "normal": "normal(0.01, 0.002)",
    "ping_log": "ping_log('ping.txt', start=0.0)",
    "uniform": "uniform(0.02)",
}
"""How each is written, with all of its knobs."""

GROUP = "teleop.effects"  # of entry points
_LONGEST = 10_000  # characters of a text
_FORM = 'write for example "delay(0.05) | bernoulli(p=0.02)", or "FORWARD ; BACKWARD"'


@dataclass(frozen=True, slots=True)
class Link:
    """Different ways there and back: forward from master to slave, backward from slave to master."""

    forward: Effect | Chain
    backward: Effect | Chain

    def __post_init__(self) -> None:
        for name in ("forward", "backward"):
            if not isinstance(getattr(self, name), Effect | Chain):
                raise Refused(f"{name} must be an effect or a chain of them, not {getattr(self, name)!r}; "
                              f"write {name}=Delay(0.0) for a way that does nothing")

    def way(self, direction: int) -> tuple[Effect, ...]:
        """The effects a packet passes in this direction (0 forward, 1 backward)."""
        return (self.backward if direction else self.forward).way(direction)

    def arrivals(self, direction: int, count: int, dt_ns: int, seed: int, size: int) -> Arrivals:
        """What arrives when packets 0..count-1 are sent at k*dt_ns: see `channel.schedule.arrivals`."""
        return arrivals(self, direction, count, dt_ns, seed, size)

    def stream(self, direction: int, seed: int, size: int) -> Stream:
        """The same packet by packet: see `channel.schedule.Stream`."""
        return Stream(self, direction, seed, size)


def known_effects() -> dict[str, str]:
    """Every effect that can be named: `name -> "module:class"`, built in and from plug-ins, none imported."""
    return known(GROUP, EFFECTS)


def parse_link(text: str) -> Effect | Chain | Link:
    """The link a text describes. Raises `Refused` for what it cannot mean.

    >>> parse_link("delay(0.05) | bernoulli(p=0.02)")
    Chain(effects=(Delay(delay=0.05), Bernoulli(p=0.02)))
    """
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise Refused(f"a link is a text of at most {_LONGEST} characters; {_FORM}")
    try:
        ways = ast.parse(text.strip()).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise Refused(f"the link {text[:80]!r} cannot be read; {_FORM}") from None
    if len(ways) not in (1, 2):
        raise Refused(f"a link has one way for both directions or two parted by ;, not {len(ways)}; {_FORM}")
    parsed = [_way(node.value if isinstance(node, ast.Expr) else node, text) for node in ways]
    return parsed[0] if len(parsed) == 1 else Link(*parsed)


def describe(link: Effect | Chain | Link) -> str:
    """The text that `parse_link` reads back to an equal link; of what has no name there, its `repr`, for the record.

    >>> describe(parse_link("delay(delay=0.05)|bernoulli(0.02)"))
    'delay(0.05) | bernoulli(0.02)'
    """
    if isinstance(link, Link):
        return f"{describe(link.forward)} ; {describe(link.backward)}"
    return " | ".join(map(_call, link.way(0))) if isinstance(link, Effect | Chain) else repr(link)


def _way(node: ast.AST, text: str) -> Effect | Chain:
    """Effects joined by |, taken from the right without recursion: texts are as deep as they are long."""
    behind: list[Effect] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        behind.append(_effect(node.right, text))
        node = node.left
    first = _effect(node, text)
    return Chain((first, *reversed(behind))) if behind else first


def _effect(node: ast.AST, text: str) -> Effect:
    if isinstance(node, ast.Name):
        made = find("effect", GROUP, EFFECTS, node.id)
        raise Refused(f"the effect {node.id} needs brackets: {_usage(node.id, made)}")
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
        part = ast.unparse(node)[:40]
        raise Refused(f"the link {text[:80]!r} has a part that is no effect, {part!r}; {_FORM}")
    name = node.func.id
    made = find("effect", GROUP, EFFECTS, name)
    effect: Effect = made(**_arguments(name, made, node))
    return effect


def _arguments(name: str, made: type[Effect], node: ast.Call) -> dict[str, Any]:
    """The call's arguments by name; whether their values are any good the effect says itself."""
    knobs = _knobs(made)
    usage = _usage(name, made)
    in_place = [knob for knob, (_, by_name) in knobs.items() if not by_name]
    if len(node.args) > len(in_place) or any(isinstance(arg, ast.Starred) for arg in node.args):
        raise Refused(f"{name} takes at most {len(in_place)} arguments without their names: {usage}")
    given = dict(zip(in_place, node.args, strict=False))
    for keyword in node.keywords:
        if keyword.arg is None or keyword.arg in given or keyword.arg not in knobs:
            twice = "twice " if keyword.arg in given else ""
            raise Refused(f"{name} does not take {keyword.arg or '**'} {twice}as an argument: {usage}")
        given[keyword.arg] = keyword.value
    missing = [knob for knob, (needed, _) in knobs.items() if needed and knob not in given]
    if missing:
        raise Refused(f"{name} needs {' and '.join(missing)}: {usage}")
    try:
        return {knob: ast.literal_eval(value) for knob, value in given.items()}
    except (ValueError, TypeError, SyntaxError, RecursionError, MemoryError):
        raise Refused(f"the arguments of {name} must be numbers or texts in quotes: {usage}") from None


def _usage(name: str, made: type[Any]) -> str:
    """What to write for an effect; of a plug-in's only the names of its arguments are known."""
    named = ", ".join(knob if needed else f"{knob}=..." for knob, (needed, _) in _knobs(made).items())
    return f"write for example {EXAMPLES.get(name, f'{name}({named})')}"


def _knobs(made: type[Any]) -> dict[str, tuple[bool, bool]]:
    """An effect's arguments: whether it is needed, whether it must be named."""
    return {knob.name: (knob.default is MISSING, bool(knob.kw_only)) for knob in fields(made) if knob.init}


def _call(effect: Effect) -> str:
    where = f"{type(effect).__module__}:{type(effect).__name__}"
    # The installed packages are looked through only for what is not built in.
    name = _named(EFFECTS, where) or _named(known_effects(), where)
    if name is None or not is_dataclass(effect):
        return repr(effect)
    given = [(knob.name, getattr(effect, knob.name)) for knob in fields(effect)
             if knob.init and getattr(effect, knob.name) != knob.default]
    if len(given) == 1 and given[0][0] == fields(effect)[0].name:
        return f"{name}({given[0][1]!r})"
    return f"{name}({', '.join(f'{knob}={value!r}' for knob, value in given)})"


def _named(effects: Mapping[str, str], where: str) -> str | None:
    """The name under which the class at `where` is known."""
    return next((name for name, home in effects.items() if home == where), None)
