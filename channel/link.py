"""Links as text and as objects: `delay(0.05) | bernoulli(p=0.02)`; the two directions, fwd and bwd, parted by `;`.

    link = parse_link("delay(0.05) | gamma(mean=0.01, shape=2) ; delay(0.2)")
    link.arrivals(0, count=10_000, dt_ns=1_000_000, seed=1, size=100)

An effect alone, a chain, and a `Link` of two different directions all answer `arrivals` and `stream`. Effects
are loaded when a text names them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING

from channel.effect import Chain, Effect, LinkPart
from teleop.errors import Refused
from teleop.naming import PartKind, known_places, unreadable

if TYPE_CHECKING:
    from teleop.scene.parts import LeftOutLike

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
    "recorded": "channel.recorded:Recorded",
    "uniform": "channel.uniform:UniformJitter",
}
"""The effects that a text may name, and their classes."""

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
    "recorded": "recorded('runs/hard_wall-1', slave='', left_out=True, digest='')",
    "uniform": "uniform(0.02)",
}
"""An example of each, with all of its knobs."""

GROUP = "teleop.effects"  # of entry points
SYNONYMS = {"burst": "gilbert_elliott", "drop": "bernoulli", "jitter": "uniform", "latency": "delay",
            "loss": "bernoulli", "outage": "blackout", "ping": "ping_log", "reorder": "uniform", "trace": "mahimahi"}
KIND = PartKind(word="effect", group=GROUP, places=EFFECTS, examples=EXAMPLES, synonyms=SYNONYMS)
_LONGEST = 10_000  # characters of a text
# A path by itself, which is no Python: in a shell, where quotes are in use already, people type recorded(runs/x).
_BARE_PATH = re.compile(r"\b(mahimahi|ping_log|recorded)\(\s*(?![\d.]+[,)])([^\s'\"(),=|;]+)\s*(?=[,)])")
_FORM = 'write for example "delay(0.05) | bernoulli(p=0.02)", or "FWD ; BWD"'


@dataclass(frozen=True, slots=True)
class Link(LinkPart):
    """Different effects in the two directions: `fwd` from master to slave, `bwd` from slave to master."""

    fwd: Effect | Chain
    bwd: Effect | Chain

    def __post_init__(self) -> None:
        for name in ("fwd", "bwd"):
            if not isinstance(getattr(self, name), Effect | Chain):
                raise Refused(f"{name} must be an effect or a chain of them, not {getattr(self, name)!r}; "
                              f"write {name}=Delay(0.0) for a direction without any effect")

    def in_direction(self, direction: int) -> tuple[Effect, ...]:
        """The effects of this direction."""
        return (self.bwd if direction else self.fwd).in_direction(direction)

    def leaves_out(self, end: int, dt_ns: int) -> LeftOutLike | None:
        """The ticks that an end leaves out: those of the direction in which it sends."""
        return (self.bwd if end else self.fwd).leaves_out(end, dt_ns)


def known_effects() -> dict[str, str]:
    """Every effect that can be named: `name -> "module:class"`, built in and from plug-ins, none imported."""
    return known_places(GROUP, EFFECTS)


def parse_link(text: str) -> Effect | Chain | Link:
    """The link a text describes. Raises `Refused` for what it cannot mean.

    A file or folder that is the first argument needs no quotes: recorded(runs/hard_wall-1).

    >>> parse_link("delay(0.05) | bernoulli(p=0.02)")
    Chain(effects=(Delay(delay=0.05), Bernoulli(p=0.02)))
    """
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise Refused(f"a link is a text of at most {_LONGEST} characters; {_FORM}")
    text = _BARE_PATH.sub(lambda match: f"{match[1]}({match[2]!r}", text)
    try:
        ways = ast.parse(text.strip()).body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise Refused(f"the link {text[:80]!r} cannot be read: {unreadable(text, error)}; {_FORM}") from None
    if len(ways) not in (1, 2):
        raise Refused(f"a link is written once for both directions, or twice with ; between, not {len(ways)}; {_FORM}")
    parsed = [_way(node.value if isinstance(node, ast.Expr) else node, text) for node in ways]
    return parsed[0] if len(parsed) == 1 else Link(*parsed)


def describe(link: Effect | Chain | Link) -> str:
    """The text that `parse_link` reads back to an equal link; of what has no name there, its `repr`, for the record.

    >>> describe(parse_link("delay(delay=0.05)|bernoulli(0.02)"))
    'delay(0.05) | bernoulli(0.02)'
    """
    if isinstance(link, Link):
        return f"{describe(link.fwd)} ; {describe(link.bwd)}"
    return " | ".join(map(_call, link.in_direction(0))) if isinstance(link, Effect | Chain) else repr(link)


def names_a_file(text: str) -> bool:
    """True if a link of this text may read a file or a folder: it has a text among its arguments, quoted or bare."""
    return "'" in text or '"' in text or _BARE_PATH.search(text) is not None


def record_text(text: str, link: Effect | Chain | Link) -> str:
    """`text` as it names `link` in what is kept: with the digest of what it replays, where it replays a live run.

    Then another record under the same path is another link, wherever links are told apart by their texts.
    """
    effects = [effect for direction in (0, 1) for effect in link.in_direction(direction)]
    return describe(link) if any(hasattr(effect, "digest") for effect in effects) else text


def _way(node: ast.AST, text: str) -> Effect | Chain:
    """Effects joined by |, taken from the right without recursion: texts are as deep as they are long."""
    behind: list[Effect] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        behind.append(_effect(node.right, text))
        node = node.left
    first = _effect(node, text)
    return Chain((first, *reversed(behind))) if behind else first


def _effect(node: ast.AST, text: str) -> Effect:
    effect: Effect = KIND.make(node, text, _FORM)
    return effect


def _call(effect: Effect) -> str:
    where = f"{type(effect).__module__}:{type(effect).__name__}"
    # The installed packages are looked through only for what is not built in.
    name = _name_of(EFFECTS, where) or _name_of(known_effects(), where)
    if name is None or not is_dataclass(effect):
        return repr(effect)
    knobs = [(knob.name, getattr(effect, knob.name)) for knob in fields(effect)
             if knob.init and getattr(effect, knob.name) != knob.default]
    if len(knobs) == 1 and knobs[0][0] == fields(effect)[0].name:
        return f"{name}({knobs[0][1]!r})"
    return f"{name}({', '.join(f'{knob}={value!r}' for knob, value in knobs)})"


def _name_of(effects: Mapping[str, str], where: str) -> str | None:
    """The name under which the class at `where` is known."""
    return next((name for name, home in effects.items() if home == where), None)
