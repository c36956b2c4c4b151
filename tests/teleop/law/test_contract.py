"""The first mistakes of a law's author: one sentence with the law, the method and the line, however the law is run."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from master.__main__ import main as master
from slave.__main__ import main as slave
from teleop import check_law, load_scene, run, sweep
from teleop.__main__ import main as teleop
from teleop.errors import Refused
from teleop.law import BUILT_IN
from teleop.law.contract import check_contract, in_bits, refusal
from teleop.laws.wave import Wave
from teleop.scene.library import scene_function

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
Typed = tuple[str, str]

AT_ONCE: dict[str, tuple[str, str]] = {  # the method, whose wrong line ends in "# here", and the sentence behind it
    "forgets the state": (f"""
    {MASTER}
        f = rx.q
        return f, Forth(at.x)  # here""", "returns 2 values; write return force, message, state"),
    "forgets the state in a branch": (f"""
    {MASTER}
        if at.x > 1e3:
            return 0.0, Forth(at.x)  # here
        return rx.q, Forth(at.x), s""", "returns 2 values; write return force, message, state"),
    "forgets to return": (f"""
    {MASTER}
        rx.q, Forth(at.x), s  # here""", "returns nothing; write return force, message, state"),
    "returns one value too many": (f"""
    {MASTER}
        return rx.q, Forth(at.x), s, s  # here""", "returns 4 values; write return force, message, state"),
    "returns a list": (f"""
    {MASTER}
        return [rx.q, Forth(at.x), s]  # here""", "of type list; write return force, message, state"),
    "returns another message": (f"""
    {MASTER}
        return rx.q, rx, s  # here""", "returns a message of type Back, but slave_start one of type Forth; use"),
    "returns a plain tuple as the message": (f"""
    {MASTER}
        return rx.q, (at.x,), s  # here""", "returns the message (0.0,) of type tuple; make it a NamedTuple of floats"),
    "returns a list as the state": (f"""
    {MASTER}
        return rx.q, Forth(at.x), [at.x]  # here""", "returns the state [0.0] of type list; make it a NamedTuple of"),
    "returns another state": (f"""
    {MASTER}
        return rx.q, Forth(at.x), ()  # here""", "returns a state of type tuple, but master_start one of type S; use"),
    "misspells a field of At": (f"""
    {MASTER}
        return at.velocity, Forth(at.x), s  # here""",
        "reads at.velocity, but an At has x, v, f, f_held, dx, fresh, age, dt, span, gain"),
    "misspells a field of At in a branch": (f"""
    {MASTER}
        if at.x > 1e3:
            return at.frash, Forth(at.x), s  # here
        return rx.q, Forth(at.x), s""",
        "reads at.frash, but an At has x, v, f, f_held, dx, fresh, age, dt, span, gain; did you mean fresh?"),
    "misspells a field of At in a function that it calls": (f"""
    {MASTER}
        return helper(at), Forth(at.x), s""", "raised AttributeError: 'At' object has no attribute 'depth'; an At has"),
    "misspells a field of the message": (f"""
    {MASTER}
        return rx.force, Forth(at.x), s  # here""", "reads rx.force, but Back has q"),
    "misspells a field of the state": (f"""
    {MASTER}
        return s.x, Forth(at.x), s  # here""", "reads s.x, but S has y"),
    "returns a complex force": (f"""
    {MASTER}
        return (-1.0 + at.x) ** 0.5, Forth(at.x), s  # here""", "j) of type complex; write it as a float"),
    "returns a text": (f"""
    {MASTER}
        return "1.0", Forth(at.x), s  # here""", "returns the force '1.0' of type str; write it as a float"),
    "sends a text": (f"""
    {MASTER}
        return rx.q, Forth("near"), s  # here""", "returns the message with x='near' of type str; write it as a float"),
    "remembers nothing": (f"""
    {MASTER}
        return rx.q, Forth(at.x), S(None)  # here""", "returns the state with y=None of type NoneType; write it as a"),
    "returns NaN": (f"""
    {MASTER}
        return rx.q + float("nan"), Forth(at.x), s  # here""",
        "returns the force nan for finite arguments; guard denominators with max(.., eps)"),
    "divides by zero": (f"""
    {MASTER}
        return rx.q / at.v, Forth(at.x), s  # here""", "raised ZeroDivisionError: float division by zero; guard den"),
    "takes no message": ("""
    def master(self, s, at):  # here
        return at.x, Forth(at.x), s""", "3 positional arguments but 4 were given; it is called as master(s, at, rx)"),
    "takes no state": ("""
    def master(self, at, rx):  # here
        return at.x, Forth(at.x), ()""", "3 positional arguments but 4 were given; it is called as master(s, at, rx)"),
    "assigns to itself": (f"""
    {MASTER}
        if at.x > 1e3:
            self.K = 3.0  # here
        return rx.q, Forth(at.x), s""", "changes the law, self.K; keep what it remembers in its state"),
    "adds to itself": (f"""
    {MASTER}
        self.K += at.dt  # here
        return rx.q, Forth(at.x), s""", "changes the law, self.K; keep what it remembers in its state"),
    "changes itself behind its own back": (f"""
    {MASTER}
        object.__setattr__(self, "K", self.K + 1.0)
        return rx.q, Forth(at.x), s  # here""", "changes the law, K=301.0; keep what it remembers in its state"),
    "keeps count in its class": (f"""
    {MASTER}
        Mine.count = getattr(Mine, "count", 0.0) + 1.0
        return Mine.count, Forth(at.x), s  # here""", "answers the same arguments differently the second time; keep"),
    "sums what is no number": ("""
    def master_sums(self, s, at, rx):
        return S("all")  # here

    def master(self, s, at, rx, over):
        return over.y, Forth(at.x), s""", "returns the sums with y='all' of type str; write it as a float"),
}
LATER: dict[str, tuple[str, str]] = {  # mistakes in a line that runs only when the hand has moved a little
    "divides by zero": (f"""
    {MASTER}
        return rx.q / (at.x <= 0.005), Forth(at.x), s  # here""", "raised ZeroDivisionError: float division"),
    "names what there is not": (f"""
    {MASTER}
        return (gone if at.x > 0.005 else rx.q), Forth(at.x), s  # here""", "raised NameError: name 'gone' is not def"),
    "returns a text": (f"""
    {MASTER}
        if at.x > 0.005:
            return "much", Forth(at.x), s  # here
        return rx.q, Forth(at.x), s""", "returns the force 'much' of type str; write it as a float"),
    "raises an error of its own": (f"""
    {MASTER}
        if at.x > 0.005:
            raise ValueError("too far")  # here
        return rx.q, Forth(at.x), s""", "raised ValueError: too far; mend that line"),
    "returns nothing": (f"""
    {MASTER}
        if at.x <= 0.005:  # here
            return rx.q, Forth(at.x), s""", "returns nothing; write return force, message, state"),
    "returns another message": (f"""
    {MASTER}
        if at.x > 0.005:
            return rx.q, S(at.x), s  # here
        return rx.q, Forth(at.x), s""", "returns a message of type S, but slave_start one of type Forth; use one type"),
}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Writes a scene's file with a law in it, in the current folder; the place that its sentence has to name."""
    monkeypatch.chdir(tmp_path)

    def write(method: str, how: str = FROZEN) -> str:
        text = LAW.format(method=method.strip("\n"), how=how)
        Path("mine.py").write_text(text)
        at = [n for n, line in enumerate(text.splitlines(), 1) if line.endswith(("# here", "return at.depth"))]
        return f"mine.py:{at[-1]}"

    return write


