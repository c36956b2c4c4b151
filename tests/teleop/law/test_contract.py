"""The first mistakes of a law's author: one sentence with the law, the method and the line, however the law is run."""

from __future__ import annotations

import contextlib
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from master.__main__ import main as master
from slave.__main__ import main as slave
from teleop import Refused, Wave, check_law, load_scene, run, sweep
from teleop.__main__ import main as teleop
from teleop.law.contract import check_contract, in_bits, refusal
from teleop.scene.library import scene_function
from tests.programs import compiler_of

LAW = '''
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple
from teleop import Scene, load_scene

class Forth(NamedTuple):
    x: float

class Back(NamedTuple):
    q: float

class S(NamedTuple):
    y: float

def helper(at):
    return at.depth

@dataclass({how})
class Mine:
    K: float = 300.0
    claims: ClassVar[dict[str, str]] = {{}}

    def master_start(self, at):
        return S(0.0), Back(0.0)

    def slave_start(self, at):
        return S(0.0), Forth(at.x)

    def slave(self, s, at, rx):
        return self.K * (rx.x - at.x) - 5.0 * at.v, Back(at.f), S(at.x)

    {method}

def scene(*, duration: float = 0.3, law: object = None) -> Scene:
    """A law of one's own."""
    return load_scene("canonical", duration=duration, law=Mine() if law is None else law)
'''
MASTER = "def master(self, s, at, rx):"
FROZEN = "frozen=True, kw_only=True"
FIELDS = "x, v, f, f_held, dx, fresh, age, dt, span, gain"
TWO = "returns {} values; write return force, message, state"
CHANGES = "changes the law, self.K; keep what it remembers in its state"
CALLED = "3 positional arguments but 4 were given; it is called as master(s, at, rx)"

