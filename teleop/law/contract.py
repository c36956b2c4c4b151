"""The contract of a law: what its methods return, checked before it runs, and its mistakes put in one sentence.

`check_contract` asks a law for a few ticks at rest and in slow motion, when a scene is made of it: so every way of
running it, single, swept, compiled or live, refuses the same law with the same sentence. What goes wrong only later,
in the middle of a run, is put in words by `attempt` and `refusal`. A sentence has the law, the method and the line of
the file that the method is in:

    Mine.master (mine.py:31) returns 2 values, (0.5, Forth(x=0.0)); write return force, message, state

A tick pays for none of it: the checks run beforehand, the words are found after an exception.
"""

from __future__ import annotations

import dis
import sys
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import is_dataclass
from functools import lru_cache
from inspect import getsourcefile, getsourcelines
from math import inf, isfinite, isnan
from numbers import Real
from os import getcwd
from os.path import relpath
from struct import pack
from types import CodeType, FrameType, FunctionType
from typing import Any, NamedTuple
from weakref import WeakSet

from teleop.errors import Refused, nearest, number_of
from teleop.law import At, functions_of
from teleop.law.declarations import Wrong, check_claims, check_names, check_offers, check_waves, short_repr

RETURNS = {
    "master_start": ("state", "message"), "master_sums": ("sums",), "master": ("force", "message", "state"),
    "slave_start": ("state", "message"), "slave_sums": ("sums",), "slave": ("force", "message", "state"),
    "start": ("state",), "force": ("force", "state"),
}
TAKES = {name: ("at",) if name.endswith("start") else ("s", "at") if name == "force" else ("s", "at", "rx")
         for name in RETURNS}
FIRST = {  # the method that shows the type
    ("master", "state"): "master_start", ("slave", "state"): "slave_start", ("force", "state"): "start",
    ("master", "message"): "slave_start", ("slave", "message"): "master_start",
}
REST = At(0.0, 0.0, 0.0, 0.0, 0.0, False, inf, 1e-3, 1e-3)
CREEP = At(1e-6, 1e-3, 0.0, 0.0, 1e-6, True, 1e-3, 1e-3, 1e-3)
SITUATIONS = (REST, REST._replace(fresh=True, age=1e-3), CREEP, CREEP._replace(fresh=False, age=2e-3))
REMEMBER = "keep what it remembers in its state, and nowhere else"

_CHECKED: WeakSet[type] = WeakSet()  # classes of laws that keep the contract


class LawMistake(Refused):
    """A law that breaks the contract, in one sentence with its method and the line."""


def check_contract(law: Any) -> None:
    """Raise `Refused` with one sentence if a method of `law` breaks the contract in a few quiet ticks.

    Checked are the code of the methods (fields that `At`, the messages and the states do not have, tuples of the wrong
    length, assignments to the law itself, in every branch), and what the methods return: the length, the types, the
    message classes, that all of it is finite, and that the same arguments have the same answer. The second law of a
    class is taken for granted.
    """
    kind = type(law)
    if kind in _CHECKED:
        return
    if is_dataclass(law) and not kind.__dataclass_params__.frozen:
        raise LawMistake(f"{kind.__name__}{_class_place(law)} is a dataclass that is not frozen, so a run may "
                         "change it; write @dataclass(frozen=True, kw_only=True) above it")
    _declares(law, check_claims, law)
    try:
        copied = deepcopy(law)  # a law that changes itself, or writes down its calls, has not done so before its run
    except Exception:  # a law may hold what has no copy
        copied = law
    if hasattr(law, "master"):
        _probe_two_port(copied)
    else:
        _probe_one_port(copied)
    if functions_of(law) is kind:  # a wrapper's methods depend on what it wraps
        _CHECKED.add(kind)


def _probe_two_port(law: Any) -> None:
    methods = {name: Method(law, name) for name in RETURNS if hasattr(law, name)}
    for method in methods.values():
        method.check_code({"at": At})
    kinds, states, sent = {}, {}, {}
    for end, peer in (("master", "slave"), ("slave", "master")):
        states[end], sent[peer] = methods[f"{end}_start"].probe(REST)
    _declares(law, check_waves, law, sent)
    _declares(law, check_offers, law, states)
    _declares(law, check_names, {"state": [*states.values()], "message": [*sent.values()]})
    for end, peer in (("master", "slave"), ("slave", "master")):
        kinds[end] = {"state": type(states[end]), "message": type(sent[end])}
        types: dict[str, type] = {"at": At, "s": type(states[end]), "rx": type(sent[peer])}
        for name in (end, f"{end}_sums"):
            if name in methods:
                methods[name].check_code(types)
    for at in SITUATIONS:
        heard = {"master": sent["slave"], "slave": sent["master"]}
        for end, rx in heard.items():
            arguments = [states[end], at, rx]
            if f"{end}_sums" in methods:
                arguments.append(methods[f"{end}_sums"].probe(*arguments))
            _, sent[end], states[end] = methods[end].probe(*arguments, kinds=kinds[end])


