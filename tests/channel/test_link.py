"""Links as text: read, written, and refused with the words that help."""

import importlib.metadata
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel.bernoulli import Bernoulli
from channel.blackout import Blackout
from channel.delay import Delay
from channel.duplicate import Duplicate
from channel.effect import Chain, Effect
from channel.gamma import GammaJitter
from channel.gilbert_elliott import GilbertElliott
from channel.in_order import InOrder
from channel.link import EFFECTS, EXAMPLES, Link, describe, parse_link
from teleop import load_scene
from teleop.errors import Refused


@pytest.mark.parametrize(("text", "link"), [
    ("delay(0.05)", Delay(0.05)),
    ("  delay( delay = 0.05 ) ", Delay(0.05)),
    ("delay(0.05) | bernoulli(p=0.02)", Delay(0.05) | Bernoulli(0.02)),
    ("delay(0.05) ; delay(0.2) | bernoulli(0.1)", Link(Delay(0.05), Delay(0.2) | Bernoulli(0.1))),
    ("gamma(0.01, shape=2) | in_order()", GammaJitter(0.01, 2.0) | InOrder()),
    ("gilbert_elliott(0.01, 0.3, loss_bad=0.8)", GilbertElliott(0.01, 0.3, loss_bad=0.8)),
    ("blackout(1, 0.5, every=None) | duplicate(1e-3)", Blackout(1.0, 0.5) | Duplicate(0.001)),
    ("delay(0.05) | (bernoulli(0.1) )", Delay(0.05) | Bernoulli(0.1)),
])
def test_texts_and_their_links(text: str, link: Effect | Chain | Link) -> None:
    assert parse_link(text) == link
    assert parse_link(describe(link)) == link


def test_describe_is_short() -> None:
    assert describe(Delay(0.05) | Bernoulli(0.02)) == "delay(0.05) | bernoulli(0.02)"
    assert describe(Link(GilbertElliott(0.01, 0.3), InOrder())) == (
        "gilbert_elliott(p_good_to_bad=0.01, p_bad_to_good=0.3) ; in_order()")


@settings(max_examples=60)
@given(data=st.data())
def test_every_link_reads_back_equal(every_effect: list[Effect], data: st.DataObject) -> None:
    one = st.sampled_from(every_effect)
    ways = []
    for _ in range(data.draw(st.integers(1, 2))):
        effects = data.draw(st.lists(one, min_size=1, max_size=4))
        try:
            ways.append(effects[0] if len(effects) == 1 else Chain(tuple(effects)))
        except Refused:
            return
    link = ways[0] if len(ways) == 1 else Link(*ways)
    assert parse_link(describe(link)) == link


@given(delay=st.floats(0, 3600), p=st.floats(0, 1))
def test_numbers_survive_exactly(delay: float, p: float) -> None:
    link = Delay(delay) | Bernoulli(p)
    assert parse_link(describe(link)) == link


def test_a_path_may_hold_what_separates_effects(recordings) -> None:
    awkward = recordings / 'a ; b | c "d".txt'
    awkward.write_text((recordings / "trace").read_text())
    link = parse_link(f"delay(0.1) ; mahimahi({str(awkward)!r}, queue=7)")
    assert link.bwd.path == str(awkward)  # type: ignore[union-attr]
    assert parse_link(describe(link)) == link


def test_a_link_has_a_way_for_each_direction() -> None:
    link = parse_link("delay(0.001) ; delay(0.002)")
    assert link.arrivals(0, 1, 10, 1, 100).time_ns.tolist() == [1_000_000]
    assert link.arrivals(1, 1, 10, 1, 100).time_ns.tolist() == [2_000_000]
    for direction in (0, 1):
        stream = link.stream(direction, 1, 100)
        stream.send(0, 0)
        assert stream.next_ns() == (direction + 1) * 1_000_000
    with pytest.raises(Refused, match=r"fwd must be an effect.*fwd=Delay\(0.0\)"):
        Link(None, Delay(0.1))  # type: ignore[arg-type]


