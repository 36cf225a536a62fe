"""Models as text: what is refused and where; values, derivatives and units of what is taken."""

from __future__ import annotations

import math
import random
import string

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metrocli import units
from metrocli.expressions.derivatives import Jets
from metrocli.expressions.dimensions import base_unit, compound, converted, unit_of
from metrocli.expressions.expression import DEEPEST, FUNCTIONS, LONGEST, ExpressionError, parse
from metrocli.uncertainty.numbers import evaluate

REFUSED = [
    ("9**9**9**9", 3, "no finite value"), ("x + 9**9**9**9", 7, "no finite value"), ("open(x)", 0, "unknown function 'open'"),
    ("open('/etc/passwd')", 5, "cannot stand"), ("a + x.__class__", 6, "cannot stand"), ("__import__(os)", 0, "cannot stand"),
    ("import os", 0, "'import'"), ("lambda x: x", 8, "':'"), ("(lambda)", 1, "'lambda'"), ("x[0]", 1, "'['"), ("(a+b).real", 0, "part of a value"),
    ("sqrt(x).real", 0, "part of a value"), ("(" * 10_000 + ")" * 10_000, LONGEST, "characters"), ("a+" * 500_000 + "a", LONGEST, "characters"),
    ("(" * 150 + "x" + ")" * 150, DEEPEST, "brackets"), ("-" * 4000 + "x", 0, "deeply"), ("exec(x)", 0, "unknown function"), ("x if y else z", 2, "'if'"),
    ("a and b", 2, "'and'"), ("a < b", 2, "'<'"), ("a = b", 2, "'='"), ("x^2", 1, "'^'"), ("2x", 0, "not a number"), ("0x10", 0, "not a number"),
    ("3j", 0, "not a number"), ("1_000", 0, "not a number"), ("1e999", 0, "too large"), ("9" * 4000, 0, "too large"), ("x//2", 1, "'//'"), ("x % 2", 2, "'%'"),
    ("sqrt(x, y)", 0, "1 argument"), ("atan2(x)", 0, "2 arguments"), ("sqrt", 0, "no argument"), ("f(*x)", 0, "unknown function"), ("True", 0, "'True'"),
    ("x, y", 0, "list of values"), ("a b", 0, "not an expression"), ("a..b", 2, "not an expression"), ("", 0, "no model"), ("()", 0, "list of values"),
    ("1/0", 0, "no finite value"), ("sqrt(-1)*x", 0, "no finite value"), ("{x}", 0, "'{'"), ("x;y", 1, "';'"), ("x := 3", 2, "':'"), ("f'{x}'", 1, "cannot stand"),
    ("max(a, b)", 0, "unknown function"), ("a @ b", 2, "'@'"), ("~a", 0, "'~'"), ("not a", 0, "'not'"), ("x\0", 1, "cannot stand"), ("\u2212x", 0, "cannot stand"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "start", "message"), REFUSED, ids=lambda value: str(value)[:20])
