"""Parser of models: from a text such as `ls*(1 + alpha*theta) + d` to a list of steps.

No part of the text is ever executed. Python's grammar gives the syntax tree. Only numbers, names, + - * / **, brackets
and the functions below are allowed; anything else is rejected with its column. The size of a model is limited.
"""

from __future__ import annotations

import ast
import keyword
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, TypeVar

from metrocli.frozen import dataclass
from metrocli.words import suggestion

LONGEST, MOST_PARTS, DEEPEST = 4096, 2000, 100
"""Largest number of characters, of operations and names, and of nested brackets"""
FUNCTIONS: dict[str, int] = dict.fromkeys(
    ("sqrt", "exp", "log", "log10", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "abs"), 1
) | {"atan2": 2}
"""Number of arguments by name."""
CONSTANTS = {"pi": math.pi}
OF_ANGLES = ("sin", "cos", "tan")
NUMBER, NAME, NEGATIVE = "number", "name", "negative"
_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_EXACT: dict[str, Callable[..., Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow,
    NEGATIVE: operator.neg, "abs": abs, **{name: getattr(math, name) for name in FUNCTIONS if name != "abs"},
}  # fmt: skip
_FOREIGN = re.compile(r"[^A-Za-z0-9_.+*/() ,\t\r\n-]")
_TOKEN = re.compile(r"[0-9][\w.]*(?:(?<=[eE])[+-][0-9]+)?|\.[0-9][\w.]*(?:(?<=[eE])[+-][0-9]+)?|[A-Za-z_]\w*|//|[(),]")
_NUMBER = re.compile(r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_PI = re.compile(r"\bpi\b")
_REASONS = {
    "^": "write ** for a power", "×": "write *", "·": "write *", "²": "write **2", "³": "write **3", "−": "write -",
    "%": "write /100", "[": "there are no lists and no subscripts", "]": "there are no lists and no subscripts",
    "{": "use round brackets", "}": "use round brackets", '"': "there is no text in a model",
    "'": "there is no text in a model", ":": "there are no functions of your own and no slices",
    "=": "a model is one expression, without assignment or comparison", "<": "there are no comparisons",
    ">": "there are no comparisons", "#": "there are no comments in a model", "@": "write *", "√": "write sqrt(...)",
}  # fmt: skip
_ALLOWED = f"allowed: names, numbers, + - * / ** ( ), pi, {', '.join(FUNCTIONS)}"

T = TypeVar("T")


class ExpressionError(ValueError):
    """Error in a model at `start` of its text (counted from 0), with a hint what to write instead."""

    def __init__(self, message: str, start: int = 0, hint: str = _ALLOWED) -> None:
        super().__init__(message)
        self.message = message
        self.start = start
        self.hint = hint


@dataclass(frozen=True)
class Operation:
    """One step of an expression: an operation on the last `arity` values, and the text it stands for."""

    operation: str
    """number, name, negative, an operator or a function"""
    arity: int
    start: int
    end: int
    number: float = 0.0
    name: str = ""


class Algebra(Protocol[T]):
    """Rules to carry out the steps of an expression, for numbers, units or derivatives."""

    def number(self, value: float) -> T:
        """Return a plain number."""

    def name(self, part: Operation) -> T:
        """Return the value of a name."""

    def apply(self, part: Operation, arguments: Sequence[T]) -> T:
        """Return the outcome of one operation."""


@dataclass(frozen=True)
class Expression:
    """A model: its text, and its steps in the order of their evaluation."""

    text: str
    parts: tuple[Operation, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names in it, once each, in the order of the text."""
        named = sorted((part for part in self.parts if part.operation == NAME), key=lambda part: part.start)
        return tuple(dict.fromkeys(part.name for part in named))

    def source(self, part: Operation) -> str:
        """Return the text of a part, shortened where it is long."""
        text = " ".join(self.text[part.start : part.end].split())
        return text if len(text) <= 60 else f"{text[:57]}..."

    def carried_out(self, algebra: Algebra[T]) -> T:
        """Return the value of the whole expression in an algebra."""
        stack: list[T] = []
        for part in self.parts:
            if part.operation == NUMBER:
                stack.append(algebra.number(part.number))
            elif part.operation == NAME:
                stack.append(algebra.name(part))
            else:
                first = len(stack) - part.arity
                stack[first:] = [algebra.apply(part, stack[first:])]
        return stack[0]


def parse(text: str) -> Expression:
    """Return the expression of a text; raises ExpressionError with the place of the first part that is not allowed."""
    _refuse_faulty(text)
    # line ends become blanks, so that an expression can continue on the next line and columns stay valid
    one_line = re.sub(r"\s", " ", text)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            body = ast.parse(f"({one_line})", mode="eval").body
    except SyntaxError as error:
        # the offset counts from 1, and from the bracket before the text
        start = min(max((error.offset or 2) - 2, 0), max(len(text) - 1, 0))
        near = f"something is missing or too much near '{text[start : start + 12].strip()}'"
        raise ExpressionError("this is not an expression", start, near) from error
    except (RecursionError, MemoryError, ValueError) as error:
        raise ExpressionError("the model is nested too deeply") from error
    return Expression(text, tuple(_folded(list(_postfix(body)), one_line)))


def _refuse_faulty(text: str) -> None:
    """Raise ExpressionError for faults that show in the text itself, which limits the work of the parser."""
    if len(text) > LONGEST:
        message = f"the model has {len(text)} characters, at most {LONGEST} are allowed"
        raise ExpressionError(message, LONGEST, "write it as several shorter ones")
    foreign = _FOREIGN.search(text)
    if foreign:
        character = foreign[0]
        hint = _REASONS.get(character, _ALLOWED)
        raise ExpressionError(f"'{character}' cannot stand in a model", foreign.start(), hint)
    if not text.strip():
        raise ExpressionError("there is no model", 0)
    open_brackets: list[int] = []
    count = 0
    for match in _TOKEN.finditer(text):
        token, start = match[0], match.start()
        count += token not in "(),"
        if token == "(":
            open_brackets.append(start)
        if token == ")":
            if not open_brackets:
                raise ExpressionError("this bracket has no opening bracket", start, "a '(' is missing before it")
            open_brackets.pop()
        if len(open_brackets) > DEEPEST:
            raise ExpressionError(f"more than {DEEPEST} brackets within each other", start)
        if token == "//":
            raise ExpressionError("'//' cannot stand in a model", start, "write / for a division")
        if keyword.iskeyword(token):
            raise ExpressionError(f"'{token}' cannot stand in a model", start)
        if "__" in token and (token[0].isalpha() or token[0] == "_"):
            raise ExpressionError(f"'{token}' cannot stand in a model", start, "write names without double underscores")
        if (token[0].isdigit() or token[0] == ".") and not _NUMBER.fullmatch(token):
            raise ExpressionError(f"'{token}' is not a number", start, "write e.g. 2*x, 1000 or 1e3")
    if open_brackets:
        raise ExpressionError("this bracket is not closed", open_brackets[-1], "a ')' is missing after it")
    if count > MOST_PARTS:
        raise ExpressionError(f"the model has more than {MOST_PARTS} numbers and names")


def _postfix(body: ast.expr) -> Iterator[Operation]:
    """Yield the steps of a tree, arguments before their operation, without recursion."""
    waiting: list[tuple[ast.expr, bool]] = [(body, False)]
    """Nodes, each with whether its arguments have been yielded"""
    count = 0
    while waiting:
        node, ready = waiting.pop()
        # columns count from the bracket before the text
        start, end = max(node.col_offset - 1, 0), (node.end_col_offset or 1) - 1
        count += 1
        # an operation comes up twice, before its arguments and after them, and a number or a name once
        if count > 3 * MOST_PARTS:
            raise ExpressionError(f"the model has more than {MOST_PARTS} operations", start)
        operation, arguments = _operation(node)
        if ready or not arguments:
            yield Operation(operation, len(arguments), start, end) if arguments else _leaf(node, start, end)
        else:
            waiting.append((node, True))
            waiting.extend((argument, False) for argument in reversed(arguments))


def _leaf(node: ast.expr, start: int, end: int) -> Operation:
    """Return the step of a number or a name."""
    if isinstance(node, ast.Constant):
        return Operation(NUMBER, 0, start, end, number=_finite(node, start))
    name = _dotted(node)
    if name in CONSTANTS:
        return Operation(NUMBER, 0, start, end, number=CONSTANTS[name])
    return Operation(NAME, 0, start, end, name=name)


def _finite(node: ast.Constant, start: int) -> float:
    value = node.value
    # True is an int in Python
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ExpressionError(f"{value!r} cannot stand in a model", start)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ExpressionError("the number is too large", start)
    return number


def _operation(node: ast.expr) -> tuple[str, list[ast.expr]]:
    """Return the operation of a node and its arguments; a number or a name has no arguments."""
    start = max(node.col_offset - 1, 0)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        return _OPERATORS[type(node.op)], [node.left, node.right]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        return (NEGATIVE if isinstance(node.op, ast.USub) else "positive"), [node.operand]
    if isinstance(node, ast.Call):
        return _called(node, start)
    if isinstance(node, ast.Name | ast.Constant):
        if isinstance(node, ast.Name) and node.id in FUNCTIONS:
            raise ExpressionError(f"the function {node.id} has no argument", start, f"write {node.id}(...)")
        return "", []
    if isinstance(node, ast.Attribute) and _dotted(node):
        return "", []
    what = {"Attribute": "access to a part of a value", "Tuple": "a list of values", "Starred": "a star before a value"}
    raise ExpressionError(f"{what.get(type(node).__name__, type(node).__name__)} cannot stand in a model", start)


def _called(node: ast.Call, start: int) -> tuple[str, list[ast.expr]]:
    name = _dotted(node.func)
    if name not in FUNCTIONS:
        what = f"unknown function '{name}'" if name else "only a function can be followed by a bracket"
        hint = suggestion(name, FUNCTIONS) if name else "write * for a product"
        raise ExpressionError(what, start, hint)
    if len(node.args) != FUNCTIONS[name] or node.keywords:
        needs = f"{name} takes {FUNCTIONS[name]} argument{'s' if FUNCTIONS[name] > 1 else ''}"
        raise ExpressionError(f"{needs}, not {len(node.args) + len(node.keywords)}", start, f"write {name}(...)")
    return name, node.args


def _dotted(node: ast.expr) -> str:
    """Return `part.x` for a name with dots in it, "" for anything else."""
    names: list[str] = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return ".".join([node.id, *reversed(names)]) if isinstance(node, ast.Name) else ""


def _folded(parts: list[Operation], text: str) -> Iterator[Operation]:
    """Yield the steps with every operation on plain numbers carried out; rejects overflows such as 9**9**9**9."""
    stack: list[list[Operation]] = []
    """The steps of each value on the stack"""
    for part in parts:
        if part.arity == 0:
            stack.append([part])
            continue
        arguments = stack[-part.arity :]
        del stack[-part.arity :]
        if part.operation == "positive":
            stack.append(arguments[0])
        elif all(argument[-1].operation == NUMBER for argument in arguments):
            last = arguments[0][-1]
            _refuse_degrees(part, last.number, text[last.start : last.end])
            value = _of_numbers(part, [argument[-1].number for argument in arguments])
            stack.append([Operation(NUMBER, 0, part.start, part.end, number=value)])
        else:
            stack.append([step for argument in arguments for step in argument] + [part])
    yield from stack[0]


def _refuse_degrees(part: Operation, angle: float, written: str) -> None:
    """Raise ExpressionError for a sine, cosine or tangent of plain numbers without pi that are more than a turn."""
    if part.operation in OF_ANGLES and abs(angle) > 2 * math.pi and not _PI.search(written):
        of = f"{part.operation}({written if _NUMBER.fullmatch(written.removeprefix('-')) else f'({written})'}"
        hint = f"write {of}*pi/180) for degrees, {of}-2*pi) for radians"
        raise ExpressionError(f"{part.operation} takes radians, and {written} is more than a turn", part.start, hint)


def _of_numbers(part: Operation, numbers: Sequence[float]) -> float:
    try:
        value = _EXACT[part.operation](*numbers)
    except (ArithmeticError, ValueError):
        value = math.nan
    if isinstance(value, complex) or not math.isfinite(value):
        raise ExpressionError("this has no finite value", part.start, "numbers reach from 1e-308 to 1e308")
    return float(value)