def law_of_file() -> Any:
    """The law in mine.py by itself: no scene has been made of it."""
    return scene_function("mine.py").__globals__["Mine"]()


def rows(table: Any) -> list[dict[str, Any]]:
    """A sweep's rows in the order of their numbers."""
    return sorted(table, key=lambda row: row["row"])


def typed(main: Any, *arguments: str) -> tuple[int, str]:
    """The exit code of a command and what it wrote to stderr."""
    import contextlib
    import io

    err = io.StringIO()
    with contextlib.redirect_stderr(err), contextlib.redirect_stdout(io.StringIO()):
        code = main(list(arguments))
    return code, err.getvalue()


@pytest.mark.parametrize("mistake", AT_ONCE)
def test_a_mistake_has_one_sentence_wherever_the_law_is_run(mistake: str, file: Any) -> None:
    method, said = AT_ONCE[mistake]
    place = file(method)
    said_by = r"Mine\.\w+ " + re.escape(f"({place}) ")
    with pytest.raises(Refused, match=said_by) as refused:
        load_scene("mine.py")
    sentence = str(refused.value)
    assert said in sentence
    assert "\n" not in sentence
    for engine in ("plain", "scalar", "vector"):
        with pytest.raises(Refused) as swept:
            sweep("mine.py", seeds=2, engine=engine)
        assert str(swept.value) == sentence
    listens, peer = ("--listen", "127.0.0.1:0"), ("--peer", "127.0.0.1:9")
    for main, *arguments in ((teleop, "run", "mine.py"), (teleop, "sweep", "mine.py", "--seeds", "2"),
                             (teleop, "demo", "mine.py"), (slave, "mine.py", *listens), (master, "mine.py", *peer)):
        assert typed(main, *arguments) == (2, f"teleop: {sentence}\n")  # type: ignore[arg-type]  # they are texts
    assert not Path("runs").exists()


@pytest.mark.parametrize("mistake", AT_ONCE)
def test_check_law_says_the_same(mistake: str, file: Any) -> None:
    file(AT_ONCE[mistake][0])
    law = law_of_file()
    with pytest.raises(Refused) as refused:
        load_scene("canonical", law=law)
    sentence = str(refused.value)
    with pytest.raises(Refused) as checked:
        check_law(law)
    assert str(checked.value) == sentence


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
    bad, good = rows(sweep("mine.py", {"duration": [0.3, 0.01]}, engine="plain"))
    assert (bad["status"], bad["sentence"], good["status"]) == ("refused", sentence, "ok")


