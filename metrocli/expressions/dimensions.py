"""Units of whole expressions such as "kg/m^3", and the unit of a model from the units of its inputs.

Values are stored in mm, s, kg, A, K, px, mol, cd; angles are plain numbers (rad). A temperature in degC is a point on a
scale: two of them can be subtracted, and a difference in K can be added. No other operation is allowed.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache

from metrocli import units
from metrocli.expressions.expression import NEGATIVE, NUMBER, OF_ANGLES, Expression, ExpressionError, Operation
from metrocli.frozen import dataclass

Powers = tuple[tuple[str, Fraction], ...]
_ATOM = re.compile(r"\s*(1(?![0-9])|[A-Za-zµμΩΩ°%]+)\s*(?:(?:\^|\*\*)?\s*(-?[0-9]+)|([²³]))?\s*([/*·]?)")
_STATED = re.compile(r"[0-9.]\s*([A-Za-zµμΩΩ°%1][^,{}\[\]'\"]*)")
"""What follows a number up to the next sign of YAML"""
_SUPERSCRIPTS = {"²": 2, "³": 3}
_TEMPERATURE: Powers = (("K", Fraction(1)),)


@dataclass(frozen=True)
class Compound:
    """A product of units: value in base units = number * factor; a point in degC stays in degC."""

    text: str
    factor: float
    powers: Powers
    point: bool = False

    @property
    def number(self) -> bool:
        """Whether this is the unit of a plain number."""
        return not self.powers


_LEAST_FACTOR = 0.1
"""Least factor of a name in an angle: a smaller one, as 0.01745, is that of a unit"""


def angles(expression: Expression) -> Iterator[tuple[Operation, str, float]]:
    """Yield each sine, cosine or tangent of a multiple of one name, with that name and the multiple.

    What has pi in it, as `sin(b*pi/180)`, is no plain number of another unit.
    """
    found: list[tuple[Operation, str, float]] = []
    expression.carried_out(_Multiples(expression, found))
    yield from found


@dataclass(frozen=True)
class _Multiples:
    """Multiples of names, each as its name and the factor; a number has no name, and another value no such pair."""

    expression: Expression
    found: list[tuple[Operation, str, float]]
    """Angles that are such multiples"""

    def number(self, value: float) -> tuple[str, float] | None:
        return "", value

    def name(self, part: Operation) -> tuple[str, float] | None:
        return part.name, 1.0

    def apply(self, part: Operation, arguments: Sequence[tuple[str, float] | None]) -> tuple[str, float] | None:
        first, second = arguments[0], arguments[-1]
        if first is None or second is None:
            return None
        (name, factor), (other, by) = first, second
        if part.operation == NEGATIVE:
            return name, -factor
        if part.operation == "*" and not (name and other):
            return name or other, factor * by
        if part.operation == "/" and not other and by:
            return name, factor / by
        plain = "pi" not in re.findall(r"\w+", self.expression.source(part))
        if part.operation in OF_ANGLES and name and plain and abs(factor) >= _LEAST_FACTOR:
            self.found.append((part, name, factor))
        return None


@lru_cache(1024)
def compound(text: str) -> Compound:
    """Return the unit of a text such as "kg/m^3", "mPa s" or "1/K"; raises QuantityError if it is not a unit."""
    text = text.strip()
    if units.plain_symbol(text) == "degC":
        return Compound("degC", 1.0, _TEMPERATURE, point=True)
    factor, powers = 1.0, dict[str, Fraction]()
    over, at = False, 0
    while at < len(text):
        match = _ATOM.match(text, at)
        if match is None or match.end() == at:
            raise units.QuantityError(f"'{text}' is not a unit", "write e.g. 'mm', 'kg/m^3', 'mPa s' or '1/K'")
        exponent = int(match[2] or _SUPERSCRIPTS.get(match[3] or "", 1)) * (-1 if over else 1)
        if abs(exponent) > 20:
            raise units.QuantityError(f"'{text}' is not a unit", "powers of a unit reach from -20 to 20")
        times, of = (1.0, ()) if match[1] == "1" else _atom(match[1], text)
        factor *= times**exponent
        for base, power in of:
            powers[base] = powers.get(base, Fraction(0)) + power * exponent
        over, at = match[4] == "/", match.end()
        if at == len(text) and match[4]:
            raise units.QuantityError(f"'{text}' ends in '{match[4]}'", "write e.g. 'kg/m^3'")
    return Compound(text or "1", factor, _sorted(powers))


def _atom(symbol: str, whole: str) -> tuple[float, Powers]:
    """Return the value of one unit in base units, and its powers of the base units."""
    plain = units.plain_symbol(symbol)
    for dimension in units.DIMENSIONS.values():
        for unit in dimension.units:
            if unit.symbol == plain and not unit.offset and plain != "degC":
                internal = 1.0 if units.internal_unit(dimension.name) == "1" else dimension.coherent
                return unit.times / unit.over * internal, _powers(dimension.powers)
    if plain == "degC":
        raise units.QuantityError(f"'{whole}' has degC in a compound", "a difference of temperature is in K")
    known = tuple({unit.symbol for dimension in units.DIMENSIONS.values() for unit in dimension.units})
    if units.is_inch(plain):
        hint = f"write the length in mm: 1 inch is {units.INCH} mm"
        raise units.QuantityError(f"'{symbol}' is the inch, which files cannot use", hint)
    raise units.QuantityError(f"unknown unit '{symbol}'", units.unit_meant(plain, known) or "see docs/conventions.md")


def _powers(text: str) -> Powers:
    powers = {}
    for word in text.split():
        match = re.fullmatch(r"([A-Za-z]+)(-?[0-9]*)", word)
        assert match is not None, word
        powers[match[1]] = Fraction(int(match[2] or 1))
    return _sorted(powers)


def _sorted(powers: Mapping[str, Fraction]) -> Powers:
    return tuple(sorted((base, power) for base, power in powers.items() if power))


def converted(value: float, unit: str, into: str) -> float:
    """Return a value in another unit; raises QuantityError if the units are of different kinds."""
    from_, to = compound(unit), compound(into)
    if from_.powers != to.powers or from_.point != to.point:
        raise units.QuantityError(f"'{unit}' is {described(from_)}, '{into}' {described(to)}", f"write it in {into}")
    return value * from_.factor / to.factor


def written(text: str, unit: str, word: str) -> Compound | None:
    """Return the unit of the kind of `unit` in which the lines of a text with a word state quantities, or None."""
    wanted = compound(unit).powers
    for line in (line.partition("#")[0] for line in text.splitlines()):
        for symbol in _STATED.findall(line) if re.search(rf"\b{re.escape(word)}\b", line) else ():
            try:
                known = compound(symbol)
            except units.QuantityError:
                continue
            if known.powers == wanted:
                return known
    return None


def described(unit: Compound) -> str:
    """Return the kind of quantity of a unit in words: "a length", "a plain number", "a quantity in kg mm-3"."""
    if unit.point:
        return "a temperature on a scale (degC)"
    if unit.number:
        return "a plain number"
    named = {"temperature difference": "a temperature difference"}
    for dimension in units.DIMENSIONS.values():
        if _powers(dimension.powers) == unit.powers and dimension.name not in ("wavelength", "temperature"):
            return named.get(dimension.name, dimension.phrase)
    return f"a quantity in {base_unit(unit.powers)}"


def base_unit(powers: Powers) -> str:
    """Return powers of the base units as text: "kg mm-3"."""
    return " ".join(f"{base}{power if power != 1 else ''}" for base, power in powers) or "1"


@dataclass(frozen=True)
class _Traced:
    unit: Compound
    part: Operation
    constant: float | None = None


@dataclass(frozen=True)
class _Units:
    """The algebra of units."""

    expression: Expression
    names: Mapping[str, Compound]

    def number(self, value: float) -> _Traced:
        return _Traced(Compound("1", 1.0, ()), Operation(NUMBER, 0, 0, 0, number=value), value)

    def name(self, part: Operation) -> _Traced:
        return _Traced(self.names[part.name], part)

    def apply(self, part: Operation, arguments: Sequence[_Traced]) -> _Traced:
        first, second = arguments[0], arguments[-1]
        if part.operation in ("+", "-"):
            return _Traced(self._sum(part, first, second), part)
        for argument in arguments:
            self._refuse_point(argument)
        return _Traced(self._other(part, first, second), part)

    def _other(self, part: Operation, first: _Traced, second: _Traced) -> Compound:
        operation = part.operation
        if operation in (NEGATIVE, "abs"):
            return first.unit
        if operation in ("*", "/"):
            return _times(first.unit, second.unit, 1 if operation == "*" else -1)
        if operation == "sqrt":
            return _to_the(first.unit, Fraction(1, 2))
        if operation == "**":
            return self._raised(first, second)
        if operation == "atan2":
            self._same(first, second)
            return Compound("1", 1.0, ())
        self._refuse_unit(first, f"the argument of {operation}")
        return Compound("1", 1.0, ())

    def _sum(self, part: Operation, first: _Traced, second: _Traced) -> Compound:
        """Return the unit of a sum: point - point gives a difference, point + difference gives a point."""
        if first.unit.powers != second.unit.powers:
            self._same(first, second)
        a, b = first.unit, second.unit
        if part.operation == "-":
            if b.point and not a.point:
                self._refuse_point(second)
            return Compound("", 1.0, a.powers, point=a.point and not b.point)
        if a.point and b.point:
            self._refuse_point(second)
        return Compound("", 1.0, a.powers, point=a.point or b.point)

    def _raised(self, base: _Traced, exponent: _Traced) -> Compound:
        self._refuse_unit(exponent, "an exponent")
        if base.unit.number:
            return base.unit
        if exponent.constant is None:
            message = f"{self._description(base)} is raised to a power that is not a plain number"
            raise ExpressionError(message, base.part.start, "only a plain number can have an uncertain exponent")
        power = Fraction(exponent.constant).limit_denominator(60)
        if abs(float(power) - exponent.constant) > 1e-12 or abs(power) > 20:
            message = f"{self._description(base)} is raised to the power {exponent.constant:g}"
            raise ExpressionError(message, base.part.start, "the power of a unit is a small whole number or a fraction")
        return _to_the(base.unit, power)

    def _same(self, first: _Traced, second: _Traced) -> None:
        if first.unit.powers != second.unit.powers:
            message = f"{self._description(first)}, {self._description(second)}: they cannot be added or compared"
            raise ExpressionError(message, self._start(second, first), "each term of a sum has the same unit")

    def _start(self, second: _Traced, first: _Traced) -> int:
        return second.part.start if second.constant is None else first.part.start

    def _refuse_unit(self, argument: _Traced, what: str) -> None:
        if not argument.unit.number:
            message = f"{self._description(argument)}, but {what} is a plain number or an angle"
            raise ExpressionError(message, argument.part.start, "divide it by a quantity of the same unit")

    def _refuse_point(self, argument: _Traced) -> None:
        if argument.unit.point:
            message = f"{self._description(argument)}: only differences of such temperatures can be used"
            hint = "subtract a reference such as t0: 20 degC, or give the difference in K"
            raise ExpressionError(message, argument.part.start, hint)

    def _description(self, traced: _Traced) -> str:
        if traced.constant is not None:
            return f"{traced.constant:g} is a plain number"
        return f"'{self.expression.source(traced.part)}' is {described(traced.unit)}"


def _times(a: Compound, b: Compound, sign: int) -> Compound:
    powers = dict(a.powers)
    for base, power in b.powers:
        powers[base] = powers.get(base, Fraction(0)) + sign * power
    return Compound("", 1.0, _sorted(powers))


def _to_the(a: Compound, power: Fraction) -> Compound:
    return Compound("", 1.0, tuple((base, has * power) for base, has in a.powers if has * power))


def unit_of(expression: Expression, names: Mapping[str, Compound]) -> Compound:
    """Return the unit of a model in base units; raises ExpressionError if its terms have different units."""
    return expression.carried_out(_Units(expression, names)).unit