def _declares(law: Any, check: Callable[..., None], *arguments: Any) -> None:
    """Run a check of a law's declarations; `Refused` with the law's class and its line if it fails."""
    try:
        check(*arguments)
    except Wrong as wrong:
        raise LawMistake(f"{type(law).__name__}{_class_place(law)} {wrong}") from None


def _probe_one_port(law: Any) -> None:
    start, force = Method(law, "start"), Method(law, "force")
    start.check_code({"at": At})
    force.check_code({"at": At})
    s = start.probe(REST)
    kinds = {"state": type(s)}
    force.check_code({"at": At, "s": type(s)})
    for at in SITUATIONS:
        _, s = force.probe(s, at._replace(fresh=False, age=inf), kinds=kinds)


class Method(NamedTuple):
    """Method of a law, called by its name."""

    law: Any
    name: str

    @property
    def label(self) -> str:
        """The law's class and the method, as a sentence names them."""
        return f"{type(self.law).__name__}.{self.name}"

    @property
    def function(self) -> FunctionType | None:
        """The plain function behind the method, if there is one."""
        end = getattr(self.law, self.name)
        end = getattr(end, "__func__", end)
        return end if isinstance(end, FunctionType) else None

    def call(self, *arguments: Any) -> Any:
        """The method's answer; `Refused` with its line if it raises."""
        try:
            return getattr(self.law, self.name)(*arguments)
        except Exception as error:
            refused = refusal(self.law, error)
            if refused is None:  # it was not even entered: it takes other arguments
                names = ", ".join((*TAKES[self.name], "over")[:len(arguments)])
                refused = self.in_words(error, self.first_line(), f"it is called as {self.name}({names})")
            raise refused from None

    def probe(self, *arguments: Any, kinds: Mapping[str, type] | None = None) -> Any:
        """The method's answer, judged, and the same when it is called with the same arguments again."""
        before = dict(getattr(self.law, "__dict__", {}))
        answer = self.call(*arguments)
        for name, value in getattr(self.law, "__dict__", {}).items():
            if name not in before or before[name] is not value:
                raise self.refuse(arguments, f"changes the law, {name}={short_repr(value)}; {REMEMBER}")
        self.judge(arguments, answer, kinds)
        if in_bits(answer) != in_bits(self.call(*arguments)):
            raise self.refuse(arguments, f"answers the same arguments differently the second time; {REMEMBER}")
        return answer

    def judge(self, arguments: tuple[Any, ...], answer: Any, kinds: Mapping[str, type] | None = None, *,
              exact: bool = False, finite: bool = True) -> None:
        """Raise `Refused`, with the line of the return statement, if `judge_answer` finds the answer wrong."""
        try:
            judge_answer(self.name, answer, kinds, exact=exact, finite=finite)
        except Wrong as wrong:
            raise self.refuse(arguments, str(wrong)) from None

    def refuse(self, arguments: tuple[Any, ...], text: str) -> LawMistake:
        """The sentence that begins with this method and the line at which it returns for `arguments`."""
        return LawMistake(f"{self.label}{self.return_line(arguments) or self.first_line()} {text}")

    def in_words(self, error: Exception, place: str, cure: str = "") -> LawMistake:
        """The sentence for an exception that the method raised at `place`."""
        message = " ".join(_text(error).split())
        message = f"{type(error).__name__}{': ' * bool(message)}{message}"
        return LawMistake(f"{self.label}{place} raised {message}; {cure or _cure(error)}")

    def first_line(self) -> str:
        """First line of the method, " (path:line)"; nothing if it is no Python function."""
        function = self.function
        return "" if function is None else file_line(function.__code__.co_filename, function.__code__.co_firstlineno)

    def return_line(self, arguments: tuple[Any, ...]) -> str:
        """Line at which the method returns for `arguments`, " (path:line)": it is called once more, and traced."""
        places: list[str] = []

        def on_call(frame: FrameType, event: str, arg: object) -> Any:  # noqa: ARG001 - Python's own signature
            frame.f_trace_lines = False
            return on_return

        def on_return(frame: FrameType, event: str, arg: object) -> Any:  # noqa: ARG001
            if event == "return":
                places.append(file_line(frame.f_code.co_filename, frame.f_lineno))
            return on_return

        end = getattr(self.law, self.name)
        _traced(on_call, end, *arguments)
        return places[-1] if places else ""  # the outermost frame returns last

    def check_code(self, kinds: Mapping[str, type]) -> None:
        """Raise `Refused` for an instruction that fails whenever it is reached; `kinds` are those of the arguments."""
        function = self.function
        if function is None:
            return
        code = function.__code__
        bound = getattr(self.law, self.name) is not function and hasattr(getattr(self.law, self.name), "__func__")
        names = code.co_varnames[:code.co_argcount]
        takes = ("self", *TAKES[self.name]) if bound else TAKES[self.name]
        if len(names) < len(takes):  # an argument is missing, so the names play other parts: the call says which
            return
        roles = dict(zip(names, (*takes, "over"), strict=False))
        roles = {name: role for name, role in roles.items() if role == "self" or role in kinds}
        for line, text in _faults_of(code, tuple(roles.items()), tuple(kinds.items()), RETURNS[self.name]):
            raise LawMistake(f"{self.label}{file_line(code.co_filename, line)} {text}")