def test_refused_with_its_column(text: str, start: int, message: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        parse(text)
    assert (caught.value.start, message in caught.value.message) == (start, True), (
        caught.value.start,
        caught.value.message,
    )
    assert caught.value.hint


PIECES = [
    *FUNCTIONS, "pi", "x", "y", "part.x", "9", "1e3", "0.5", "(", ")", "(", ")", "+", "-", "*", "/", "**", "**", ",", " ", ".", "\n", "__", "lambda", "[", "1e300", "e", "--",
]  # fmt: skip


@pytest.mark.parametrize("count", [4_000, pytest.param(20_000, marks=pytest.mark.slow)])
def test_random_texts_are_taken_or_refused(count: int) -> None:
    rng = random.Random(1)
    taken = 0
    values = {"x": np.array([0.3, -2.0]), "y": np.array([1.5, 0.0]), "part.x": np.array([2.0, 1e200])}
    for n in range(count):
        if n % 10 == 0:
            text = "".join(rng.choices(string.printable + "µ²·", k=rng.randint(1, 60)))
        elif n % 2:
            text = _grown(rng, rng.randint(1, 6))
        else:
            text = "".join(rng.choices(PIECES, k=rng.randint(1, 25)))
        try:
            expression = parse(text)
            if set(expression.names) <= set(values):
                taken += 1
                value = evaluate(expression, values)
                assert np.shape(value) in ((), (2,))
        except ExpressionError as error:
            assert 0 <= error.start <= max(len(text), 1)
    assert taken > count / 5


def test_derivatives_of_random_models_are_there_or_refused() -> None:
    rng = random.Random(5)
    taken = 0
    for _ in range(500):
        try:
            model = parse(_grown(rng, rng.randint(1, 6)))
            for values in ({"x": 0.0, "y": 1.0, "part.x": 2.0}, {"x": -1.5, "y": 0.0, "part.x": 1e200}):
                jet = model.carried_out(Jets(model, ["x", "y", "part.x"], values, 3, np.ones(3)))
                assert np.isfinite(jet.value) and np.isfinite(jet.gradient).all() and np.isfinite(jet.hessian).all()
                taken += 1
        except ExpressionError as error:
            assert error.hint
    assert taken > 170


def _grown(rng: random.Random, depth: int) -> str:
    """A sound expression."""
    if depth == 0:
        return rng.choice(["x", "y", "part.x", "2", "0.5", "1e3", "pi"])
    kind = rng.random()
    if kind < 0.3:
        name = rng.choice(list(FUNCTIONS))
        return f"{name}({', '.join(_grown(rng, depth - 1) for _ in range(FUNCTIONS[name]))})"
    if kind < 0.4:
        return f"-{_grown(rng, depth - 1)}"
    return f"({_grown(rng, depth - 1)}{rng.choice(['+', '-', '*', '/', '**'])}{_grown(rng, rng.randint(0, depth - 1))})"


VALUES = [
    ("1 + 2*3**2", 19.0), ("-2**2", -4.0), ("2**-1", 0.5), ("(1 +\n 2)", 3.0), ("2**3**2", 512.0), ("7 - 2 - 1", 4.0), ("8/4/2", 1.0), ("atan2(1, -1)", 3 * math.pi / 4),
    ("log10(1000)", 3.0), ("log(exp(2))", 2.0), ("abs(-3)", 3.0), ("+3", 3.0), ("pi", math.pi), ("tanh(0.5)", math.tanh(0.5)), (".5e1", 5.0), ("sinh(1) + cosh(1)", math.e),
]  # fmt: skip


@pytest.mark.parametrize(("text", "value"), VALUES)
def test_values(text: str, value: float) -> None:
    assert evaluate(parse(text), {}) == pytest.approx(value, rel=1e-15)
    shifted = parse(f"x*0 + {text}")
    assert evaluate(shifted, {"x": np.array([1.0, 2.0])}) == pytest.approx([value, value], rel=1e-15)


SMOOTH = [
    "a*b*c", "a/b**2", "sqrt(a*b) + c**3", "atan2(a - 2, b)*c", "atan2(-a, -b - c)", "exp(-a)*sin(b)/c", "a**b*log10(c)", "tan(a)*asin(b/3) + acos(c/4)*atan(a*b)",
    "sinh(a)*cosh(b)*tanh(c)", "abs(-a*b) + log(c)*2**a", "-a**0.5", "(a*b - c)**2", "1/(a + b + c)",
]  # fmt: skip


@pytest.mark.parametrize("text", SMOOTH)
def test_derivatives_are_those_of_differences(text: str) -> None:
    rng = np.random.default_rng(3)
    names, at, along, h = ["a", "b", "c"], rng.uniform(0.5, 1.5, 3), rng.normal(size=3), 1e-5
    model = parse(text)

    def jet(x: np.ndarray) -> object:
        return model.carried_out(Jets(model, names, dict(zip(names, x, strict=True)), 3, along))

    here = jet(at)
    steps = h * np.eye(3)
    slope = [(jet(at + s).value - jet(at - s).value) / (2 * h) for s in steps]
    bend = [(jet(at + s).gradient - jet(at - s).gradient) / (2 * h) for s in steps]
    third = (jet(at + h * along).hessian - jet(at - h * along).hessian) / (2 * h)
    assert here.gradient == pytest.approx(np.array(slope), rel=1e-7, abs=1e-8)
    assert here.hessian == pytest.approx(np.array(bend), rel=1e-6, abs=1e-7)
    assert here.along == pytest.approx(third, rel=1e-6, abs=1e-6)


def test_derivatives_at_many_points_at_once() -> None:
    model = parse("x*sin(b*x) + b**2")
    x = np.linspace(0, 2, 7)
    jet = model.carried_out(Jets(model, ["b"], {"b": 0.7, "x": x}, order=1))
    assert jet.gradient[0] == pytest.approx(x * x * np.cos(0.7 * x) + 1.4, rel=1e-14)


@pytest.mark.parametrize("text", ["sqrt(x)", "abs(x)", "x**0.5", "atan2(x, x)"])
def test_no_derivative_is_told(text: str) -> None:
    model = parse(text)
    with pytest.raises(ExpressionError):
        model.carried_out(Jets(model, ["x"], {"x": 0.0}))


UNITS = [
    ("mm", "mm", 1.0), ("nm", "mm", 1e-6), ("kg/m^3", "kg mm-3", 1e-9), ("mPa s", "kg mm-1 s-1", 1e-6), ("1/K", "K-1", 1.0), ("um/m/K", "K-1", 1e-6), ("V/A", "A-2 kg mm2 s-3", 1e6),
    ("kg m2 s-2", "kg mm2 s-2", 1e6), ("N m", "kg mm2 s-2", 1e6), ("%", "1", 0.01), ("m²", "mm2", 1e6), ("GHz", "s-1", 1e9), ("pF ohm", "s", 1e-12), ("W/m^2", "kg s-3", 1.0),
]  # fmt: skip


@pytest.mark.parametrize(("text", "base", "factor"), UNITS)
def test_units_of_products(text: str, base: str, factor: float) -> None:
    unit = compound(text)
    assert base_unit(unit.powers) == base
    assert unit.factor == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("text", ["xx", "m/", "mm^99", "11", "degC/min", "kg m^", "mm$"])
def test_other_units_are_refused(text: str) -> None:
    with pytest.raises(units.QuantityError) as caught:
        compound(text)
    assert caught.value.hint


def test_a_value_in_another_unit() -> None:
    assert converted(12.0, "um", "mm") == pytest.approx(0.012)
    with pytest.raises(units.QuantityError):
        converted(1.0, "kg", "mm")


NAMES = {"l": "mm", "a": "1/K", "dt": "K", "t": "degC", "t0": "degC", "m": "kg", "n": "", "phi": "deg"}
SOUND = [
    ("l*(1 + a*dt)", "mm"), ("l*(1 + a*(t - t0))", "mm"), ("t + dt", "K"), ("sqrt(l**2 + l*l)", "mm"), ("l**n/l**n", None), ("atan2(l, l)", "1"), ("sin(phi)*m", "kg"),
    ("n**n", "1"), ("l**0.5*l**(1/2)", "mm"), ("exp(n) + 1", "1"), ("abs(-l)", "mm"), ("l**-2", "mm-2"),
]  # fmt: skip
UNSOUND = [
    ("l + m", 4, "'l' is a length, 'm' is a mass"), ("l*(1 + a*dt) + m", 15, "'m' is a mass"), ("l + 3", 0, "3 is a plain number"), ("sin(l)", 4, "argument of sin"),
    ("exp(2*dt)", 4, "argument of exp"), ("a*t", 2, "differences"), ("t + t0", 4, "differences"), ("dt - t", 5, "differences"), ("2*t", 2, "differences"), ("l**dt", 3, "exponent"),
    ("l**n", 0, "not a plain number"), ("atan2(l, m)", 9, "cannot be added or compared"), ("l**0.3333", 0, "0.3333"), ("1 + a", 4, "coefficient of expansion"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "unit"), SOUND)
def test_units_of_models(text: str, unit: str | None) -> None:
    known = {name: compound(symbol) for name, symbol in NAMES.items()}
    if unit is None:
        with pytest.raises(ExpressionError):
            unit_of(parse(text), known)
    else:
        assert base_unit(unit_of(parse(text), known).powers) == unit


@pytest.mark.parametrize(("text", "start", "message"), UNSOUND)
def test_terms_that_do_not_fit_are_named(text: str, start: int, message: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        unit_of(parse(text), {name: compound(symbol) for name, symbol in NAMES.items()})
    assert caught.value.start == start
    assert message in caught.value.message


@given(
    st.floats(-1e6, 1e6),
    st.sampled_from(
        [
            unit.symbol
            for d in units.DIMENSIONS.values()
            for unit in d.units
            if not unit.offset and unit.symbol != "degC"
        ]
    ),
)
def test_every_unit_of_the_table_is_one_of_the_algebra(value: float, symbol: str) -> None:
    assert converted(converted(value, symbol, symbol), symbol, symbol) == pytest.approx(value, rel=1e-12)
    assert math.isfinite(compound(symbol).factor)


def test_degrees_in_a_sine_are_refused() -> None:
    """The sine of 30 is that of 30 radians: a budget took -0.988 for 0.5 without a word."""
    for name in ("sin", "cos", "tan"):
        with pytest.raises(ExpressionError, match="takes radians, and 30 is more than a turn"):
            parse(f"2*{name}(30)")
    for angle in ("-30", "30.1234567"):
        with pytest.raises(ExpressionError) as caught:
            parse(f"1 + sin({angle})")
        assert caught.value.hint == f"write sin({angle}*pi/180) for degrees, sin({angle}-2*pi) for radians"
        assert parse(f"sin({angle}-2*pi)")
    assert parse("sin(30*pi/180) + sin(0.5) + exp(30) + cos(2*pi*3)")
    for angle in ("30*1", "15 + 15", "3e1"):
        with pytest.raises(ExpressionError, match="is more than a turn"):
            parse(f"cos({angle})")