AT_ONCE: dict[str, tuple[str, str]] = {  # lines of the master, the wrong one with "# here", and the sentence behind it
    "forgets the state": ("f = rx.q\nreturn f, Forth(at.x)  # here", TWO.format(2)),
    "forgets it in a branch": (
        "if at.x > 1e3:\n    return 0.0, Forth(at.x)  # here\nreturn rx.q, Forth(at.x), s", TWO.format(2)),
    "forgets to return": ("rx.q, Forth(at.x), s  # here", "returns nothing; write return force, message, state"),
    "returns one value too many": ("return rx.q, Forth(at.x), s, s  # here", TWO.format(4)),
    "returns a list": ("return [rx.q, Forth(at.x), s]  # here", "of type list; write return force, message, state"),
    "returns another message": (
        "return rx.q, rx, s  # here", "returns a message of type Back, but slave_start one of type Forth; use"),
    "returns a plain tuple as the message": (
        "return rx.q, (at.x,), s  # here", "returns the message (0.0,) of type tuple; make it a NamedTuple of floats"),
    "returns a list as the state": (
        "return rx.q, Forth(at.x), [at.x]  # here", "returns the state [0.0] of type list; make it a NamedTuple of"),
    "returns another state": (
        "return rx.q, Forth(at.x), ()  # here", "returns a state of type tuple, but master_start one of type S; use"),
    "misspells a field of At": (
        "return at.velocity, Forth(at.x), s  # here", f"reads at.velocity, but an At has {FIELDS}"),
    "misspells one in a branch": (
        "if at.x > 1e3:\n    return at.frash, Forth(at.x), s  # here\nreturn rx.q, Forth(at.x), s",
        f"reads at.frash, but an At has {FIELDS}; did you mean fresh?"),
    "misspells one in a function that it calls": (
        "return helper(at), Forth(at.x), s", "raised AttributeError: 'At' object has no attribute 'depth'; an At has"),
    "misspells a field of the message": ("return rx.force, Forth(at.x), s  # here", "reads rx.force, but Back has q"),
    "misspells a field of the state": ("return s.x, Forth(at.x), s  # here", "reads s.x, but S has y"),
    "returns a complex force": (
        "return (-1.0 + at.x) ** 0.5, Forth(at.x), s  # here", "j) of type complex; write it as a float"),
    "returns a text": (
        'return "1.0", Forth(at.x), s  # here', "returns the force '1.0' of type str; write it as a float"),
    "sends a text": (
        'return rx.q, Forth("near"), s  # here', "returns the message with x='near' of type str; write it as a float"),
    "remembers nothing": (
        "return rx.q, Forth(at.x), S(None)  # here", "returns the state with y=None of type NoneType; write it as a"),
    "returns NaN": (
        'return rx.q + float("nan"), Forth(at.x), s  # here',
        "returns the force nan for finite arguments; guard denominators with max(.., eps)"),
    "divides by zero": (
        "return rx.q / at.v, Forth(at.x), s  # here", "raised ZeroDivisionError: float division by zero; guard den"),
    "takes no message": ("def master(self, s, at):  # here\n    return at.x, Forth(at.x), s", CALLED),
    "takes no state": ("def master(self, at, rx):  # here\n    return at.x, Forth(at.x), ()", CALLED),
    "assigns to itself": ("if at.x > 1e3:\n    self.K = 3.0  # here\nreturn rx.q, Forth(at.x), s", CHANGES),
    "adds to itself": ("self.K += at.dt  # here\nreturn rx.q, Forth(at.x), s", CHANGES),
    "changes itself behind its own back": (
        'object.__setattr__(self, "K", self.K + 1.0)\nreturn rx.q, Forth(at.x), s  # here',
        "changes the law, K=301.0; keep what it remembers in its state"),
    "keeps count in its class": (
        'Mine.count = getattr(Mine, "count", 0.0) + 1.0\nreturn Mine.count, Forth(at.x), s  # here',
        "answers the same arguments differently the second time; keep"),
    "sums what is no number": (
        'def master_sums(self, s, at, rx):\n    return S("all")  # here\n\n'
        "def master(self, s, at, rx, over):\n    return over.y, Forth(at.x), s",
        "returns the sums with y='all' of type str; write it as a float"),
    # of one port, as `force`
    "one port: forgets the state": (
        "return self.K * at.x  # here", "returns 0.0 of type float; write return force, state"),
    "one port: returns a list as the state": (
        "return self.K * at.x, [s]  # here",
        "returns the state [S(y=0.0)] of type list; make it a NamedTuple of floats or ()"),
    "one port: misspells a field of At": ("return self.K * at.pos, s  # here", f"reads at.pos, but an At has {FIELDS}"),
    "one port: returns a complex force": ("return 1j * at.x, s  # here", "of type complex; write it as a float"),
    "one port: assigns to itself": ("self.K = 2.0  # here\nreturn 0.0, s", "changes the law, self.K; keep"),
    "one port: returns one value too many": ("return 1.0, s, s  # here", "returns 3 values; write return force, state"),
}
LATER: dict[str, tuple[str, str]] = {  # mistakes in a line that runs only when the hand has moved a little
    "divides by zero": (
        "return rx.q / (at.x <= 0.005), Forth(at.x), s  # here", "raised ZeroDivisionError: float division"),
    "names what there is not": (
        "return (gone if at.x > 0.005 else rx.q), Forth(at.x), s  # here", "raised NameError: name 'gone' is not def"),
    "returns a text": (
        'if at.x > 0.005:\n    return "much", Forth(at.x), s  # here\nreturn rx.q, Forth(at.x), s',
        "returns the force 'much' of type str; write it as a float"),
    "raises an error of its own": (
        'if at.x > 0.005:\n    raise ValueError("too far")  # here\nreturn rx.q, Forth(at.x), s',
        "raised ValueError: too far; mend that line"),
    "returns nothing": (
        "if at.x <= 0.005:  # here\n    return rx.q, Forth(at.x), s",
        "returns nothing; write return force, message, state"),
    "returns another message": (
        "if at.x > 0.005:\n    return rx.q, S(at.x), s  # here\nreturn rx.q, Forth(at.x), s",
        "returns a message of type S, but slave_start one of type Forth; use one type"),
}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.chdir(tmp_path)

    def write(method: str, how: str = FROZEN, *, one_port: bool = False) -> str:
        lines = method.split("\n")
        if MASTER[:10] not in method:
            lines = ["def force(self, s, at):" if one_port else MASTER, *[f"    {line}" for line in lines]]
        text = LAW.format(method="\n    ".join(lines), how=how)
        if one_port:
            before, after = text[:text.index("def master_start")], text[text.index("def force"):]
            text = f"{before}def start(self, at):\n        return S(at.x)\n\n    {after}"
        Path("mine.py").write_text(text)
        at = [n for n, line in enumerate(text.splitlines(), 1) if line.endswith(("# here", "return at.depth"))]
        return f"mine.py:{at[-1]}"

    return write


def law_of_file() -> Any:
    """The law in mine.py by itself: no scene has been made of it."""
    return scene_function("mine.py").__globals__["Mine"]()


def typed(main: Any, *arguments: str) -> tuple[int, str]:
    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        code = main(list(arguments))
    return code, err.getvalue()


@pytest.mark.parametrize("mistake", AT_ONCE)
def test_a_mistake_is_told_with_its_line_before_anything_runs(mistake: str, file: Any) -> None:
    method, said = AT_ONCE[mistake]
    one_port = mistake.startswith("one port")
    place = file(method, one_port=one_port)
    law = law_of_file()
    with pytest.raises(Refused, match=r"^Mine\.\w+ " + re.escape(f"({place}) ")) as refused:
        replace(load_scene("virtual_wall" if one_port else "canonical"), law=law)
    sentence = str(refused.value)
    assert said in sentence
    assert "\n" not in sentence
    with pytest.raises(Refused) as checked:
        check_law(law_of_file())
    assert str(checked.value) == sentence