@lru_cache(maxsize=256)
def _faults_of(code: CodeType, roles: tuple[tuple[str, str], ...], kinds: tuple[tuple[str, type], ...],
               returns: tuple[str, ...]) -> tuple[tuple[int, str], ...]:
    """Line and sentence of each instruction that cannot be right; `roles`: the parts that local names play."""
    return tuple(_faults(list(dis.get_instructions(code)), dict(roles), dict(kinds), returns, code.co_consts))


def _faults(lines: list[dis.Instruction], roles: dict[str, str], kinds: dict[str, type], returns: tuple[str, ...],
            constants: tuple[Any, ...]) -> Iterator[tuple[int, str]]:
    for one in lines:
        if one.opname.startswith("STORE_FAST") and one.opname != "STORE_FAST_LOAD_FAST":
            for name in one.argval if isinstance(one.argval, tuple) else (one.argval,):
                roles.pop(name, None)  # it is given another value
        elif one.opname == "STORE_FAST_LOAD_FAST" and isinstance(one.argval, tuple):
            roles.pop(one.argval[0], None)
    line = 0
    for before, now, after in zip(lines, lines[1:], [*lines[2:], None], strict=False):
        line = (now.positions.lineno if now.positions else None) or line
        role = roles.get(_loaded(before), "")
        kind = kinds.get(role)
        if now.opname in ("LOAD_ATTR", "LOAD_METHOD") and kind is not None:
            # A name that is asked for as a text, with hasattr or getattr, may be there in another version.
            if not hasattr(kind, now.argval) and now.argval not in constants:
                yield line, f"reads {_loaded(before)}.{now.argval}, but {_fields(kind, now.argval)}"
        elif now.opname == "STORE_ATTR" and role == "self":
            yield line, f"changes the law, {_loaded(before)}.{now.argval}; {REMEMBER}"
        elif now.opname == "COPY" and role == "self" and after is not None and after.opname == "LOAD_ATTR":  # +=
            yield line, f"changes the law, {_loaded(before)}.{after.argval}; {REMEMBER}"
        elif now.opname == "RETURN_VALUE" and before.opname == "BUILD_TUPLE" and before.argval != len(returns) > 1:
            yield line, f"returns {number_of(before.argval, 'value')}; write return {', '.join(returns)}"


def _loaded(one: dis.Instruction) -> str:
    """The local name that an instruction puts on the stack last; empty for any other."""
    if "LOAD_FAST" not in one.opname:
        return ""
    return str(one.argval[-1] if isinstance(one.argval, tuple) else one.argval)


