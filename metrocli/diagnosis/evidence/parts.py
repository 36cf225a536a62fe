"""The parts of a state: fixed columns (effects, wrong readings), random effects (scatters, correlated errors).

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.frozen import dataclass

READINGS, TERMS = -1, -2
"""Family of the errors of single readings, and that of the terms of the first form; those of others are below"""
EFFECT, READING, UNKNOWN, TERM = "effect", "reading", "unknown cause", "term of a law"
"""Sorts of fixed columns"""
SCATTER, CORRELATED = "scatter", "correlated"
_SEEN = 1e-4
"""Smallest singular value of unit columns, relative to the largest, that counts as a column

A Gram matrix shows singular values down to 1e-8: the direction of a column near that would be rounding.
"""
LARGEST = 2 * float(np.log(10.0))
"""ln of the largest variance of a correlated error, in that of the noise: ten times the declared one"""


@dataclass(frozen=True)
class Fixed:
    """An effect at a place, an error of one reading or a term of a law, whose sizes are estimated without a prior."""

    family: int
    number: int
    columns: Array
    """Whitened, (rows, rank)"""
    turn: Array
    """Its parameters from the sizes of these columns, (parameters, rank)"""
    price: float
    sort: str = EFFECT
    aliases: tuple[tuple[str, float, float], ...] = ()
    """Other values of a scanned parameter that fit alike: its name, the value, and the odds against the chosen one"""
    rivals: tuple[tuple[tuple[int, int], float], ...] = ()
    """Terms of a lens that explain as well, each about its own solution: key, and ln of the odds"""

    @property
    def key(self) -> tuple[int, int]:
        """Family and number."""
        return self.family, self.number

    @property
    def rank(self) -> int:
        """Number of its columns that the readings show."""
        return int(self.columns.shape[1])

    @property
    def is_reading(self) -> bool:
        """Whether it is an error of one reading."""
        return self.sort == READING


@dataclass(frozen=True)
class Random:
    """Columns whose coefficients scatter about 0 with one unknown variance."""

    kind: str
    key: tuple[int, int, int]
    """Number of its covariate or effect, number of its length, and the unit of a single one or -1"""
    columns: Array
    """Whitened, (rows, k): those of the row's own unit if it is local"""
    local: bool
    """Whether it is independent in each local member (image), with columns of its own in each"""
    price: float
    most: float
    """Largest ln of its variance ratio"""
    unit: float = 1.0
    """Size of what it stands for at a coefficient of 1: a parameter of an effect, or the declared noise"""


def fixed(whole: Array, gram: Array, key: tuple[int, int], price: float, sort: str = EFFECT) -> Fixed:
    """Return the columns that are seen apart of whole ones (rows, q), whose visible parts have products `gram`."""
    lengths = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    # columns of unit length: parameters of different units are compared
    values, vectors = np.linalg.eigh(gram / lengths / lengths[:, None])
    kept = values > _SEEN**2 * max(float(values[-1]), 1e-300)
    turn = vectors[:, kept] / np.sqrt(values[kept]) / lengths[:, None]
    return Fixed(*key, whole @ turn, turn, price, sort)
