"""From what the basis absorbs of an error to the change of the unknowns.

Method: docs/algorithms/what-can-be-seen.md (projection).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.linear.basis import Basis, flat_columns, members_of_equal_size, without_gathering
from metrocli.frozen import dataclass


@dataclass(frozen=True)
class Solver:
    """From coordinates in the basis to the change of the unknowns, in the datum of the model."""

    inverses: Array
    """From coordinates of a member to its unknowns, (members, size, q)"""
    coupling: Array
    """`b' J` of the local columns with the shared unknowns, (members, q, shared unknowns)"""
    shared: Array
    """From coordinates to the shared unknowns, (shared unknowns, k)"""
    places: tuple[Index, Index]
    """Numbers of the local unknowns (members, size), -1 if fixed, and of the shared ones, among all"""
    width: int
    movements: Array
    """Movements of a free network, (unknowns, m)"""
    conditions: Array
    """Conditions of the datum, (m, unknowns): `x - movements (conditions x)` fulfils it"""

    @cached_property
    def _free(self) -> tuple[Index, Index | slice]:
        """Numbers of the local unknowns that are free among all, and their places among those of all members."""
        free = np.flatnonzero(self.places[0].ravel() >= 0)
        return self.places[0].ravel()[free], without_gathering(free)

    def change(self, coordinates: Array) -> Array:
        """Return the change of all unknowns (unknowns, ...) for coordinates (columns, ...)."""
        flat = flat_columns(coordinates)
        members, _, q = self.inverses.shape
        shared = self.shared @ flat[members * q :]
        delta = np.zeros((self.width, flat.shape[1]))
        delta[self.places[1]] = shared
        if members:
            own = flat[: members * q].reshape(members, q, flat.shape[1])
            # members follow the shared unknowns, which take `coupling` times their change from the members' coordinates
            own = np.matmul(self.inverses, own - np.tensordot(self.coupling, shared, 1))
            numbers, free = self._free
            delta[numbers] = own.reshape(self.places[0].size, flat.shape[1])[free]
        if self.movements.shape[1]:
            delta -= self.movements @ (self.conditions @ delta)
        return delta.reshape(len(delta), *coordinates.shape[1:])

    def weighted(self, basis: Basis, new: Basis, factor: Array, sizes: Array) -> Solver:
        """Return the solver for coordinates in the basis of the columns whose rows are multiplied by a factor (rows,).

        Old columns b and `new` ones c have `F b = c T` with `T = c'F b`: derivatives `J = b U` become `c T U`. `sizes`
        are the norms of the shared columns of J, (shared unknowns,).
        """
        members, _, q = self.inverses.shape
        moved = new.coordinates(basis.shared * factor[:, None])
        across, of_shared = moved[: members * q].reshape(members, q, moved.shape[1]), moved[members * q :]
        of_local, there = np.zeros((members, q, q)), basis.member >= 0
        own = new.local[there][:, :, None] * (basis.local * factor[:, None])[there][:, None, :]
        np.add.at(of_local, basis.member[there], own)
        # a direction that no row shows stays one
        of_local += np.eye(q) * (np.einsum("mqq->mq", of_local) == 0)[:, :, None]
        # `U` of the shared columns; in units of their norms, since unknowns have different units
        by_unknown = np.linalg.pinv(sizes[:, None] * self.shared) * sizes
        return replace(
            self,
            inverses=self.inverses @ np.linalg.inv(of_local),
            coupling=of_local @ self.coupling + across @ by_unknown,
            shared=self.shared @ np.linalg.inv(of_shared),
        )

    def own_change(self, basis: Basis, rows: Index) -> Array:
        """Return the change of each row's own member by a unit error of that row, (rows, size); 0 without a member."""
        delta = np.zeros((len(rows), self.inverses.shape[1]))
        free = np.where(self.places[0] >= 0, 1.0, 0.0)
        unknowns = np.maximum(self.places[0], 0)
        # of the conditions by the local unknowns of each member, and by the shared unknowns, which move these as well
        conditions = np.moveaxis(self.conditions[:, unknowns] * free, 0, 2)
        by_shared = self.conditions[:, self.places[1]] - np.tensordot(
            conditions, np.matmul(self.inverses, self.coupling), axes=((0, 1), (0, 1))
        )
        for members, at in members_of_equal_size(basis.member[rows], basis.members):
            inverses = np.swapaxes(self.inverses[members], 1, 2)
            local, shared = basis.local[rows[at]], basis.shared[rows[at]] @ self.shared.T
            change = (local - shared @ np.swapaxes(self.coupling[members], 1, 2)) @ inverses
            if self.movements.shape[1]:
                amounts = shared @ by_shared.T + local @ inverses @ conditions[members]
                change -= amounts @ np.swapaxes(self.movements[unknowns[members]], 1, 2)
            delta[at] = change * free[members][:, None]
        return delta
