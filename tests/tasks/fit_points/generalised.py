"""Generalised least squares of points of stations and of their nominal places, that shares nothing with the program."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]


@dataclass
class Reference:
    """`x = R' (P - d) / s` with places P, observed with the joint covariance of all x, and of listed P."""

    station: Index
    of: Index
    x: Array
    covariance: Array
    """(3n, 3n)"""
    place: Array
    """(m, 3), listed or a start"""
    listed: Array | None
    """(3m, 3m) of the listed places; None: they are unknown"""
    exact: bool = False
    scaled: bool = False
    fixed: bool = False
    """Whether the first station is the frame"""

    def solved(self, turns: list[Rotation], shifts: Array) -> tuple[Array, Array, Array, Array]:
        """Return (x, y, z, alpha, beta, gamma[, scale]) of the free stations, covariance, places and their covariance."""
        k, m, n = len(turns), len(self.place), len(self.x)
        turn, shift, scale, place = [*turns], shifts.copy(), np.ones(k), self.place.copy()
        free = np.concatenate([np.repeat(np.arange(k) > (0 if self.fixed else -1), 7), np.full(3 * m, not self.exact)])
        free[6 : 7 * k : 7] &= self.scaled
        root = np.linalg.cholesky(self.covariance)
        for _ in range(15):
            jacobian, predicted = np.zeros((3 * n, 7 * k + 3 * m)), np.zeros((n, 3))
            for row in range(n):
                i, j = int(self.station[row]), int(self.of[row])
                back, away = turn[i].as_matrix().T / scale[i], place[j] - shift[i]
                predicted[row] = back @ away
                cross = np.array([[0, -away[2], away[1]], [away[2], 0, -away[0]], [-away[1], away[0], 0]])
                own = jacobian[3 * row : 3 * row + 3]
                own[:, 7 * i : 7 * i + 7] = np.column_stack([-back, back @ cross, -predicted[row] / scale[i]])
                own[:, 7 * k + 3 * j : 7 * k + 3 * j + 3] = back
            rows = [solve_triangular(root, jacobian, lower=True)]
            right = [solve_triangular(root, (self.x - predicted).ravel(), lower=True)]
            if self.listed is not None:
                known = np.linalg.cholesky(self.listed)
                rows.append(solve_triangular(known, np.eye(3 * m, 7 * k + 3 * m, 7 * k), lower=True))
                right.append(solve_triangular(known, (self.place - place).ravel(), lower=True))
            design = np.concatenate(rows)[:, free]
            step = np.zeros(len(free))
            step[free] = np.linalg.lstsq(design, np.concatenate(right), rcond=None)[0]
            moves = step[: 7 * k].reshape(k, 7)
            shift, scale = shift + moves[:, :3], scale + moves[:, 6]
            turn = [Rotation.from_rotvec(move[3:6]) * one for move, one in zip(moves, turn, strict=True)]
            place = place + step[7 * k :].reshape(m, 3)
        whole = np.zeros((len(free), len(free)))
        # by the triangle of a QR decomposition: normal equations would lose half of the digits
        inverse = np.linalg.inv(np.linalg.qr(design)[1])
        whole[np.ix_(free, free)] = inverse @ inverse.T
        change = np.eye(7 * k)
        for i, one in enumerate(turn):
            for axis in range(3):
                small = 1e-5 * np.eye(3)[axis]
                ends = [(Rotation.from_rotvec(sign * small) * one).as_euler("xyz") for sign in (1, -1)]
                change[7 * i + 3 : 7 * i + 6, 7 * i + 3 + axis] = (ends[0] - ends[1]) / 2e-5
        values = np.column_stack([shift, [one.as_euler("xyz") for one in turn], scale]).ravel()
        wanted = np.flatnonzero(free[: 7 * k])
        covariance = (change @ whole[: 7 * k, : 7 * k] @ change.T)[np.ix_(wanted, wanted)]
        return values[wanted], covariance, place, whole[7 * k :, 7 * k :]
