"""Corrected points: how often 95 % intervals contain the place on the workpiece, everything uncertain drawn anew.

    python -m benchmarks corrected [RUNS]        # 200 unless given

A mover with errors of 10 um and angles of 80 urad carries two tips; 30 places are replayed with the reflector at each,
and six tracers read them (0.1 um and 0.1 um/m). Each run draws the errors of the mover, its return to a place (0.5 um),
the reflector against each tip (1 um, common to its points), the readings of the probe (0.3 um), and the lengths. The
measurement is written without the engine.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.lengths import network, settings

from metrocli.settings import KnownQuantity
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Correction
from metrocli.tasks.shared.part import Part

Array = npt.NDArray[np.float64]
OFFSETS = np.array([[0.0, 0.0, -120.0], [90.0, 0.0, -60.0]])
PLACES, TRACERS = 30, 6
RETURN, PROBE, SEAT = 0.5e-3, 0.3e-3, 1e-3
STEEL = Part(KnownQuantity(24.0, 0.3), KnownQuantity(11.5e-6, 1e-6))
LIMIT = 7.815
"""95 % of a chi-square of three degrees of freedom lie below"""


@dataclass(frozen=True)
class Case:
    """How the probing points lie, and what is known of the part."""

    name: str
    beside: float
    """Distance of a probing point from its replay, along each axis [mm]"""
    part: Part | None = None


CASES = (
    Case("at the replay", 0.0),
    Case("1 mm beside it", 0.6),
    Case("10 mm beside it", 6.0),
    Case("at the replay, part at 24 degC", 0.0, STEEL),
)


def mover(rng: np.random.Generator) -> Callable[[Array, Array], Array]:
    """Return a smooth error (n, 3) of tips (n,) at places (n, 3): of the carriage, and its turn by the tip's lever."""
    size, turn = 0.01 * rng.normal(size=(3, 3)), 8e-5 * rng.normal(size=(3, 3))
    phase, wave = rng.uniform(0, 2 * np.pi, (2, 3)), rng.uniform(200, 400, (2, 3))

    def errors(at: Array, tip: Array) -> Array:
        shift, angle = np.sin(at / wave[0] + phase[0]) @ size, np.sin(at / wave[1] + phase[1]) @ turn
        return np.asarray(shift + np.cross(angle, OFFSETS[tip]))

    return errors


def measured(case: Case, seed: int) -> tuple[Array, Array]:
    """Return corrected minus true places (n, 3) in the frame of the result, and the covariance of each (n, 3, 3)."""
    rng = np.random.default_rng(seed)
    errors, seat = mover(rng), SEAT * rng.normal(size=(2, 3))
    places = rng.uniform(0, 1, (PLACES, 3)) * [900, 600, 500]
    tip = np.repeat([0, 1], PLACES)
    nominal = np.concatenate([places, places + 0.2])
    reflector = nominal - errors(nominal, tip) + RETURN * rng.normal(size=nominal.shape) + seat[tip]
    net = replace(network(2 * PLACES, TRACERS, seed=4), nominal=nominal, points=reflector).read(rng)
    at = nominal + case.beside * rng.choice([-1.0, 1.0], nominal.shape)
    true = at - errors(at, tip)
    read = at + RETURN * rng.normal(size=at.shape) + PROBE * rng.normal(size=at.shape)
    columns = {"feature": np.repeat("f", len(at)), "point": np.array(net.names), "tip": np.array(["T1", "T2"])[tip]}
    probing = Table(
        columns | dict(zip("xyz", read.T, strict=True)),
        dict.fromkeys("xyz", "mm"),
        "probing.csv",
        tuple(range(2, len(at) + 2)),
    )
    listed = {"tip": np.array(["T1", "T2"]), "sigma": np.full(2, SEAT), **dict(zip("xyz", OFFSETS.T, strict=True))}
    tips = Table(listed, dict.fromkeys(("x", "y", "z", "sigma"), "mm"), "tips.csv", (2, 3))
    job = replace(settings(), correction=Correction(RETURN, PROBE), part=case.part)
    files = (net.lengths(), net.point_table(), net.tracer_table())
    result = multilaterate.run(multilaterate.TASK.job(job, *files, probing=probing, tips=tips))
    turn, shift = frame(reflector, result.tables["points"].stacked("xyz"))
    there = true @ turn.T + shift
    if case.part is not None:
        there = there / (1 + grown(case.part, rng))
    return result.tables["corrected"].stacked("xyz") - there, result.arrays["corrected_covariance"]


def grown(part: Part, rng: np.random.Generator) -> float:
    """Return the true growth of a part of which temperature and expansion are known with their uncertainty."""
    expansion, temperature = (one.value + one.std * rng.normal() for one in (part.expansion, part.temperature))
    return float(expansion * (temperature - 20.0))


def frame(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rotation and shift that move points a onto points b, least squares."""
    u, _, vt = np.linalg.svd((b - b.mean(axis=0)).T @ (a - a.mean(axis=0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return turn, b.mean(axis=0) - turn @ a.mean(axis=0)


def covered(case: Case, runs: int) -> tuple[float, float, float]:
    """Return the shares of coordinates and of points that their 95 % regions contain, and the mean square score."""
    inside, near, squares = [], [], []
    for seed in range(runs):
        off, covariance = measured(case, seed)
        std = np.sqrt(np.einsum("nkk->nk", covariance))
        inside.append((np.abs(off) < 1.96 * std).mean())
        near.append((np.einsum("na,na->n", off, np.linalg.solve(covariance, off[:, :, None])[:, :, 0]) < LIMIT).mean())
        squares.append(((off / std) ** 2).mean())
    return float(np.mean(inside)), float(np.mean(near)), float(np.mean(squares))


def main() -> None:
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    print(f"{runs} runs, {2 * PLACES} points of two tips: coordinates, points (chi-square of 3), mean square score")
    for case in CASES:
        inside, near, square = covered(case, runs)
        print(f"  {case.name:32s} {inside:6.1%} {near:6.1%} {square:6.3f}")


if __name__ == "__main__":
    main()