def judge_answer(name: str, answer: Any, kinds: Mapping[str, type] | None = None, *, exact: bool = False,
                 finite: bool = True) -> None:
    """Raise `Wrong` if `answer` is none that the method `name` may return.

    `kinds`: the types of state and message that the starts returned. `exact`: every number is of type float, no int
    and none of numpy's. `finite`: all numbers are finite, as they are for finite arguments.
    """
    names = RETURNS[name]
    if answer is None:
        raise Wrong(f"returns nothing; write return {', '.join(names)}")
    parts = answer if len(names) > 1 else (answer,)
    if not isinstance(parts, tuple) or (len(parts) != len(names) and hasattr(parts, "_fields")):
        raise Wrong(f"returns {short_repr(answer)} of type {type(answer).__name__}; write return {', '.join(names)}")
    if len(parts) != len(names):
        raise Wrong(f"returns {number_of(len(parts), 'value')}, {short_repr(answer)}; write return {', '.join(names)}")
    for what, part in zip(names, parts, strict=True):
        _judge_part(what, part, exact=exact)
        kind = None if kinds is None else kinds.get(what)
        if kind is not None and type(part) is not kind:
            raise Wrong(f"returns a {what} of type {type(part).__name__}, but {FIRST[name, what]} one of type "
                        f"{kind.__name__}; use one type throughout")
        if finite and not all(map(isfinite, part if isinstance(part, tuple) else (part,))):
            raise Wrong(f"returns the {what} {short_repr(part)} for finite arguments; guard denominators with "
                        "max(.., eps)")


def _judge_part(what: str, part: Any, *, exact: bool) -> None:
    if what == "force":
        if not _is_number(part, exact=exact):
            raise Wrong(f"returns the force {short_repr(part)} of type {type(part).__name__}; write it as a float")
        return
    if what == "state" and type(part) is tuple and not part:
        return
    if not isinstance(part, tuple) or not hasattr(part, "_fields"):
        nothing = " or ()" if what == "state" else ""
        raise Wrong(f"returns the {what} {short_repr(part)} of type {type(part).__name__}; make it a NamedTuple of "
                    f"floats{nothing}")
    for field, entry in zip(part._fields, part, strict=True):
        if not _is_number(entry, exact=exact):
            raise Wrong(f"returns the {what} with {field}={short_repr(entry)} of type {type(entry).__name__}; "
                        "write it as a float")


def _is_number(value: Any, *, exact: bool) -> bool:
    return type(value) is float or (not exact and isinstance(value, Real))


def attempt(law: Any, work: Callable[..., Any], *arguments: Any) -> Any:
    """`work(*arguments)`; an exception that is the law's doing becomes `Refused`, with the method and its line.

    If the exception did not come out of the law, the work is done again while the law's answers are judged: one that
    could not be used, such as a text for a force, is then found where it was returned.
    """
    try:
        return work(*arguments)
    except Refused:
        raise
    except Exception as error:
        # Another message fails where it is read, in the method that it comes to: so the one that sent it is looked for.
        sent = _found_again(law, work, *arguments) if isinstance(error, TypeError | AttributeError) else None
        refused = sent or refusal(law, error) or _found_again(law, work, *arguments)
        if refused is None:
            raise
    raise refused


def refusal(law: Any, error: BaseException) -> LawMistake | None:
    """The sentence for an exception that came out of a method of `law`; None for any other.

    The line is the innermost one in the method's own file.
    """
    if not isinstance(error, Exception) or isinstance(error, Refused | MemoryError):
        return None
    from traceback import walk_tb

    methods = _methods(law)
    method: Method | None = None
    place = file = ""
    for frame, line in walk_tb(error.__traceback__):
        if (called := methods.get(frame.f_code)) is not None and (method is None or called.law is not method.law):
            method, file = called, frame.f_code.co_filename
        if method is not None and frame.f_code.co_filename == file:
            place = file_line(file, line)
    return None if method is None else method.in_words(error, place)


def not_finite(law: Any, column: str) -> str:
    """Name the column that is not finite, and of a force the method that returned it.

    >>> from teleop.laws.direct import Direct
    >>> not_finite(Direct(), "f_s"), not_finite(Direct(), "v_m")
    ('f_s is not finite, as Direct.slave returned', 'v_m is not finite')
    """
    name = {"f_m": "master" if hasattr(law, "master") else "force", "f_s": "slave"}.get(column)
    return f"{column} is not finite" + (f", as {Method(law, name).label} returned" if name else "")


