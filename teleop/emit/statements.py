"""Statements of Python as lines of C: one Python function as one C function, for the types that it is called with."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Callable, Sequence, Set
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

from teleop.emit.calls import Calls
from teleop.emit.expressions import NUMBERS, CExpressions, bare, c_word, texts_of
from teleop.emit.primitives import HELPERS
from teleop.emit.types import DOUBLE, FLOAT, INT, NOTHING, Array, NotPrinted, Printed, TupleParts, Types, Value
from teleop.simulation.expressions import Known, NotSpecialised, functions_in


class Line(NamedTuple):
    """A line of C. `target`: the variable that it sets to `text`, else none."""

    depth: int
    text: str
    target: str = ""
    at: int = 0  # the line of Python


class CFunction(NamedTuple):
    """A function of C: its name, what it takes and gives, whether it may fault, and its text."""

    name: str
    takes: tuple[Any, ...]  # the types of its arguments
    gives: Any
    faults: bool
    text: str


class Program:
    """Contents of one C file: types, helpers, and functions in the order in which they call each other."""

    def __init__(self, prefix: str, real: str = DOUBLE, *, powers: bool = False) -> None:
        self.powers = powers  # the `pow` of libm, which is Python's own where both are of one machine
        self.types = Types(prefix, real)
        self.prefix, self.suffix = prefix, "f" * (real == FLOAT)
        self.helpers: set[str] = set()
        self.libm: set[str] = set()
        self.arrays: dict[str, Array] = {}  # expressions that are arrays
        self._functions: dict[Any, CFunction | None] = {}
        self._small: dict[tuple[str, ...], str] = {}  # functions that copy tuples, by their lines
        self._texts: list[tuple[str, str]] = []
        self._names: Counter[str] = Counter()

    def function(self, function: FunctionType, arguments: list[Value], caller: CExpressions) -> CFunction:
        """The function of C for arguments of these types."""
        key = (function, *[each.type if isinstance(each, Printed) else (repr(each), id(getattr(each, "value", each)))
                           for each in arguments])
        if key in self._functions and self._functions[key] is None:
            raise caller.refused(f"{function.__qualname__} calls itself")
        if key not in self._functions:
            self._functions[key] = None
            stem = Path(function.__code__.co_filename).stem
            try:
                made = self.translated(function, arguments, self._name(f"{stem}_{function.__qualname__}"))
            except NotPrinted:
                del self._functions[key]
                raise
            self._functions[key] = made
            self._texts.append((made.name, made.text))
        result = self._functions[key]
        assert result is not None
        return result

    def printer(self, function: FunctionType) -> Statements:
        """A printer of one function."""
        return Statements(self, function)

    def translated(self, function: FunctionType, arguments: list[Value], name: str) -> CFunction:
        """The function by this name for these arguments."""
        return self.printer(function).translate(arguments, name)

    def inlined(self, function: FunctionType, values: list[Value], caller: CExpressions) -> Value | None:
        """Answer of a function of one line, whose last argument has a star, in the place of its call; else None."""
        inner = self.printer(function)
        *before, line = inner.definition()[0]
        only = not before or (len(before) == 1 and ast.get_docstring(ast.Module([*before], [])) is not None)
        if not only or not isinstance(line, ast.Return) or line.value is None:
            return None
        inner.scope = dict(zip(function.__code__.co_varnames, values, strict=False))
        answer = inner.made_of(inner.evaluate(line.value), *values)
        caller.faults = caller.faults or inner.faults
        return answer

    def _name(self, wanted: str) -> str:
        word = re.sub(r"\W+", "_", wanted).strip("_")
        self._names[word] += 1
        return word if self._names[word] == 1 else f"{word}_{self._names[word]}"

    def helper_function(self, name: str, gives: str, arguments: list[str], lines: list[str]) -> str:
        """The name of a small function with these lines, written once."""
        key = (gives, *arguments, *lines)
        if key not in self._small:
            word = self._small[key] = self._name(name)
            head = f"static {gives} {word}({', '.join(arguments) or 'void'})"
            self._texts.append((word, "\n".join([head, "{", *lines, "}", ""])))
        return self._small[key]

    def text(self, entry: str) -> str:
        """The helpers and functions that `entry`, the text of what calls them, needs."""
        used, needed_texts = entry, []
        for name, text in reversed(self._texts):
            if re.search(rf"\b{name}\(", used):
                needed_texts.append(text)
                used += text
        small = []
        for name in self.helpers:
            if re.search(rf"\b{name}\(", used):
                small.append(name)
        words = {"REAL": self.types.real, "@": self.suffix, "PRE_": self.prefix.upper()}
        helpers = "\n".join([HELPERS[name] for name in HELPERS if name in small])
        for word, meaning in words.items():
            helpers = helpers.replace(word, meaning)
        return helpers + "\n\n" * bool(helpers) + "\n".join(reversed(needed_texts))


class Statements(Calls):
    """Printer of one function."""

    def __init__(self, program: Program, function: Any) -> None:
        super().__init__(program, function)
        self.kinds: dict[str, Any] = {}  # of variables
        self.gives: Any = None
        self.lines: list[Line] = []
        self.declared: dict[str, None] = {}  # variables that are declared at the beginning
        self.stores: Counter[str] = Counter()
        self.words: dict[str, str] = {}  # of names that stand for another variable by now
        self.depth = 1
        self.level = 1  # of the lines that always run, where a name may stand for another variable
        self.loops = 0
        self.copies = 0

    def definition(self) -> tuple[list[ast.stmt], str, int]:
        """The lines of the function, its docstring and where it begins."""
        code = self.function.__code__
        if code.co_name == "<lambda>":
            return self.lambda_lines(), "", code.co_firstlineno
        try:
            node = functions_in(self.function.__module__, code.co_filename).get((code.co_name, code.co_firstlineno))
        except (NotSpecialised, KeyError, SyntaxError):
            node = None
        if node is None:
            raise self.refused("it is not written in a module or a class, so its lines are not there to be read")
        return node.body, (ast.get_docstring(node) or "").split("\n")[0], node.lineno

    def lambda_lines(self) -> list[ast.stmt]:
        """The one line of a lambda: of those in its line the one with its arguments."""
        code = self.function.__code__
        tree = ast.parse(Path(code.co_filename).read_text())
        names = list(code.co_varnames[:code.co_argcount])
        lines = [each for each in ast.walk(tree) if isinstance(each, ast.Lambda) and each.lineno == code.co_firstlineno
                 and [one.arg for one in each.args.args] == names]
        if len(lines) != 1:
            raise self.refused("the lambda cannot be told from another in its line; write a function")
        return [ast.copy_location(ast.Return(lines[0].body), lines[0])]

    def translate(self, arguments: list[Value], name: str) -> CFunction:
        """The function for these arguments."""
        code = self.function.__code__
        body, doc, first = self.definition()
        names = code.co_varnames[:len(arguments)]  # with the one that has a star
        known = dict(zip(names, arguments, strict=True))
        parameters = {word: c_word(word) for word, value in known.items()
                      if isinstance(value, Printed) and value.type != NOTHING}
        self.kinds.update({word: known[word].type for word in parameters})

        def once() -> None:
            self.start({**known, **{word: Printed(self.kinds[word], parameters[word]) for word in parameters}}, body)
            for word, value in known.items():
                if isinstance(value, Known) and word in stores(body):
                    self.set_name(word, value)
            self.body(body)

        self.until_typed(once)
        self.gives = NOTHING if self.gives is None else self.gives
        text = self.rendered(where=first, skip={*parameters.values()})
        unread = [f"    (void){word};\n" for word in parameters.values() if word not in words_of(text)]
        takes = tuple([self.kinds[word] for word in parameters])
        heads = [f"{self.types.c(kind)} {word}" for kind, word in zip(takes, parameters.values(), strict=True)]
        heads += ["unsigned *fault"] * self.faults
        place = f"{short(self.file)}:{first}"
        text = (f"/* {place}{': ' * bool(doc)}{doc.replace('*/', '')} */\nstatic "
                f"{self.types.c(self.gives)} {name}({', '.join(heads) or 'void'})\n{{\n{''.join(unread)}{text}\n}}\n")
        return CFunction(name, takes, self.gives, self.faults, text)

    def until_typed(self, once: Callable[[], Any]) -> Any:
        """Call `once`, which prints, until the types of all variables are found, and return its last answer."""
        for _ in range(8):
            before = dict(self.kinds), self.gives
            made = once()
            if before == (self.kinds, self.gives):
                break
        return made

    def start(self, known: dict[str, Value], body: list[ast.stmt]) -> None:
        """Begin once more, with the types that variables have by now."""
        self.scope, self.lines, self.declared, self.faults, self.words = dict(known), [], {}, False, {}
        self.stores = Counter(each.id for line in body for each in ast.walk(line)
                              if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store))
        self.depth, self.loops, self.copies = 1, 0, 0

    def rendered(self, where: int, skip: Set[str] = frozenset(), keep: str = "") -> str:
        """The lines as text, without those that set what nothing reads; `keep` is text that reads variables too."""
        lines = needed(self.lines, keep)
        text = []
        for word in self.declared:
            kind = self.kinds[word]
            if c_word(word) not in skip and any(line.target == c_word(word) for line in lines):
                zero = self.types.literal(0, kind) if isinstance(kind, str) else "{0}"
                text.append(f"    {self.types.c(kind)} {c_word(word)} = {zero};")
        last = where
        for line in lines:
            set_once = line.target and line.target not in map(c_word, self.declared) and line.target not in skip
            kind = f"const {self.types.c(self.kinds[self.word_of(line.target)])} " if set_once else ""
            body = f"{kind}{line.target} = {line.text};" if line.target else line.text
            at = f"  /* {line.at} */" if line.at and line.at != last else ""
            last = line.at or last
            text.append(f"{'    ' * line.depth}{body}{at}")
        return "\n".join(text)

    def word_of(self, target: str) -> str:
        """The variable that is set, as the types know it."""
        return next((word for word in self.kinds if c_word(word) == target), target)

    # Lines

    def append(self, text: str, target: str = "") -> None:
        """Append a line."""
        self.lines.append(Line(self.depth, text, target, self.line))

    def inner(self, body: list[ast.stmt]) -> None:
        """The lines of a branch or of a loop."""
        self.depth += 1
        self.body(body)
        self.depth -= 1

    def _Pass(self, line: ast.Pass) -> None:
        """Nothing."""

    def _Expr(self, line: ast.Expr) -> None:
        if not isinstance(line.value, ast.Constant):
            raise self.refused(f"the value of {ast.unparse(line)[:60]} goes nowhere, which has no line in C")

    def _Assign(self, line: ast.Assign) -> None:
        value = self.evaluate(line.value)
        if len(line.targets) > 1 and not isinstance(value, Known):
            value = self.temporary(self.whole(value))
        for target in line.targets:
            self.assign(target, value)

    def _AnnAssign(self, line: ast.AnnAssign) -> None:
        if line.value is not None:
            self.assign(line.target, self.evaluate(line.value))

    def _AugAssign(self, line: ast.AugAssign) -> None:
        if not isinstance(line.target, ast.Name):
            raise self.refused(f"{ast.unparse(line.target)} cannot be set in C")
        self.assign(line.target, self.binary(line.op, self._Name(ast.Name(line.target.id, ast.Load())),
                                             self.evaluate(line.value)))

    def fresh(self, letter: str) -> str:
        """A name that no variable of Python has."""
        while True:
            self.copies += 1
            word = f"{letter}{self.copies}"
            if not {word, f"n_{word}"} & {*self.stores, *self.scope}:
                return word

    def temporary(self, value: Printed) -> Printed:
        """A value by a name: its own, or that of a copy."""
        return value if re.fullmatch(r"[\w.]+", value.text) else self.copied(value)

    def copied(self, value: Printed) -> Printed:
        """A copy of a value in a variable of its own."""
        if value.type == NOTHING or value.fixed:
            return value
        word = self.fresh("t")
        self.kinds[word] = value.type
        self.append(bare(value.text), word)
        return Printed(value.type, word)

    def settled(self, value: Value, stored: set[str]) -> Value:
        """A value that stays while these variables of C are set, and that faults here and not where it is read."""
        if isinstance(value, TupleParts):
            return value._replace(values=tuple([self.settled(each, stored) for each in value.values]))
        if isinstance(value, Printed) and {"fault", *stored} & words_of(value.text):
            return self.copied(value)
        return value

    def assign(self, target: Any, value: Value) -> None:
        """Set a name, or the names of a tuple, to a value."""
        if isinstance(target, ast.Tuple):
            if isinstance(value, Printed):
                value = self.temporary(value)
            parts = self.parts(value)
            if len(parts) != len(target.elts):
                raise self.refused(f"{len(parts)} values for {len(target.elts)} names")
            names = [set(map(c_word, stores([each]))) for each in target.elts]
            printed = [each if isinstance(each, Known) else self.whole(each) for each in parts]
            clash = any(set().union(*names[:i]) & words_of(one.text)
                        for i, one in enumerate(printed) if isinstance(one, Printed))
            if clash:
                printed = [self.copied(each) if isinstance(each, Printed) else each for each in printed]
            for each, one in zip(target.elts, printed, strict=True):
                self.assign(each, one)
            return
        if not isinstance(target, ast.Name):
            raise self.refused(f"{ast.unparse(target)} cannot be set in C; make a new tuple")
        if target.id != "_" or any("fault" in each for each in texts_of(value)):
            self.set_name(target.id, value)

    def set_name(self, name: str, value: Value) -> None:
        """Set a variable."""
        now, is_text = self.scope.get(name), isinstance(value, Known) and not isinstance(value.value, (*NUMBERS, tuple))
        printed = Printed(NOTHING, "") if is_text else self.whole(value)
        if printed.type == NOTHING and not is_text:
            value = TupleParts(())
        unfit = value if is_text or (printed.type == NOTHING and now is not None) else now
        if self.depth > 1 and now != value and isinstance(unfit, Known | TupleParts):
            raise self.refused(f"{name} is {getattr(unfit, 'value', ())!r:.40}, which no variable of C can hold under "
                               "an `if`")
        if printed.type == NOTHING:
            self.scope[name] = value
            return
        # Another tuple by the same name is another variable.
        words = [self.words.get(name, name)]
        if self.depth == self.level and self.loops == self.level - 1:
            words += [name, f"{name}_next"]
        word = next((each for each in words if self.types.join(self.kinds.get(each), printed.type)), words[0])
        kind = self.types.join(self.kinds.get(word), printed.type)
        if word != words[0]:
            self.words = {**self.words, name: word} if word != name else {
                each: self.words[each] for each in self.words if each != name}
        if kind is None:
            raise self.refused(f"{name} is once {self.kinds[word]} and once {printed.type}")
        self.kinds[word] = kind
        text = self.to(value, kind)
        if self.stores[name] != 1 or self.depth > 1 or self.loops:
            self.declared[word] = None
        self.scope[name] = Printed(kind, c_word(word))
        if isinstance(kind, Array):
            self.program.arrays[c_word(word)] = kind
        self.append(bare(text), c_word(word))

    def _If(self, line: ast.If) -> None:
        test = self.evaluate(line.test)
        if isinstance(test, Known):
            self.body(line.body if test.value else line.orelse)
            return
        self.append(f"if ({bare(self.truth(test))}) {{")
        self.inner(line.body)
        if line.orelse:
            self.append("} else {")
            self.inner(line.orelse)
        self.append("}")

    def _Return(self, line: ast.Return) -> None:
        value = Known(None) if line.value is None else self.evaluate(line.value)
        printed = self.whole(value)
        kind = self.types.join(self.gives, printed.type)
        if kind is None:
            raise self.refused(f"it returns once {self.gives} and once {printed.type}")
        self.gives = kind
        self.append("return;" if kind == NOTHING else f"return {bare(self.to(value, kind))};")

    def _While(self, line: ast.While) -> None:
        if line.orelse:
            raise self.refused("a loop with `else` has no line in C")
        self.loops += 1
        stops = self.faults
        at = len(self.lines)
        self.append("")
        self.inner(line.body)
        test = self.truth(self.evaluate(line.test))
        self.lines[at] = self.lines[at]._replace(text=f"while ({test} && !*fault) {{" if self.faults or stops
                                                 else f"while ({bare(test)}) {{")
        self.append("}")
        self.loops -= 1

    def _For(self, line: ast.For) -> None:
        if line.orelse:
            raise self.refused("a loop with `else` has no line in C")
        leaves = any(isinstance(each, ast.Break | ast.Continue) for each in ast.walk(line))
        ends = self.range_of(line.iter)
        if ends is not None and (leaves or not all(isinstance(each, Known) for each in ends)
                                 or ends[1].value - ends[0].value > 16):
            self.loop_over(line, self.to(ends[0], INT), self.to(ends[1], INT), None)
            return
        over, stored = self.evaluate(line.iter), set(map(c_word, stores([line])))
        if isinstance(over, Printed) and isinstance(over.type, Array):
            self.loop_over(line, "0", str(over.type.count), self.temporary(self.settled(over, stored)))
            return
        if leaves:
            raise self.refused("`break` and `continue` stand in a loop over a range or a tuple of like numbers")
        for each in self.parts(self.settled(over, stored)):
            self.loops += 1
            (self.assign if stores([line.target]) & stores(line.body) else self.bind)(line.target, each)
            self.body(line.body)
            self.loops -= 1
        for name in stores([line.target]) if self.depth > 1 else ():
            self.scope.pop(name, None)  # on another way it is what it was before

    def range_of(self, node: ast.expr) -> list[Value] | None:
        """The ends of a range with steps of 1."""
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) < 3
                and self.evaluate(node.func) == Known(range)):
            return None
        ends = [self.evaluate(each) for each in node.args]
        return [Known(0), *ends] if len(ends) == 1 else ends

    def loop_over(self, line: ast.For, first: str, last: str, over: Printed | None) -> None:
        """A loop that stays one: over whole numbers, or over the parts of an array."""
        self.loops += 1
        i = self.fresh("i")
        self.append(f"for (int64_t {i} = {bare(first)}, n_{i} = {bare(last)}; {i} < n_{i}; {i}++) {{")
        self.depth += 1
        if not (isinstance(line.target, ast.Name) and line.target.id == "_"):
            one = Printed(INT, i) if over is None else Printed(over.type.of, f"{over.text}.at[{i}]")
            self.assign(line.target, one)
        self.body(line.body)
        self.depth -= 1
        self.append("}")
        self.loops -= 1

    def _Break(self, line: ast.Break) -> None:
        self.append("break;")

    def _Continue(self, line: ast.Continue) -> None:
        self.append("continue;")


def needed(lines: list[Line], keep: str) -> list[Line]:
    """The lines without those that set what nothing reads; a value that may fault is still worked out."""
    while True:
        words = [words_of(line.text) for line in lines]
        lasting = words_of(keep)
        made: list[Line] = []
        for line in lines:
            is_read = line.target in lasting or any(
                line.target in names for each, names in zip(lines, words, strict=True) if each.target != line.target)
            if not line.target or is_read:
                made.append(line)
            elif "fault" in line.text:
                made.append(line._replace(text=f"(void)({line.text});", target=""))
            empty = len(made) > 1 and made[-1].text == "}" and re.fullmatch(r"(if|for) .*\{", made[-2].text)
            if empty and "fault" not in made[-2].text:
                del made[-2:]
        if made == lines:
            return made
        lines = made


def words_of(text: str) -> set[str]:
    """The names in a text of C, without those of fields."""
    return set(re.findall(r"(?<![\w.])(?<!->)[A-Za-z_]\w*", text))


def stores(nodes: Sequence[ast.AST]) -> set[str]:
    """The names that these set."""
    return {each.id for node in nodes for each in ast.walk(node)
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}


def short(file: str) -> str:
    """A file's path from the package or scene on."""
    parts = Path(file).parts
    start = max([i for i, each in enumerate(parts) if each in ("teleop", "scenarios", "master", "slave", "channel")],
                default=len(parts) - 1)
    return "/".join(parts[start:])