@pytest.mark.parametrize(("text", "sentence"), [
    ("dealy(0.05)", "no effect 'dealy'; did you mean delay"),
    ("zzz(0.05)", "there are: bernoulli, blackout"),
    ("dely", "no effect 'dely'; did you mean delay"),
    ("delay", r"needs brackets: write for example delay\(0\.05\)$"),
    ("delay(0.05", r"cannot be read: its \( is never closed; write for example"),
    ("delay(0.05))", r"a \) closes no bracket"), ("ping_log('a", "its ' is never closed"),
    ("delay(0.05) |", r"nothing stands behind its last \|"), ("| delay(0.05)", r"nothing stands in front of a \|"),
    ("delay 0.05", "it is not understood from '0.05' on"),
    ("  delay(0.05) delay(1.0)", r"it is not understood from 'delay\(1\.0\)' on"),
    ("", "written once for both directions"),
    ("delay(1); delay(1); delay(1)", "not 3"),
    ("delay(0.05) & bernoulli(0.1)", "part that is no effect, 'delay"),
    ("0.05", "part that is no effect, '0.05'"),
    ("import os", "part that is no effect, 'import os'"),
    ("x = delay(1)", "part that is no effect"),
    ("os.system('true')", "part that is no effect"),
    ("__import__('os')", "no effect '__import__'"),
    ("delay()", r"delay needs delay: write for example delay\(0\.05\)$"),
    ("gilbert_elliott(0.1)", r"needs p_bad_to_good: write .* gilbert_elliott\(0\.005, 0\.05, loss_good="),
    ("delay(0.05, 3)", "delay takes at most 1 argument without their names"),
    ("duplicate(0.1, 0.2)", r"at most 1.*duplicate\(0\.01, after=0\.005\)"),
    ("delay(dealy=0.05)", "delay does not take dealy as an argument"),
    ("delay(0.05, delay=0.05)", "does not take delay twice"),
    ("delay(*[0.05])", "delay takes at most 1"),
    ("delay(**{'delay': 1})", r"does not take \*\*"),
    ("delay(_sent=1)", "does not take _sent"),
    ("delay(open('x'))", "must be numbers or texts in quotes"),
    ("delay(delay)", "must be numbers or texts in quotes"),
    ("delay('50ms')", "delay must be a number, not '50ms'"),
    ("delay(4000)", "at most 3600 s"),
    ("delay(1e999)", "delay must be finite"),
    ("ping_log('/no/such/log')", "/no/such/log cannot be read"),
    ("mahimahi(3)", "path must name a recording"),
    ("delay(0.05)\0", "cannot be read"),
    ("(" * 5000 + ")" * 5000, "cannot be read"),
    ("delay(1)" * 5000, "at most 10000 characters"),
    (3, "a link is a text"),
])
def test_refusals(text: str, sentence: str) -> None:
    with pytest.raises(Refused, match=sentence):
        parse_link(text)


def test_a_very_long_chain_is_read() -> None:
    assert len(parse_link(" | ".join(["in_order()"] * 700)).in_direction(0)) == 700


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_what_is_offered_for_an_effect_can_be_typed(name: str, recordings) -> None:
    text = EXAMPLES[name].replace("up.txt", str(recordings / "trace")).replace("ping.txt", str(recordings / "ping"))
    text = text.replace("runs/hard_wall-1", str(recordings / "live"))
    effect = parse_link(text)
    assert describe(effect).startswith(f"{name}(")
    knobs = [knob.name for knob in fields(effect) if knob.init]  # type: ignore[arg-type]
    assert text.count(",") == max(len(knobs) - 1, 0)


def test_an_effect_of_ones_own_is_shown_as_its_repr() -> None:
    class Own(Delay):
        """Somebody's own."""

    assert describe(Delay(0.2) | Own(0.1)) == f"delay(0.2) | {Own(0.1)!r}"
    assert load_scene("canonical", link=Own(0.1)).knobs["link"] == repr(Own(0.1))


def test_an_effect_of_a_plug_in_is_shown_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    class Own(Delay):
        """A plug-in's."""

    entry = importlib.metadata.EntryPoint("mine", f"{Own.__module__}:Own", "teleop.effects")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [entry])
    assert describe(Own(0.1)) == "mine(0.1)"


def test_only_what_a_text_names_is_loaded() -> None:
    """Importing `channel.link` loads no effect; reading a text loads those in it."""
    files = {home.partition(":")[0] for home in EFFECTS.values()}
    code = (f"import sys; from channel.link import parse_link; files = {files!r};"
            "assert not files & set(sys.modules); parse_link('delay(0.1) | bernoulli(0.1)');"
            "assert files & set(sys.modules) == {'channel.delay', 'channel.bernoulli'}")
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("path", ["log.txt", "./log.txt", "{here}/log.txt"])
def test_a_path_needs_no_quotes(path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--link 'recorded(runs/x)'` was refused: the quotes of the shell were taken for enough."""
    monkeypatch.chdir(tmp_path)
    Path("log.txt").write_text("[1000.0] 64 bytes from 10.0.0.1: icmp_seq=1 ttl=64 time=10.0 ms\n"
                               "[1001.0] 64 bytes from 10.0.0.1: icmp_seq=2 ttl=64 time=12.0 ms\n")
    bare = path.format(here=tmp_path)
    quoted = parse_link(f"delay(0.01) | ping_log('{bare}', start=0.5) ; delay(0.02)")
    assert parse_link(f"delay(0.01) | ping_log({bare}, start=0.5) ; delay(0.02)") == quoted
    assert parse_link(describe(quoted)) == quoted
