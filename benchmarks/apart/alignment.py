"""The casting in the machine, seen by the spindle camera: pose, clamping angle, gauged points and screws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from benchmarks.apart.model import Array, Model
from benchmarks.apart.samples import LENS, numbers, stated, table
from benchmarks.apart.statement import Rng, Simulated, Statement, of_share
from benchmarks.hidden.scenes import pixels, rotation

LEVELLED = tuple(f"{name} after levelling" for name in ("x", "y", "z", "gamma", "beta", "alpha"))
"""Unknowns in the order of the zero point"""
_NOISE, _DRAWS = 0.05, 100_000
_NAMES = ("x", "y", "z", "alpha", "beta", "gamma", "gamma_s")
_CAMERA = (*LENS, "x", "y", "z", "alpha", "beta", "gamma")


def _whitening(covariance: Array) -> Array:
    """Return W (n, n) so that W x has the unit covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def raises(pose: Array, at: Array) -> Array:
    """Return how far each support (n, 2) is raised so that the part is level, the highest stays."""
    normal = rotation(pose[3:6])[:, 2]
    height = -((at - pose[:2]) @ normal[:2]) / normal[2]
    return np.asarray(height.max() - height)


def level(pose: Array, at: Array) -> Callable[[Array], Array]:
    """Return the move that the screws for `pose` make: about the contact that stays, by the smallest turn."""
    stays = at[int(raises(pose, at).argmin())]
    normal = rotation(pose[3:6])[:, 2]
    contact = np.append(stays, pose[2] - (stays - pose[:2]) @ normal[:2] / normal[2])
    # Rodrigues: the rotation that carries the normal to the vertical
    w, up = np.array([normal[1], -normal[0], 0.0]), normal[2]
    cross = np.array([[0, 0, w[1]], [0, 0, -w[0]], [-w[1], w[0], 0]])
    turn = np.eye(3) + cross + cross @ cross / (1 + up)

    def after(x: Array) -> Array:
        r = turn @ rotation(x[3:6])
        euler = [np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(r[2, 0]), np.arctan2(r[1, 0], r[0, 0])]
        return np.concatenate([turn @ (x[:3] - contact) + contact, euler])

    return after


def supports(folder: Path) -> tuple[list[str], Array]:
    """Return names and places (n, 2) of the supports."""
    rows = table(folder / "machine/supports.csv")
    return [row["support"] for row in rows], numbers(rows, "x_mm", "y_mm")


def alignment(folder: Path) -> Model:
    """Image points of targets with a joint covariance, through a camera with one, and points that are to be gauged."""
    seen, spindle = table(folder / "machine/observations.csv"), table(folder / "machine/poses.csv")
    gauged, result = table(folder / "machine/gauging.csv"), folder / "results/align.h5"
    listed = stated(folder / "results/fit.h5", "targets")
    names = [row["target"] for row in listed]
    targets = np.array([[row[a] for a in "xyz"] for row in listed])
    with h5py.File(folder / "results/fit.h5") as file:
        own, common = file["targets_own"][:], file["targets_common"][:]
    flat = common.reshape(-1, common.shape[2])
    joint = flat @ flat.T
    for i, one in enumerate(own):
        joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += one
    with h5py.File(folder / "results/camera.h5") as file:
        known = {row["name"].decode(): float(row["value"]) for row in file["parameters"][:]}
        order = [row["name"].decode() for row in file["parameters"][:]]
        of_camera = file["covariance"][:]
    pick = [order.index(name) for name in _CAMERA]
    camera = np.array([known[name] for name in _CAMERA])
    to_camera, to_targets = _whitening(of_camera[np.ix_(pick, pick)]), _whitening(joint)
    at = numbers(spindle, "x_mm", "y_mm", "z_mm")[
        [[one["image"] for one in spindle].index(row["image"]) for row in seen]
    ]
    target = np.array([names.index(row["target"]) for row in seen])
    points, sigma = numbers(gauged, "x_mm", "y_mm", "z_mm"), numbers(gauged, "sigma_mm")[:, 0]
    m = len(targets)
    found = {row["name"]: row["value"] for row in stated(result, "parameters")}
    truth = np.concatenate([[found[name] for name in _NAMES], camera, targets.ravel(), points.ravel()])

    def predict(x: Array) -> Array:
        pose, angle, lens, mount = x[:6], x[6], dict(zip(LENS, x[7:14].tolist(), strict=True)), x[14:20]
        places = x[20 : 20 + 3 * m].reshape(m, 3) @ rotation(pose[3:]).T + pose[:3]
        clamp = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        turn = clamp @ rotation(mount[3:])
        uv = pixels((places[target] - (clamp @ mount[:3] + at)) @ turn, lens)
        priors = [to_camera @ (x[7:20] - camera), to_targets @ (x[20 : 20 + 3 * m] - targets.ravel())]
        return np.concatenate([uv.ravel(), *priors, x[20 + 3 * m :]])

    def gauge(i: int, a: int) -> Callable[[Array], float]:
        return lambda x: float((rotation(x[3:6]) @ x[20 + 3 * (m + i) : 23 + 3 * (m + i)] + x[:3])[a])

    supported, feet = supports(folder)
    stays, after = int(raises(truth[:6], feet).argmin()), level(truth[:6], feet)
    quantities: dict[str, Callable[[Array], float]] = {
        name: (lambda x, i=i: float(x[i])) for i, name in enumerate(_NAMES)
    }
    quantities |= {
        f"{row['point']}.{axis}": gauge(i, a) for i, row in enumerate(gauged) for a, axis in enumerate("xyz")
    }
    for i, name in enumerate(supported):

        def screw(x: Array, i: int = i) -> float:
            found = raises(x[:6], feet)
            return float(found[i] - found[stays])

        quantities[f"raise of {name}"] = screw
    for i, name in enumerate(_NAMES[:6]):
        # the screws are those of the estimate; an error of the pose stays in the part
        quantities[f"{name} after levelling"] = lambda x, i=i: float(after(x[:6])[i])
    sigmas = np.concatenate([np.full(2 * len(seen), _NOISE), np.ones(13 + 3 * m), np.repeat(sigma, 3)])
    keys = {(row["image"], row["target"], axis): 2 * i + a for i, row in enumerate(seen) for a, axis in enumerate("uv")}
    return Model(predict, sigmas, truth, quantities, keys)


def tilt_left(kind: str, place: str, model: Model, claimed: float) -> Statement:
    """Return the tilt that a part may have after levelling: 95 % of measurements leave less."""

    def check(rng: Rng) -> Simulated:
        _, inverse = model.inverse
        errors = inverse[3:5] @ rng.normal(size=(inverse.shape[1], _DRAWS))
        return of_share(int((np.hypot(*errors) < claimed).sum()), _DRAWS, 0.945, 0.955)

    return Statement(kind, place, "tilt left after levelling, with 95 %", f"{1e3 * claimed:.3f} mm/m", check)
