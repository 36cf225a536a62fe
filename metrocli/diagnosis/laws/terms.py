"""Terms of a law: what is added to a component of a quantity, as columns of numbers and as text.

Method: docs/algorithms/laws.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass

WAVES, SATURATIONS, STEPS = "waves", "saturations", "steps"
"""Forms with a scanned value: their period, time constant or place"""
_ANGLES = ("azimuth", "angle", "base")
"""Variables that go round: harmonics of them are tried, and the angle itself, but no higher powers"""
_SIDE = "from_"
"""Begin of the variables that are directions of approach"""
_HARMONICS, _POWERS = 4, 3
_FEWEST_STEPS = 6
"""Fewest different values of a variable of which waves are tried"""


@dataclass(frozen=True)
class TermForm:
    """One form of a term: the texts of its factors, in which `{s}` stands for the scanned value."""

    kind: str
    factors: tuple[str, ...]
    variables: tuple[str, ...]
    scanned: float | None = None

    @property
    def text(self) -> str:
        """Its factors, with the scanned value in them."""
        return " and ".join(self.factors).replace("{s}", "" if self.scanned is None else f"{self.scanned:.4g}")

    def powers_of(self) -> dict[str, int]:
        """Return how often each variable is a factor with its unit; none in sines, exponentials and steps."""
        if self.kind in ("powers", "direction", "products"):
            return {name: self.variables.count(name) for name in self.variables}
        return {}


def goes_round(variable: str) -> bool:
    """Return whether a variable is an angle that begins again after a turn, by its name."""
    return variable in _ANGLES


def powers_are_tried(variable: str) -> bool:
    """Return whether waves and all powers of a variable are tried, by its name; of an angle only the first power is."""
    return not goes_round(variable) and not variable.startswith(_SIDE)


def _order(factor: str) -> int:
    head = factor.partition("(")[2].partition("*")
    return int(head[0]) if head[1] else 1


def columns_of(forms: Sequence[TermForm], values: Mapping[str, Array]) -> Array:
    """Return the factors of forms of one kind as columns, (rows, forms, factors), from the variables (rows,).

    A constant has one row, whatever their number.
    """
    kind = forms[0].kind
    if kind == "constant":
        return np.ones((1, len(forms), 1))
    if kind not in (WAVES, SATURATIONS, STEPS, "harmonics"):
        products = [np.prod([values[name] for name in form.variables], axis=0) for form in forms]
        return np.stack(products, axis=1)[:, :, None]
    v = np.stack([values[form.variables[0]] for form in forms], axis=1)
    if kind == "harmonics":
        turn = v * [_order(form.factors[0]) for form in forms]
        return np.stack([np.sin(turn), np.cos(turn)], axis=2)
    s = np.array([form.scanned for form in forms], dtype=float)
    if kind == WAVES:
        turn = 2 * np.pi * v / s
        return np.stack([np.sin(turn), np.cos(turn)], axis=2)
    return np.asarray(1 - np.exp(-v / s) if kind == SATURATIONS else (v > s).astype(float))[:, :, None]


def forms_of(values: Mapping[str, Array], elapsed: Mapping[str, Array], periods: int) -> Iterator[TermForm]:
    """Yield all forms in some variables (rows,); `elapsed` are those that begin at 0 and grow, such as the time.

    At most `periods` periods are tried for each variable, from one over its range to that many halves.
    """
    yield TermForm("constant", ("1",), ())
    smooth = [name for name in values if powers_are_tried(name)]
    for name in values:
        if goes_round(name):
            for order in range(1, _HARMONICS + 1):
                turn = f"{order}*{name}" if order > 1 else name
                yield TermForm("harmonics", (f"sin({turn})", f"cos({turn})"), (name,))
            # what winds up, such as a cable, or a wrong scale of an encoder
            yield TermForm("powers", (name,), (name,))
        elif name.startswith(_SIDE):
            yield TermForm("direction", (name,), (name,))
    for name in smooth:
        for power in range(1, _POWERS + 1):
            yield TermForm("powers", (f"{name}**{power}" if power > 1 else name,), (name,) * power)
        yield from _waves(name, values[name], periods)
    yield from (
        TermForm("products", (f"{a}*{b}",), (a, b)) for a, b in combinations(values, 2) if {a, b} - set(_ANGLES)
    )
    for name, times in elapsed.items():
        yield from _saturations(name, times)
        yield from _steps(name, times)


def turns_of(values: Array, periods: int) -> Array:
    """Return how many waves over the range of a variable (rows,) are tried: half a wave apart, which misses none."""
    steps = len(np.unique(values))
    # fewer than half a wave for each step of the variable: beyond that two waves have the same values
    return np.arange(1.0, min((steps - 1) / 2, periods / 2 + 0.5) + 0.1, 0.5) if steps >= _FEWEST_STEPS else np.zeros(0)


def _waves(name: str, values: Array, periods: int) -> Iterator[TermForm]:
    """Yield sine and cosine of a variable, with each period."""
    texts, span = (f"sin(2*pi*{name}/{{s}})", f"cos(2*pi*{name}/{{s}})"), float(np.ptp(values))
    yield from (TermForm(WAVES, texts, (name,), span / turns) for turns in turns_of(values, periods).tolist())


def _saturations(name: str, values: Array) -> Iterator[TermForm]:
    span = float(np.ptp(values))
    if span > 0:
        # below a hundredth of the span it is a step at the begin, above the span a straight line
        for constant in np.geomspace(span / 100, span, 30):
            yield TermForm(SATURATIONS, (f"(1 - exp(-{name}/{{s}}))",), (name,), float(constant))


def _steps(name: str, values: Array) -> Iterator[TermForm]:
    unique = np.unique(values)
    # between two values: at a value, the expression of the step would be 0 / 0
    middles = (unique[1:] + unique[:-1]) / 2
    kept = middles[np.unique(np.linspace(0, len(middles) - 1, 80).astype(int))] if len(middles) else middles
    for at in kept.tolist():
        yield TermForm(STEPS, (f"(1 + ({name} - {{s}})/abs({name} - {{s}}))/2",), (name,), at)


_FEWEST = 4
"""Fewest different values of a column"""
_ALIKE = 0.999
"""Correlation above which a column counts as the same variable: as the time, or as the number of the row"""


def kept(values: Mapping[str, Array], of_data: Collection[str]) -> dict[str, Array]:
    """Return the variables (rows,) without columns of the data that have few values or follow another variable.

    The time counts also by its order, so that a column that numbers the readings follows it.
    """
    columns = {name: column for name, column in values.items() if name not in of_data}
    order = {"order": np.unique(columns["t"], return_inverse=True)[1].astype(float)} if "t" in columns else {}
    for name in (column for column in values if column in of_data and powers_are_tried(column)):
        if len(np.unique(values[name])) >= _FEWEST and not _follows(values[name], (columns | order).values()):
            columns[name] = values[name]
    return columns


def _follows(values: Array, others: Collection[Array]) -> bool:
    varying = [other for other in others if np.ptp(other) > 0]
    return any(abs(float(np.corrcoef(values, column)[0, 1])) > _ALIKE for column in varying)
