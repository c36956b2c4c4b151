"""Links as text: read, written, and what of the package is loaded for one."""

import importlib.metadata
import subprocess
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from channel import (
    Bernoulli,
    Blackout,
    Chain,
    Delay,
    Duplicate,
    Effect,
    GammaJitter,
    GilbertElliott,
    InOrder,
    Link,
    describe,
    parse_link,
)
from channel.link import EFFECTS, EXAMPLES
from teleop import Refused, load_scene


def test_texts_and_their_links() -> None:
    for text, link in (
        ("delay(0.05)", Delay(0.05)),
        ("  delay( delay = 0.05 ) ", Delay(0.05)),
        ("delay(0.05) | bernoulli(p=0.02)", Delay(0.05) | Bernoulli(0.02)),
        ("delay(0.05) ; delay(0.2) | bernoulli(0.1)", Link(Delay(0.05), Delay(0.2) | Bernoulli(0.1))),
        ("gamma(0.01, shape=2) | in_order()", GammaJitter(0.01, 2.0) | InOrder()),
        ("gilbert_elliott(0.01, 0.3, loss_bad=0.8)", GilbertElliott(0.01, 0.3, loss_bad=0.8)),
        ("blackout(1, 0.5, every=None) | duplicate(1e-3)", Blackout(1.0, 0.5) | Duplicate(0.001)),
        ("delay(0.05) | (bernoulli(0.1) )", Delay(0.05) | Bernoulli(0.1)),
    ):
        assert parse_link(text) == link, text
    assert describe(Delay(0.05) | Bernoulli(0.02)) == "delay(0.05) | bernoulli(0.02)"
    assert describe(Link(GilbertElliott(0.01, 0.3), InOrder())) == (
        "gilbert_elliott(p_good_to_bad=0.01, p_bad_to_good=0.3) ; in_order()")
    assert len(parse_link(" | ".join(["in_order()"] * 700)).in_direction(0)) == 700


@settings(max_examples=60)
@given(data=st.data(), delay=st.floats(0, 3600), p=st.floats(0, 1))
def test_every_link_reads_back_equal(every_effect: list[Effect], data: st.DataObject, delay: float, p: float) -> None:
    one = st.sampled_from([*every_effect, Delay(delay), Bernoulli(p)])
    ways = []
    for _ in range(data.draw(st.integers(1, 2))):
        effects = data.draw(st.lists(one, min_size=1, max_size=4))
        try:
            ways.append(effects[0] if len(effects) == 1 else Chain(tuple(effects)))
        except Refused:
            return
    link = ways[0] if len(ways) == 1 else Link(*ways)
    assert parse_link(describe(link)) == link


def test_what_is_offered_for_an_effect_can_be_typed(recordings: Path) -> None:
    for name in EFFECTS:
        text = EXAMPLES[name].replace("up.txt", str(recordings / "trace")).replace("ping.txt", str(recordings / "ping"))
        text = text.replace("runs/hard_wall-1", str(recordings / "live"))
        effect = parse_link(text)
        assert describe(effect).startswith(f"{name}(")
        knobs = [knob.name for knob in fields(effect) if knob.init]  # all are dataclasses
        assert text.count(",") == max(len(knobs) - 1, 0), name


def test_an_effect_of_ones_own_is_shown_as_its_repr_and_one_of_a_plug_in_by_its_name_also_where_that_is_a_synonym(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    class Own(Delay):
        """Somebody's own."""

    def installed(name: str, value: str) -> None:
        entry = importlib.metadata.EntryPoint(name, value, "teleop.effects")
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: [entry])

    assert describe(Delay(0.2) | Own(0.1)) == f"delay(0.2) | {Own(0.1)!r}"
    assert load_scene("canonical", link=Own(0.1)).knobs["link"] == repr(Own(0.1))
    for text in ("loss(0.02)", "loss"):
        with pytest.raises(Refused, match=r"^there is no effect 'loss'; write for example bernoulli\(0\.02\)$"):
            parse_link(text)
    installed("mine", f"{Own.__module__}:Own")
    assert describe(Own(0.1)) == "mine(0.1)"
    installed("loss", "channel.duplicate:Duplicate")
    assert parse_link("loss(0.02)") == Duplicate(0.02)


def test_only_what_a_text_names_is_loaded_and_dice_when_they_are_thrown() -> None:
    """Importing `channel.link` loads no effect; a constant delay loads no generator (numpy itself may)."""
    files = {home.partition(":")[0] for home in EFFECTS.values()}
    code = f"""import sys, numpy
had, files = 'numpy.random' in sys.modules, {files!r}
from channel.link import parse_link
assert not files & set(sys.modules)
link = parse_link('delay(0.05)')
link.arrivals(0, 100, 1000000, 1, 100), link.stream(0, 1, 100).send(0, 0)
assert had or 'numpy.random' not in sys.modules
link = parse_link('delay(0.1) | bernoulli(0.5)')
assert files & set(sys.modules) == {{'channel.delay', 'channel.bernoulli'}}
link.arrivals(0, 100, 1000000, 1, 100)
assert 'numpy.random' in sys.modules"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_path_may_hold_what_separates_effects_and_needs_no_quotes(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--link 'recorded(runs/x)'` was refused: the quotes of the shell were taken for enough."""
    awkward = recordings / 'a ; b | c "d".txt'
    awkward.write_text((recordings / "trace").read_text())
    link = parse_link(f"delay(0.1) ; mahimahi({str(awkward)!r}, queue=7)")
    assert link.bwd.path == str(awkward)
    assert parse_link(describe(link)) == link
    monkeypatch.chdir(tmp_path)
    Path("log.txt").write_text((recordings / "ping").read_text())
    for bare in ("log.txt", "./log.txt", f"{tmp_path}/log.txt"):
        quoted = parse_link(f"delay(0.01) | ping_log('{bare}', start=0.5) ; delay(0.02)")
        assert parse_link(f"delay(0.01) | ping_log({bare}, start=0.5) ; delay(0.02)") == quoted
        assert parse_link(describe(quoted)) == quoted