@pytest.mark.parametrize("mistake", ["forgets it in a branch", "keeps count in its class"])
def test_a_mistake_has_one_sentence_wherever_the_law_is_run(mistake: str, file: Any) -> None:
    compiler_of("vector")
    file(AT_ONCE[mistake][0])
    with pytest.raises(Refused) as refused:
        load_scene("mine.py")
    sentence = str(refused.value)
    assert AT_ONCE[mistake][1] in sentence
    for engine in ("plain", "c", "vector"):
        with pytest.raises(Refused) as swept:
            sweep("mine.py", seeds=2, engine=engine)
        assert str(swept.value) == sentence
    listens, peer = ("--listen", "127.0.0.1:0"), ("--peer", "127.0.0.1:9")
    for main, *arguments in ((teleop, "run", "mine.py"), (teleop, "sweep", "mine.py", "--seeds", "2"),
                             (teleop, "demo", "mine.py"), (slave, "mine.py", *listens), (master, "mine.py", *peer)):
        assert typed(main, *arguments) == (2, f"teleop: {sentence}\n")  # they are texts
    assert not Path("runs").exists()


@pytest.mark.parametrize("mistake", LATER)
def test_a_mistake_in_a_line_that_runs_later_is_told_when_it_runs(mistake: str, file: Any) -> None:
    method, said = LATER[mistake]
    place = file(method)
    with pytest.raises(Refused) as refused:
        run(load_scene("mine.py"))
    sentence = str(refused.value)
    assert sentence.startswith(f"Mine.master ({place}) {said}")
    assert typed(teleop, "run", "mine.py") == (2, f"teleop: {sentence}\n")
    assert not Path("runs").exists()
    bad, good = sorted(sweep("mine.py", {"duration": [0.3, 0.01]}, engine="plain"), key=lambda row: row["row"])
    assert (bad["status"], bad["sentence"], good["status"]) == ("refused", sentence, "ok")


@pytest.mark.parametrize(("mistake", "engine"), [
    ("returns another message", "vector"), *[pytest.param(*each, marks=pytest.mark.full) for each in (
        ("returns a text", "c"), ("raises an error of its own", "vector"))]])
def test_compiled_rows_of_a_law_with_a_mistake_in_a_later_line_run_plain_and_say_so(
        mistake: str, engine: str, file: Any) -> None:
    compiler_of(engine)
    method, said = LATER[mistake]
    place = file(method)
    table: Any = sweep("mine.py", {"duration": [0.3, 0.01]}, engine=engine, metrics=["f_m_max"])
    bad, good = sorted(table, key=lambda row: row["row"])
    assert bad["sentence"].startswith(f"Mine.master ({place}) {said}")
    assert good["status"] == "ok"


def test_a_force_that_is_no_longer_finite_is_a_result_that_names_the_method_and_a_law_not_frozen_its_line(
        file: Any) -> None:
    file("return (rx.q if at.x < 0.005 else rx.q + 1e308 * 10.0), Forth(at.x), s")
    result = run(load_scene("mine.py"))
    assert result.status == "diverged"
    assert "f_m is not finite, as Mine.master returned; " in result.sentence
    file(AT_ONCE["divides by zero"][0], "kw_only=True")
    with pytest.raises(Refused, match=r"^Mine \(mine.py:18\) is a dataclass that is not frozen.* write @dataclass"):
        load_scene("mine.py")


class Passing:
    """A law that is whatever it wraps."""

    def __init__(self, law: Any) -> None:
        self.law = law

    def __getattr__(self, name: str) -> Any:
        if name == "law":
            raise AttributeError(name)
        return getattr(self.law, name)


def test_a_law_that_wraps_another_is_asked_for_each_and_one_that_writes_down_its_calls_has_none_before_the_run(
        file: Any) -> None:
    check_contract(Passing(Wave()))
    file(AT_ONCE["returns a text"][0])
    with pytest.raises(Refused, match=r"^Passing\.master \(mine\.py:\d+\) returns the force '1.0' of type str"):
        check_contract(Passing(law_of_file()))
    file(f"calls: list = None\n\n{MASTER}\n    self.calls.append(at)\n    return rx.q, Forth(at.x), s")
    law = replace(law_of_file(), calls=[])
    run(load_scene("canonical", law=law, duration=0.05))
    assert len(law.calls) == 50


def test_what_a_part_beside_the_law_raises_is_no_mistake_of_the_law_whose_answers_are_compared_to_the_bit() -> None:
    with pytest.raises(ZeroDivisionError) as caught:
        1 / 0  # noqa: B018 - raises
    assert refusal(Wave(), caught.value) is None
    assert refusal(Wave(), MemoryError()) is None
    assert in_bits(0.0) != in_bits(-0.0)
    assert in_bits(float("nan")) == in_bits(-float("nan"))
