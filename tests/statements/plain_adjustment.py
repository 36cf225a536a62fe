"""Least squares from derivatives by differences, and what a terminal report states: written apart from the program.

The statements of this folder were drawn from the reports of the samples and of a case of ../shared (multilaterate,
diagnose, plan, report-uncertainty, selfcal-grid, calibrate-camera, align-part, locate-launch-unit, calibrate-machine):
a report, then a line with a number in it, by `random.Random(1507)`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
SAMPLES = Path(__file__).parents[2] / "sample_projects"


@dataclass(frozen=True)
class Fit:
    """Unknowns that minimise the sum of squares of whitened residuals."""

    unknowns: Array
    covariance: Array
    residual: Array
    """Whitened"""

    @property
    def std(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


def fitted(
    residual: Callable[[Array], Array], start: Array, steps: Array, rounds: int = 8, wanted: float = 1e-11
) -> Fit:
    """Return the fit of whitened residuals (reading minus prediction over sigma), by Gauss and Newton.

    Unknowns that the readings leave open get the shortest step and no covariance.
    """
    unknowns = start.astype(float).copy()
    for _ in range(rounds):
        now = residual(unknowns)
        jacobian = derivatives(residual, unknowns, steps)
        scaled, inverse = _inverse(jacobian, wanted)
        unknowns = unknowns - (inverse @ now) / scaled
    jacobian = derivatives(residual, unknowns, steps)
    scaled, inverse = _inverse(jacobian, wanted)
    covariance = (inverse @ inverse.T) / np.outer(scaled, scaled)
    return Fit(unknowns, covariance, residual(unknowns))


def derivatives(residual: Callable[[Array], Array], unknowns: Array, steps: Array) -> Array:
    """Return derivatives of residuals by unknowns from central differences."""
    columns = []
    for at, step in enumerate(steps):
        moved = np.zeros(len(unknowns))
        moved[at] = step
        columns.append((residual(unknowns + moved) - residual(unknowns - moved)) / (2 * step))
    return np.stack(columns, axis=1)


def _inverse(jacobian: Array, wanted: float) -> tuple[Array, Array]:
    size = np.linalg.norm(jacobian, axis=0)
    return size, np.linalg.pinv(jacobian / size, rcond=wanted)


def read_columns(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file, by their headings."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    names = lines[0].split(",")
    rows = [line.split(",") for line in lines[1:]]
    return {name: [row[at] for row in rows] for at, name in enumerate(names)}


def numbers(columns: dict[str, list[str]], *names: str) -> Array:
    """Return some columns as numbers, (rows, names)."""
    return np.array([[float(cell) for cell in columns[name]] for name in names]).T


def estimate(report: str, name: str) -> tuple[float, float]:
    """Return value and standard uncertainty of a line `name  value  ± std`."""
    found = re.search(rf"^\s*{re.escape(name)}\s+(-?[\d.]+)\s+± ([\d.]+)", report, re.M)
    assert found is not None, f"no estimate {name} in\n{report}"
    return float(found[1]), float(found[2])


def cells(report: str, *words: str) -> list[str]:
    """Return the cells of the first line that begins with some words; cells are two blanks apart."""
    pattern = r"^\s*" + r"\s+".join(re.escape(word) for word in words) + r"(?=\s).*$"
    found = re.search(pattern, report, re.M)
    assert found is not None, f"no line {words} in\n{report}"
    return re.split(r"\s{2,}", found[0].strip())


def turned(angles: Array) -> Array:
    """Return Rz(c) Ry(b) Rx(a)."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    return np.asarray(np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]]) @ about_y @ about_x)