def _found_again(law: Any, work: Callable[..., Any], *arguments: Any) -> LawMistake | None:
    """The first answer of the law that is wrong while `work` is done, which fails; None if there is none."""
    methods = _methods(law)
    mistakes: list[LawMistake] = []

    def on_call(frame: FrameType, event: str, arg: object) -> Any:  # noqa: ARG001 - Python's own signature
        if frame.f_code not in methods or mistakes:
            return None
        frame.f_trace_lines = False
        return on_return

    def on_return(frame: FrameType, event: str, answer: Any) -> Any:
        method = methods[frame.f_code]
        if event == "return" and not mistakes:
            try:
                judge_answer(method.name, answer, _kinds(law).get(method.name), finite=False)
            except Wrong as wrong:
                place = file_line(frame.f_code.co_filename, frame.f_lineno)
                mistakes.append(LawMistake(f"{method.label}{place} {wrong}"))
        return on_return

    _traced(on_call, work, *arguments)
    return mistakes[0] if mistakes else None


def _traced(on_call: Callable[[FrameType, str, object], Any], work: Callable[..., Any], *arguments: Any) -> None:
    """Run `work` under Python's tracing, and pass over its exception."""
    before = sys.gettrace()
    sys.settrace(on_call)
    try:
        work(*arguments)
    except Exception:  # that it fails is known
        pass
    finally:
        sys.settrace(before)


def _methods(law: Any) -> dict[CodeType, Method]:
    """The methods of a law by their code, with those of the law that stages stand around."""
    laws = [law]
    while "inner_law" in vars(type(laws[-1])):  # a law with a stage around it calls the law's own functions
        laws.append(laws[-1].inner())
    methods = [Method(each, name) for each in laws for name in RETURNS if hasattr(each, name)]
    return {method.function.__code__: method for method in methods if method.function is not None}


def _kinds(law: Any) -> dict[str, dict[str, type]]:
    """The types of state and message of each end, as the starts show them; what has none is left out."""
    try:
        if not hasattr(law, "master"):
            return {"force": {"state": type(law.start(REST))}}
        (s_m, back), (s_s, forth) = law.master_start(REST), law.slave_start(REST)
    except Exception:  # the starts are judged when they are called
        return {}
    master, slave = {"state": type(s_m), "message": type(forth)}, {"state": type(s_s), "message": type(back)}
    return {"master": master, "slave": slave}


def _cure(error: Exception) -> str:
    """Advice on an exception that a method of a law raised."""
    if type(error).__name__ == "FrozenInstanceError":
        return REMEMBER
    if isinstance(error, AttributeError) and isinstance(error.obj, tuple) and hasattr(error.obj, "_fields"):
        return _fields(type(error.obj), error.name or "")
    if isinstance(error, ArithmeticError) or (isinstance(error, ValueError) and "math domain" in _text(error)):
        return "guard denominators with max(.., eps), write x*x for x**2, keep sqrt and exp in their range"
    return "mend that line"


def _fields(kind: type, name: str) -> str:
    """Fields of a NamedTuple, for a sentence on one that it has not."""
    fields: tuple[str, ...] = getattr(kind, "_fields", ())
    if not fields:
        return f"{'()' if kind is tuple else kind.__name__} has no fields"
    guess = nearest(name, fields)
    guess = f"; {guess}" if guess.startswith("did") else ""
    return f"{'an At' if kind is At else kind.__name__} has {', '.join(fields)}{guess}"


def in_bits(answer: Any) -> str:
    """An answer's floats to the bit, with what they are in; NaN equals itself, 0.0 is not -0.0."""
    if isinstance(answer, float):
        return pack("<d", answer).hex() if not isnan(answer) else "nan"
    if isinstance(answer, tuple):
        return f"{type(answer).__name__}({','.join(in_bits(each) for each in answer)})"
    return repr(answer)


def _text(error: Exception) -> str:
    try:
        return str(error)
    except Exception:  # an exception's own __str__ may be what is broken
        return ""


def file_line(file: str, line: int) -> str:
    """A line of a file, " (path:line)", the path from the current folder if it is in there."""
    try:
        near = relpath(file, getcwd())
    except (OSError, ValueError):
        near = file
    return f" ({file if near.startswith('..') or file.startswith('<') else near}:{line})"


def _class_place(law: Any) -> str:
    """Place of a law's class, " (path:line)"; without its source, the place of its first method."""
    try:
        return file_line(getsourcefile(type(law)) or "", getsourcelines(type(law))[1])
    except (OSError, TypeError):
        return next((place for name in RETURNS if hasattr(law, name) and (place := Method(law, name).first_line())), "")
