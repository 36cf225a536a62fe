"""Aligned poses for the tests, written without the engine: the beam's two vectors turned into angles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.table import Table
from metrocli.tasks.locate_launch_unit.settings import Inputs, LaunchUnitNoise, Settings

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")
ARCSEC = 4.84813681109536e-06
NOISE = LaunchUnitNoise(5 * ARCSEC, 1e-3)
"""5 arcsec, 1 um"""
PAPER_UNIT = np.array([0.0, 1000.0, 1500.0])
PAPER_RECEIVERS = np.array([[-1200.0, 200.0, 500.0], [0.0, 200.0, 500.0], [1200.0, 200.0, 500.0]])
"""Launch and receiver positions of Kuprin et al., tables 1 and 2"""
PAPER_ENCODER = 50e-6


@dataclass(frozen=True)
class Poses:
    """Aligned poses and their truth."""

    unit: Array
    gamma: float
    receivers: Array
    psi: Array
    angles: Array
    """phi1 phi2 phi3 phi4, (4, n)"""
    distance: Array | None = None

    @property
    def truth(self) -> Array:
        return np.array([*self.unit, self.gamma])

    def table(self, **more: object) -> Table:
        """The poses as a file would have them."""
        n = len(self.receivers)
        columns = {"pose": np.array([f"P{i}" for i in range(n)]), **dict(zip("xyz", self.receivers.T, strict=True))}
        columns |= {"spindle": self.psi, **{f"phi{i + 1}": row for i, row in enumerate(self.angles)}}
        columns |= {} if self.distance is None else {"distance": self.distance}
        return Table(columns | more, {}, "poses.csv", tuple(range(2, n + 2)))  # type: ignore[operator]

    def noisy(self, rng: np.random.Generator, noise: LaunchUnitNoise = NOISE) -> Poses:
        """The same poses read with noise, angles within +-180 degrees as encoders count."""
        angles = self.angles + rng.normal(size=self.angles.shape) * noise.encoder
        angles = (angles + np.pi) % (2 * np.pi) - np.pi
        length = self.distance
        if length is not None:
            length = length + rng.normal(size=length.shape) * (noise.distance or 0.0)
        return replace(self, angles=angles, distance=length)


def poses(unit: Array, gamma: float, receivers: Array, psi: Array | float = 0.0, distances: bool = False) -> Poses:
    """Return aligned units without noise: tilts from the beam's height, base angles from its plan."""
    n = len(receivers)
    psi = np.broadcast_to(np.asarray(psi, dtype=float), (n,))
    angles = np.empty((4, n))
    length = np.empty(n)
    for i, at in enumerate(receivers):
        beam = at - unit
        length[i] = np.sqrt(beam @ beam)
        angles[0, i] = np.angle(complex(beam[0], beam[1])) - gamma
        angles[1, i] = np.arcsin(beam[2] / length[i])
        angles[2, i] = np.arcsin(-beam[2] / length[i])
        angles[3, i] = np.angle(complex(-beam[0], -beam[1])) - psi[i]
    return Poses(unit, gamma, receivers, psi, (angles + np.pi) % (2 * np.pi) - np.pi, length if distances else None)


def anywhere(n: int, seed: int, distances: bool = False) -> Poses:
    """Return n poses around a unit at any place and angle, in a machine of 2 m x 1 m x 1 m."""
    rng = np.random.default_rng(seed)
    unit = rng.uniform([0, 0, -400], [2000, 1000, 0])
    receivers = rng.uniform([0, 0, 50], [2000, 1000, 1000], (n, 3))
    return poses(unit, float(rng.uniform(-np.pi, np.pi)), receivers, rng.uniform(-np.pi, np.pi, n), distances)


def paper(gamma: float = 0.3) -> Poses:
    """The three poses of the paper."""
    return poses(PAPER_UNIT, gamma, PAPER_RECEIVERS)


def settings(method: str = "adjustment", noise: LaunchUnitNoise = NOISE) -> Settings:
    """The settings of a job on such poses."""
    return Settings(Inputs(NOWHERE), noise, method)
