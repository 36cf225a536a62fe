"""Statements on the sample ball-cube, drawn at random: the adjustment of views in plain numpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from statements.plain_adjustment import SAMPLES, Array, estimate, numbers, read_columns, turned

Metrocli = Callable[..., Any]
DATA = SAMPLES / "ball-cube/data"
PITCH, NOISE = 65.0, 5e-3
TURN = {"2": np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), "3": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])}


@pytest.fixture
def report(metrocli: Metrocli, tmp_path: Path) -> str:
    return str(metrocli("selfcal-grid", SAMPLES / "ball-cube/jobs/scaled.yaml", "--output", tmp_path / "r.h5").out)


def adjusted() -> tuple[Array, Array, float]:
    """Mountings (4, 6) and their standard uncertainties, and sigma0, with sites and balls as unknowns.

    reading = G(site) + d + R(w) (Rot (pitch b + A) + pitch shift), and the calibrated distances of balls.
    """
    views, lengths = read_columns(DATA / "views.csv"), read_columns(DATA / "lengths.csv")
    balls = numbers(views, "i", "j", "k")
    names = np.array(views["view"])
    nominal = np.stack(
        [TURN.get(n, np.eye(3)) @ b + [float(n == "4"), 0, 0] for n, b in zip(names, balls, strict=True)]
    )
    turns = np.stack([TURN.get(n, np.eye(3)) for n in names])
    all_balls, ball = np.unique(balls, axis=0, return_inverse=True)
    all_sites, site = np.unique(nominal, axis=0, return_inverse=True)
    view, read = names.astype(int) - 1, numbers(views, "x_mm", "y_mm", "z_mm")
    ends = [numbers(lengths, *(f"{axis}{at}" for axis in "ijk")) for at in (1, 2)]
    pairs = [[int(np.flatnonzero((all_balls == row).all(axis=1))[0]) for row in end] for end in ends]
    wanted, sigma = numbers(lengths, "length_mm", "sigma_mm").T
    n, m, rows = len(all_balls), len(all_sites), len(read)
    errors, artefact, mount = np.zeros((m, 3)), np.zeros((n, 3)), np.zeros((4, 6))
    for turn in range(3):
        hung = np.einsum("nab,nb->na", turns, PITCH * balls + artefact[ball]) + PITCH * (
            nominal - np.einsum("nab,nb->na", turns, balls)
        )
        about = np.stack([turned(w) for w in mount[:, 3:]])[view]
        off = (read - errors[site] - mount[view, :3] - np.einsum("nab,nb->na", about, hung)) / NOISE
        places = PITCH * all_balls + artefact
        between = places[pairs[1]] - places[pairs[0]]
        distance = np.linalg.norm(between, axis=1)
        jacobian = np.zeros((3 * rows + len(wanted), 3 * m + 3 * n + 24))
        at = np.arange(rows)
        # at turns of zero and artefact errors of zero, where the rank is that of the nominal views
        for a in range(3):
            jacobian[3 * at + a, 3 * site + a] = 1 / NOISE
            jacobian[3 * at + a, 3 * m + 3 * n + 6 * view + a] = 1 / NOISE
            for b in range(3):
                jacobian[3 * at + a, 3 * m + 3 * ball + b] = turns[:, a, b] / NOISE
                jacobian[3 * at + a, 3 * m + 3 * n + 6 * view + 3 + b] = (
                    np.cross(np.eye(3)[b], PITCH * nominal)[:, a] / NOISE
                )
        for row, (one, other) in enumerate(zip(*pairs, strict=True)):
            way = between[row] / distance[row] / sigma[row]
            jacobian[3 * rows + row, 3 * m + 3 * other : 3 * m + 3 * other + 3] = way
            jacobian[3 * rows + row, 3 * m + 3 * one : 3 * m + 3 * one + 3] = -way
        white = np.append(off.ravel(), (wanted - distance) / sigma)
        if turn == 0:
            datum = _datum(PITCH * all_sites, PITCH * all_balls)
            full = np.vstack([jacobian, datum * np.abs(jacobian).max()])
        whole = np.vstack([jacobian, full[len(jacobian) :]])
        step = np.linalg.solve(whole.T @ whole, jacobian.T @ white)
        errors += step[: 3 * m].reshape(-1, 3)
        artefact += step[3 * m : 3 * m + 3 * n].reshape(-1, 3)
        mount += step[3 * m + 3 * n :].reshape(4, 6)
    covariance = np.linalg.inv(full.T @ full)
    std = np.sqrt(np.diag(covariance))[3 * m + 3 * n :].reshape(4, 6)
    dof = len(white) - (full.shape[1] - len(datum))
    return mount, std, float(np.sqrt((white @ white) / dof))


def _datum(sites: Array, balls: Array) -> Array:
    """No rigid motion of the machine error, none of the artefact error: 12 conditions on the unknowns."""
    found = np.zeros((12, 3 * len(sites) + 3 * len(balls) + 24))
    for half, places in enumerate((sites, balls)):
        start = 0 if half == 0 else 3 * len(sites)
        for a in range(3):
            found[6 * half + a, start + a : start + 3 * len(places) : 3] = 1 / np.sqrt(len(places))
            turns = np.cross(np.eye(3)[a], places).ravel()
            found[6 * half + 3 + a, start : start + 3 * len(places)] = turns / np.linalg.norm(turns)
    return found


def test_mounting_and_sigma0(report: str) -> None:
    """4.alpha -0.0004708 ± 0.0000043 rad; required sigma0 > 0.9: met (0.992607)."""
    mount, std, sigma0 = adjusted()
    value, u = estimate(report, "4.alpha")
    assert abs(value - mount[3, 3]) < 0.03 * u and abs(u - std[3, 3]) <= 0.51e-7
    assert f"met ({sigma0:.4f}"[:-1] in report
