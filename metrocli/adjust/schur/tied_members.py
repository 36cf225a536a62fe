"""Members of the eliminated block that share a reading with another member: they stay in the reduced system.

For such a member i, `e_i = S_i r` with the columns S_i of the reduced unknowns r. So `W_i = -S_i` and `D_i^-1 = 0`, and
all that follows from these holds for it as for the others. Method: docs/algorithms/tiled-elimination.md.
"""

from __future__ import annotations

import numpy as np

from metrocli.adjust.schur.irregular_normals import OutsideTiles
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class TiedMembers(OutsideTiles):
    """Tied members, with their columns in the reduced system."""

    members: Index
    columns: Index
    """(k, s), -1 for fixed entries"""
    width: int

    @property
    def reduced(self) -> tuple[Array, Array, float]:
        """Nothing: their readings are in the reduced system as they are."""
        return np.zeros((self.width, self.width)), np.zeros(self.width), 0.0

    @property
    def diagonal(self) -> Array:
        """Nothing, (width,)."""
        return np.zeros(self.width)

    def damped(self, factor: float) -> TiedMembers:
        """Return the same: their diagonal is damped with that of the reduced system."""
        return self

    def back(self, step: Array) -> Array:
        """Return their part of the step of the reduced unknowns, (k, s)."""
        return np.where(self.columns >= 0, step[np.maximum(self.columns, 0)], 0.0)

    def normals(self) -> Array:
        """Return unit matrices, (k, s, s): the reduced system shows whether they are determined."""
        k, s = self.columns.shape
        return np.tile(np.eye(s), (k, 1, 1))

    def inverse(self) -> Array:
        """Return zeros, (k, s, s): they have no noise beside the reduced unknowns."""
        k, s = self.columns.shape
        return np.zeros((k, s, s))

    def weights(self) -> Array:
        """Return `W = -S`, (k, s, width)."""
        k, s = self.columns.shape
        weights = np.zeros((k, s, self.width))
        at = np.nonzero(self.columns >= 0)
        weights[(*at, self.columns[at])] = -1.0
        return weights

    def covariance(self, reduced: Array) -> Array:
        """Return their covariance, (k, s, s)."""
        free, at = self.columns >= 0, np.maximum(self.columns, 0)
        return np.where(free[:, :, None] & free[:, None, :], reduced[at[:, :, None], at[:, None, :]], 0.0)

    def solved(self, fields: Array) -> Array:
        """Return zeros, as `D^-1 H` of fields H (k, s, f)."""
        return np.zeros(fields.shape)

    def moments(self, fields: Array) -> tuple[Array, Array]:
        """Return `H' W` (f, width), and zeros for `H' D^-1 H` (f, f), of fields H (k, s, f)."""
        f = fields.shape[2]
        flat = fields.reshape(-1, f)
        return flat.T @ self.weights().reshape(len(flat), self.width), np.zeros((f, f))