@pytest.mark.parametrize("engine", ["scalar", "vector"])
@pytest.mark.parametrize("mistake", ["returns a text", "returns another message", "raises an error of its own"])
def test_compiled_rows_of_a_law_with_a_mistake_in_a_later_line_run_plain_and_say_so(
    mistake: str, engine: str, file: Any
) -> None:
    method, said = LATER[mistake]
    place = file(method)
    bad, good = rows(sweep("mine.py", {"duration": [0.3, 0.01]}, engine=engine))
    assert bad["sentence"].startswith(f"Mine.master ({place}) {said}")
    assert good["status"] == "ok"


def test_a_dataclass_that_is_not_frozen_is_refused_with_the_line_of_its_class(file: Any) -> None:
    file(AT_ONCE["divides by zero"][0], "kw_only=True")
    with pytest.raises(Refused, match=r"^Mine \(mine.py:18\) is a dataclass that is not frozen.* write @dataclass"):
        load_scene("mine.py")


def test_a_force_that_is_no_longer_finite_is_a_result_that_names_the_method(file: Any) -> None:
    file(f"""
    {MASTER}
        return (rx.q if at.x < 0.005 else rx.q + 1e308 * 10.0), Forth(at.x), s""")
    result = run(load_scene("mine.py"))
    assert result.status == "diverged"
    assert "f_m is not finite, as Mine.master returned; " in result.sentence


def test_a_command_shows_no_traceback(file: Any) -> None:
    place = file(LATER["divides by zero"][0])
    command = [sys.executable, "-m", "teleop", "run", "mine.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"teleop: Mine.master ({place}) raised ZeroDivisionError: ")
    assert done.stderr.count("\n") == 1


# Laws of other shapes


ONE_PORT = '''
def scene(): ...
from dataclasses import dataclass
from typing import ClassVar, NamedTuple
class S(NamedTuple):
    y: float
@dataclass(frozen=True, kw_only=True)
class Mine:
    K: float = 300.0
    claims: ClassVar[dict[str, str]] = {{}}
    def start(self, at):
        return S(at.x)
    def force(self, s, at):
        {line}
'''


@pytest.mark.parametrize(("line", "said"), [
    ("return self.K * at.x", "returns 0.0 of type float; write return force, state"),
    ("return self.K * at.x, [s]", "returns the state [S(y=0.0)] of type list; make it a NamedTuple of floats or ()"),
    ("return self.K * at.pos, s", "reads at.pos, but an At has x, v"),
    ("return 1j * at.x, s", "of type complex; write it as a float"),
    ("self.K = 2.0; return 0.0, s", "changes the law, self.K; keep"),
    ("return 1.0, s, s", "returns 3 values; write return force, state"),
])
def test_a_one_port_law_is_asked_the_same(line: str, said: str, file: Any) -> None:
    file("")
    Path("mine.py").write_text(ONE_PORT.format(line=line))
    with pytest.raises(Refused, match=r"^Mine\.force \(mine\.py:14\) ") as refused:
        replace(load_scene("virtual_wall"), law=law_of_file())
    assert said in str(refused.value)


class Passing:
    """A law that is whatever it wraps."""

    def __init__(self, law: Any) -> None:
        self.law = law

    def __getattr__(self, name: str) -> Any:
        if name == "law":
            raise AttributeError(name)
        return getattr(self.law, name)


def test_a_law_that_wraps_another_is_asked_for_each_that_it_wraps(file: Any) -> None:
    check_contract(Passing(Wave()))
    file(AT_ONCE["returns a text"][0])
    law = law_of_file()
    with pytest.raises(Refused, match=r"^Passing\.master \(mine\.py:\d+\) returns the force '1.0' of type str"):
        check_contract(Passing(law))


def test_a_law_that_writes_down_its_calls_has_none_before_the_run(file: Any) -> None:
    file(f"""
    calls: list = None

    {MASTER}
        self.calls.append(at)
        return rx.q, Forth(at.x), s""")
    law = law_of_file()
    law = replace(law, calls=[])
    run(load_scene("canonical", law=law, duration=0.05))
    assert len(law.calls) == 50


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_the_laws_of_the_stack_keep_the_contract(name: str) -> None:
    from teleop import find_law

    check_contract(find_law(name)())


def test_what_a_part_beside_the_law_raises_is_no_mistake_of_the_law() -> None:
    with pytest.raises(ZeroDivisionError) as caught:
        1 / 0  # noqa: B018 - raises
    assert refusal(Wave(), caught.value) is None
    assert refusal(Wave(), MemoryError()) is None


def test_answers_are_compared_to_the_bit() -> None:
    assert in_bits(0.0) != in_bits(-0.0)
    assert in_bits(float("nan")) == in_bits(-float("nan"))
