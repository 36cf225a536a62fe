"""The dense adjustment of a simulated network: differences of plain formulas, bordered normal equations."""

from __future__ import annotations

import numpy as np
from simulated.network import BAR, GIVEN, HEIGHT, INTERFEROMETER, Array, Network, polar, sigmas


def exponential(w: Array) -> Array:
    """The rotation by the vector w, by Rodrigues' formula."""
    angle = float(np.linalg.norm(w))
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if angle < 1e-12:
        return np.asarray(np.eye(3) + k)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * (k @ k))


class Dense:
    """Unknowns: points, then place and turn of each station, then place and dead path of each interferometer."""

    def __init__(self, net: Network) -> None:
        self.net = net
        self.x, self.s, self.r = net.points.copy(), net.places.copy(), net.rotations.copy()
        self.t = net.tracers.copy()
        self.turns = 1 if net.levelled else 3
        self.n, self.m = len(self.x), len(self.s)

    def predicted(self, u: Array) -> Array:
        n, m, k = self.n, self.m, 3 + self.turns
        x = self.x + u[: 3 * n].reshape(n, 3)
        own = u[3 * n : 3 * n + m * k].reshape(m, k)
        t = self.t + u[3 * n + m * k :].reshape(len(self.t), 4)
        turns = [np.array([0, 0, one[3]]) if self.turns == 1 else one[3:] for one in own]
        r = np.array([exponential(w) @ one for w, one in zip(turns, self.r, strict=True)])
        net, s = self.net, self.s + own[:, :3]
        seen = polar(np.einsum("nab,na->nb", r[net.station], x[net.point] - s[net.station]))
        seen[:, 0] = net.seen[:, 0] + np.remainder(seen[:, 0] - net.seen[:, 0] + np.pi, 2 * np.pi) - np.pi
        lengths = np.linalg.norm(x - t[:, None, :3], axis=2) - t[:, 3:]
        bars = [np.linalg.norm(x[a] - x[b]) for a, b, _ in net.bars]
        heights = [x[b, 2] - x[a, 2] for a, b, _ in net.heights]
        return np.concatenate([seen.ravel(), lengths.ravel(), bars, heights, x[list(net.given)].ravel()])

    def readings(self) -> Array:
        net = self.net
        pairs = [v for *_, v in (*net.bars, *net.heights)]
        return np.concatenate([net.seen.ravel(), net.lengths.ravel(), pairs, net.near[list(net.given)].ravel()])

    def deviations(self) -> Array:
        net = self.net
        local = np.einsum("nab,na->nb", self.r[net.station], self.x[net.point] - self.s[net.station])
        counts = (net.lengths.size, len(net.bars), len(net.heights), 3 * len(net.given))
        rest = [np.full(k, v) for k, v in zip(counts, (INTERFEROMETER, BAR, HEIGHT, GIVEN), strict=True)]
        return np.concatenate([sigmas(polar(local)).ravel(), *rest])

    def jacobian(self, size: int) -> Array:
        steps = np.full(size, 1e-2)
        k = 3 + self.turns
        for i in range(self.m):
            steps[3 * self.n + i * k + 3 : 3 * self.n + (i + 1) * k] = 1e-6
        columns = [
            (self.predicted(h * e) - self.predicted(-h * e)) / (2 * h) for h, e in zip(steps, np.eye(size), strict=True)
        ]
        return np.stack(columns, axis=1)

    def constraints(self, reference: Array) -> Array:
        """Inner constraints on the points: shifts, turns about x, y, z or about z alone; none beside given points."""
        if self.net.given:
            return np.zeros((self.width, 0))
        axes = [2] if self.net.levelled else [0, 1, 2]
        g = np.zeros((self.n, 3, 3 + len(axes)))
        g[:, :, :3] = np.eye(3)
        for k, axis in enumerate(axes):
            g[:, :, 3 + k] = np.cross(np.eye(3)[axis], reference)
        full = np.zeros((self.width, g.shape[2]))
        full[: 3 * self.n] = g.reshape(3 * self.n, -1)
        return full

    @property
    def width(self) -> int:
        return 3 * self.n + self.m * (3 + self.turns) + 4 * len(self.t)

    def solve(self) -> tuple[Array, Array, float]:
        """Points, their joint covariance, and the sum of squares; the points lie on their list."""
        near = self.net.near
        for _ in range(12):
            sigma = self.deviations()
            j, v = (
                self.jacobian(self.width) / sigma[:, None],
                (self.readings() - self.predicted(np.zeros(self.width))) / sigma,
            )
            g = self.constraints(near)
            off = g[: 3 * self.n].T @ (near - self.x).ravel()
            matrix = np.block([[j.T @ j, g], [g.T, np.zeros((g.shape[1],) * 2)]])
            size = 1 / np.sqrt(np.append(np.diag(matrix)[: self.width], np.ones(g.shape[1])))
            inverse = np.linalg.inv(matrix * size[:, None] * size) * size[:, None] * size
            u = inverse[: self.width] @ np.append(j.T @ v, off)
            self._move(u)
        return self.x, inverse[: 3 * self.n, : 3 * self.n], float(v @ v)

    def _move(self, u: Array) -> None:
        n, m, k = self.n, self.m, 3 + self.turns
        own = u[3 * n : 3 * n + m * k].reshape(m, k)
        self.x = self.x + u[: 3 * n].reshape(n, 3)
        self.s = self.s + own[:, :3]
        turns = [np.array([0, 0, one[3]]) if self.turns == 1 else one[3:] for one in own]
        self.r = np.array([exponential(w) @ one for w, one in zip(turns, self.r, strict=True)])
        self.t = self.t + u[3 * n + m * k :].reshape(len(self.t), 4)
