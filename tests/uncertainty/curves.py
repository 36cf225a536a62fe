"""Curves through points, adjusted by the engine of metrocli with a model as text and its exact derivatives."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.solution import Solution
from metrocli.expressions.derivatives import Jets
from metrocli.expressions.expression import ExpressionError, parse

Array = npt.NDArray[np.float64]
_RATIO = "(b1+b2*x+b3*x**2+b4*x**3)/(1+b5*x+b6*x**2+b7*x**3)"
CURVES = {
    "Misra1a": "b1*(1-exp(-b2*x))", "BoxBOD": "b1*(1-exp(-b2*x))", "Hahn1": _RATIO, "Thurber": _RATIO,
    "MGH09": "b1*(x**2+x*b2)/(x**2+x*b3+b4)", "Eckerle4": "(b1/b2)*exp(-0.5*((x-b3)/b2)**2)",
    "Rat43": "b1/((1+exp(b2-b3*x))**(1/b4))", "Kirby2": "(b1+b2*x+b3*x**2)/(1+b4*x+b5*x**2)",
    "Lanczos3": "b1*exp(-b2*x)+b3*exp(-b4*x)+b5*exp(-b6*x)", "Bennett5": "b1*(b2+x)**(-1/b3)",
    "Gauss1": "b1*exp(-b2*x)+b3*exp(-((x-b4)**2)/b5**2)+b6*exp(-((x-b7)**2)/b8**2)", "MGH10": "b1*exp(b2/(x+b3))",
}  # fmt: skip
"""Models of the NIST reference data, as their files state them"""


@dataclass(frozen=True)
class Curve:
    """A link that gives a model of parameters b1, b2, ... at x."""

    text: str
    takes = None
    gives = Quantity.LENGTH
    blocks = ("b",)

    def step(self, value: Array, local: LinkContext) -> Step:
        b = local.members("b")[0]
        names = [f"b{i + 1}" for i in range(len(b))]
        x = local.observations.conditions["x"]
        model = parse(self.text)
        try:
            jet = model.carried_out(Jets(model, names, dict(zip(names, b, strict=True)) | {"x": x}, order=1))
        except ExpressionError:
            return Step(np.full((1, len(x)), np.inf), None, {"b": np.zeros((1, len(b), len(x)))})
        slope = np.broadcast_to(jet.gradient, (len(b), len(x)))
        return Step(np.broadcast_to(jet.value, x.shape)[None], None, {"b": slope[None]})


def fit_estimated(text: str, x: Any, y: Any, start: Any) -> Solution:
    """Adjust with the noise estimated from the residuals: once more with the standard deviation that was found.

    The engine stops when a step is short against the standard deviations, so that these have to be of the right size.
    """
    solution, sigma = fit(text, x, y, start), 1.0
    for _ in range(2):
        sigma *= solution.sigma0
        solution = fit(text, x, y, solution.blocks["b"].values[0], sigma)
    return solution


def fit(text: str, x: Any, y: Any, start: Any, sigma: Any = 1.0) -> Solution:
    """Adjust the parameters of a model to points with standard uncertainties sigma."""
    start = np.asarray(start, dtype=float)
    block = Block("b", start, tuple(f"b{i + 1}" for i in range(len(start))))
    readings = Observations(
        np.asarray(y, dtype=float)[None],
        np.asarray(sigma, dtype=float),
        {},
        conditions={"x": np.asarray(x, dtype=float)},
    )
    return adjust([block], [Group("points", Chain((Curve(text),)), readings)])


@dataclass(frozen=True)
class Reference:
    """A file of NIST: data, two starts, certified parameters and their standard deviations."""

    x: Array
    y: Array
    starts: tuple[Array, Array]
    b: Array
    sd: Array


def read_strd(path: Path) -> Reference:
    text = path.read_text(encoding="utf-8")
    rows = re.findall(r"^\s*b\d+\s*=\s*(\S+)\s+(\S+)\s+(\S+)\s+(\S+)", text, re.MULTILINE)
    values = np.array(rows, dtype=float)
    data = [line.split() for line in text[text.rindex("Data:") :].splitlines()[1:] if line.strip()]
    points = np.array(data, dtype=float)
    return Reference(points[:, 1], points[:, 0], (values[:, 0], values[:, 1]), values[:, 2], values[:, 3])
