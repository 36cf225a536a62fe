"""The casting in the machine, seen by the spindle camera: pose, clamping angle, gauged points and screws."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.model import Array, Model
from benchmarks.apart.samples import LENS, numbers, rewritten, stated, table
from benchmarks.apart.statement import Rng, Simulated, Statement, of_share
from benchmarks.hidden.scenes import pixels, rotation

LEVELLED = tuple(f"{name} after levelling" for name in ("x", "y", "z", "gamma", "beta", "alpha"))
"""Unknowns in the order of the zero point"""
_NOISE, _DRAWS = 0.05, 100_000
_NAMES = ("x", "y", "z", "alpha", "beta", "gamma", "gamma_s")
_XYZ = ("dx", "dy", "dz")
_PARAMETERS = {"bad-pose": _XYZ, "moved-target": _XYZ, "machine-scale": ("scale",), "part-expansion": ("scale",)}
_PARAMETERS |= {"focal-change": ("ratio",), "principal-point-shift": ("du", "dv")}
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


@dataclass(frozen=True)
class _Sight:
    """What the images show: which target each reading is of, and where the spindle was."""

    at: Array
    """(n, 3)"""
    image: npt.NDArray[np.intp]
    target: npt.NDArray[np.intp]
    targets: int

    def pixels(self, x: Array) -> Array:
        """Return the readings (n, 2) for unknowns: pose, clamping angle, lens, mounting, targets."""
        pose, angle, lens, mount = x[:6], x[6], dict(zip(LENS, x[7:14].tolist(), strict=True)), x[14:20]
        places = x[20 : 20 + 3 * self.targets].reshape(-1, 3) @ rotation(pose[3:]).T + pose[:3]
        clamp = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        turn = clamp @ rotation(mount[3:])
        return pixels((places[self.target] - (clamp @ mount[:3] + self.at)) @ turn, lens)


def _sight(folder: Path, names: list[str]) -> _Sight:
    """Return what the images of the machine show of named targets."""
    seen, spindle = table(folder / "machine/observations.csv"), table(folder / "machine/poses.csv")
    image = np.array([[one["image"] for one in spindle].index(row["image"]) for row in seen])
    target = np.array([names.index(row["target"]) for row in seen])
    return _Sight(numbers(spindle, "x_mm", "y_mm", "z_mm")[image], image, target, len(names))


def alignment(folder: Path) -> Model:
    """Image points of targets with a joint covariance, through a camera with one, and points that are to be gauged."""
    seen, result = table(folder / "machine/observations.csv"), folder / "results/align.h5"
    gauged = table(folder / "machine/gauging.csv")
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
    sight = _sight(folder, names)
    points, sigma = numbers(gauged, "x_mm", "y_mm", "z_mm"), numbers(gauged, "sigma_mm")[:, 0]
    m = len(targets)
    found = {row["name"]: row["value"] for row in stated(result, "parameters")}
    truth = np.concatenate([[found[name] for name in _NAMES], camera, targets.ravel(), points.ravel()])

    def predict(x: Array) -> Array:
        priors = [to_camera @ (x[7:20] - camera), to_targets @ (x[20 : 20 + 3 * m] - targets.ravel())]
        return np.concatenate([sight.pixels(x).ravel(), *priors, x[20 + 3 * m :]])

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


def diagnosed(folder: Path, job: str, model: Model) -> Diagnosed:
    """Return the casting in the machine as it is diagnosed with other image points.

    Camera and targets are as the files have them; simulated errors of theirs are put into the image points.
    """
    seen, spindle = table(folder / "machine/observations.csv"), table(folder / "machine/poses.csv")
    names = [row["target"] for row in stated(folder / "results/fit.h5", "targets")]
    sight, truth, count = _sight(folder, names), model.truth, 2 * len(seen)
    quiet, known = sight.pixels(truth).ravel(), slice(7, 20 + 3 * len(names))
    given = slice(count, count + known.stop - known.start)
    steps = np.eye(len(truth))[known]
    whitening = np.stack([(model.predict(truth + step) - model.predict(truth))[given] for step in steps], axis=1)

    def change(name: str, where: Mapping[str, str], values: Mapping[str, float]) -> Array:
        moved, x = sight, truth.copy()
        vector = np.array([values.get(key, 0.0) for key in _XYZ])
        if name == "bad-pose":
            here = sight.image == [row["image"] for row in spindle].index(where["image"])
            moved = replace(sight, at=sight.at + here[:, None] * vector)
        elif name == "machine-scale":
            moved = replace(sight, at=sight.at * (1 + values["scale"] * (np.array(list("xyz")) == where["axis"])))
        elif name == "moved-target":
            first = 20 + 3 * names.index(where["target"])
            x[first : first + 3] += vector
        elif name == "part-expansion":
            x[20 : known.stop] *= 1 + values["scale"]
        elif name == "focal-change":
            x[7] *= 1 + values["ratio"]
        else:
            x[8:10] += values["du"], values["dv"]
        rest = np.zeros(len(model.sigma) - count)
        return np.concatenate([moved.pixels(x).ravel() - quiet, rest])

    def write(copy: Path, readings: Array) -> None:
        (copy / "results").mkdir()
        for name in ("camera.h5", "fit.h5"):
            shutil.copy(folder / "results" / name, copy / "results")
        x = truth.copy()
        x[known] += np.linalg.solve(whitening, readings[given])
        uv = (readings[:count] - sight.pixels(x).ravel() + quiet).reshape(-1, 2)
        rewritten(copy / "machine/observations.csv", seen, {"u_px": uv[:, 0].tolist(), "v_px": uv[:, 1].tolist()})

    def moved_part(one: Array, other: Array) -> float:
        return float(np.linalg.norm((one - other)[:3]))

    return Diagnosed("align-part", "raw-part", folder, job, model, write, _PARAMETERS, change, moved_part)
