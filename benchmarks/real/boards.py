"""Images of a board adjusted by numpy alone, to judge what a diagnosis names; nothing of metrocli is used.

The camera looks along z, x to the right, y down: `x = X/Z`, `y = Y/Z`, `r2 = x2 + y2`,
`x' = x (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x y + p2 (r2 + 2 x2) + s1 r2`, y' alike with p1, p2 exchanged and s3,
`u = fx (1 + aspect) x' + fx skew y' + cx`, `v = fy y' + cy` (Brown 1966; OpenCV's order).
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2", "s1", "s3", "skew", "aspect")
BOARD = ("stretch", "shear", "bxx", "bxy", "byy")
COLUMNS = {
    "radial-distortion": ("k1", "k2", "k3"),
    "decentring-distortion": ("p1", "p2"),
    "thin-prism": ("s1", "s3"),
    "axis-skew": ("skew",),
    "aspect-ratio": ("aspect",),
    "principal-point": ("cx", "cy"),
    "stretched-targets": ("stretch", "shear"),
    "target-plane-bend": ("bxx", "bxy", "byy"),
}
"""The parameters of each effect that all images share"""
OF_TARGET = "moved-target"
_LOSS = 3.0
"""Residuals beyond so many robust standard deviations count linearly: corners that were found wrongly"""
_STEPS, _STILL = 40, 1e-3
"""Largest number of steps, and the change in standard deviations that ends them"""


@dataclass(frozen=True)
class Board:
    """Corners of a flat board in several images."""

    images: tuple[str, ...]
    targets: tuple[str, ...]
    image: Index
    target: Index
    uv: Array
    """(n, 2)"""
    xyz: Array
    """Listed places, (targets, 3)"""
    size: tuple[int, int]

    @classmethod
    def read(cls, stem: str | Path, size: tuple[int, int]) -> Board:
        """Return the corners of `STEM.observations.csv` and the list of `STEM.targets.csv`."""
        with Path(f"{stem}.observations.csv").open(encoding="utf-8") as file:
            seen = list(csv.DictReader(file))
        with Path(f"{stem}.targets.csv").open(encoding="utf-8") as file:
            listed = list(csv.DictReader(file))
        images = tuple(dict.fromkeys(row["image"] for row in seen))
        targets = tuple(row["target"] for row in listed)
        return cls(
            images,
            targets,
            np.array([images.index(row["image"]) for row in seen]),
            np.array([targets.index(row["target"]) for row in seen]),
            np.array([[float(row["u_px"]), float(row["v_px"])] for row in seen]),
            np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in listed]),
            size,
        )

    def written(self, stem: Path, of_images: Mapping[str, Array] | None = None) -> None:
        """Write both files; `of_images` are further columns of the corners, with a value of each image."""
        more = of_images or {}
        with Path(f"{stem}.observations.csv").open("w", encoding="utf-8", newline="") as file:
            rows = zip(self.image, self.target, self.uv, strict=True)
            csv.writer(file).writerows(
                [("image", "target", "u_px", "v_px", *more)]
                + [
                    (self.images[i], self.targets[t], *map(repr, map(float, (u, v, *(of[i] for of in more.values())))))
                    for i, t, (u, v) in rows
                ]
            )
        with Path(f"{stem}.targets.csv").open("w", encoding="utf-8", newline="") as file:
            rows_of_list = [
                (name, *map(repr, map(float, place))) for name, place in zip(self.targets, self.xyz, strict=True)
            ]
            csv.writer(file).writerows([("target", "x_mm", "y_mm", "z_mm"), *rows_of_list])

    def only(self, kept: Index) -> Board:
        """Return the corners of some images."""
        there = np.isin(self.image, kept)
        number = np.full(len(self.images), -1)
        number[kept] = np.arange(len(kept))
        images = tuple(self.images[i] for i in kept)
        return replace(
            self, images=images, image=number[self.image[there]], target=self.target[there], uv=self.uv[there]
        )


@dataclass(frozen=True)
class Model:
    """What is estimated beside the poses: parameters of lens and board, and the places of some targets."""

    free: tuple[str, ...] = ("fx", "fy", "cx", "cy")
    moved: tuple[str, ...] = ()
    """Targets whose places are estimated, without a prior"""
    every_target: float = 0.0
    """Standard deviation of the places of all targets about the list [mm]; 0 for none"""

    def plus(self, name: str, where: Mapping[str, str], std: float = 0.0) -> Model:
        """Return the model with an effect more."""
        if name == OF_TARGET and where:
            return replace(self, moved=(*self.moved, where["target"]))
        if name == OF_TARGET:
            return replace(self, every_target=std)
        return replace(self, free=tuple(dict.fromkeys((*self.free, *COLUMNS[name]))))


@dataclass(frozen=True)
class Fit:
    """An adjusted board."""

    board: Board
    model: Model
    values: Mapping[str, float]
    shifts: Array
    """Of the targets, (targets, 3)"""
    poses: Array
    """Rotation vector and place of each image, (images, 6)"""
    sigma: float
    """Robust standard deviation of the residuals [px]"""
    covariance: Array
    """Of the shared unknowns: parameters, then places of targets"""

    @cached_property
    def residuals(self) -> Array:
        """Read minus predicted (n, 2)."""
        return self.board.uv - predicted(self.board, self.values, self.shifts, self.poses)

    def contained(self, signature: Array) -> Array:
        """Return the sizes to first order that the corners have of an effect (n, 2, k), (k,)."""
        unknowns = _Unknowns(self.board, self.model, self.values)
        own = unknowns.jacobian(unknowns.packed(self.values, self.shifts, self.poses))
        columns, r = np.hstack([own, signature.reshape(len(own), -1)]), self.residuals.ravel()
        root = np.sqrt(np.minimum(1.0, _LOSS * self.sigma / np.maximum(np.abs(r), 1e-300)))
        scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        sizes = np.linalg.lstsq(columns / scale * root[:, None], r * root, rcond=1e-10)[0] / scale
        return np.asarray(sizes[own.shape[1] :])

    def log_score(self, one: Board, noise: float, weight: Array) -> float:
        """Return the log density of another image, whose pose is unknown, with the uncertainty of what is shared.

        `r ~ N(0, noise^2 / weight + J covariance J')`, restricted to what no pose changes. Without the covariance an
        image that alone determines the focal length would count against any larger model.
        """
        pose = _own_pose(one, self, first_pose(one, self.values))
        unknowns = _Unknowns(one, self.model, self.values)
        j = unknowns.jacobian(unknowns.packed(self.values, self.shifts, pose[None]))
        r = (one.uv - predicted(one, self.values, self.shifts, pose[None])).ravel()
        shared = j[:, :-6] @ np.linalg.cholesky(self.covariance)
        factor = np.linalg.cholesky(np.diag(noise**2 / weight) + shared @ shared.T)
        r, own = np.linalg.solve(factor, r), np.linalg.solve(factor, j[:, -6:])
        basis, triangle = np.linalg.qr(own)
        left = r - basis @ (basis.T @ r)
        logs = np.log(np.diag(factor)).sum() + np.log(np.abs(np.diag(triangle))).sum()
        return float(-left @ left / 2 - logs)


def _own_pose(one: Board, fit: Fit, pose: Array) -> Array:
    """Return the pose of one image that is estimated with all else as in a fit."""
    for _ in range(_STEPS):
        r = (one.uv - predicted(one, fit.values, fit.shifts, pose[None])).ravel() / fit.sigma
        weight = np.sqrt(np.minimum(1.0, _LOSS / np.maximum(np.abs(r), 1e-300)))
        j = np.empty((len(r), 6))
        for column in range(6):
            by = np.eye(6)[column] * _SCALES[column] * 1e-2
            high, low = (predicted(one, fit.values, fit.shifts, (pose + s * by)[None]) for s in (1.0, -1.0))
            j[:, column] = ((high - low) / (2 * by[column])).ravel() / fit.sigma
        j *= weight[:, None]
        scale = np.linalg.norm(j, axis=0)
        step = np.linalg.lstsq(j / scale, r * weight, rcond=None)[0] / scale
        pose = pose + step
        if np.abs(step * scale).max() < _STILL:
            break
    return pose


_SCALES = np.array([1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1])


def predicted(board: Board, values: Mapping[str, float], shifts: Array, poses: Array) -> Array:
    """Return the image points (n, 2) of a board."""
    x, y, z = (board.xyz + shifts)[board.target].T
    p = {name: values.get(name, 0.0) for name in (*LENS, *BOARD)}
    x, y = x * (1 + p["stretch"]) + p["shear"] * y, y
    z = z + p["bxx"] * x * x + p["bxy"] * x * y + p["byy"] * y * y
    turn = Rotation.from_rotvec(poses[:, :3]).as_matrix()[board.image]
    seen = np.einsum("nij,nj->ni", turn, np.stack([x, y, z], axis=1)) + poses[board.image, 3:]
    a, b = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
    r2 = a * a + b * b
    radial = 1 + r2 * (p["k1"] + r2 * (p["k2"] + r2 * p["k3"]))
    u = a * radial + 2 * p["p1"] * a * b + p["p2"] * (r2 + 2 * a * a) + p["s1"] * r2
    v = b * radial + p["p1"] * (r2 + 2 * b * b) + 2 * p["p2"] * a * b + p["s3"] * r2
    fx, fy = p["fx"], p["fy"] or p["fx"]
    return np.stack([fx * (1 + p["aspect"]) * u + fx * p["skew"] * v + p["cx"], fy * v + p["cy"]], axis=1)


def first_pose(board: Board, values: Mapping[str, float]) -> Array:
    """Return a start of the pose of a single image from a homography of its corners."""
    flat = board.xyz[board.target][:, :2]
    centre = np.array([values["cx"], values["cy"]])
    image = (board.uv - centre) / np.array([values["fx"], values.get("fy") or values["fx"]])
    rows = []
    for (x, y), (u, v) in zip(flat, image, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    matrix = np.array(rows)
    scale = np.linalg.norm(matrix, axis=0)
    h = (np.linalg.svd(matrix / scale)[2][-1] / scale).reshape(3, 3)
    h *= np.sign(h[2, 2]) * 2 / (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1]))
    turn = np.stack([h[:, 0], h[:, 1], np.cross(h[:, 0], h[:, 1])], axis=1)
    u, _, vt = np.linalg.svd(turn)
    return np.concatenate([Rotation.from_matrix(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).as_rotvec(), h[:, 2]])


@dataclass(frozen=True)
class _Unknowns:
    """The unknowns of an adjustment, in a row: shared parameters, places of targets, poses."""

    board: Board
    model: Model
    known: Mapping[str, float]

    @cached_property
    def chosen(self) -> Index:
        """Targets whose places are estimated."""
        every, names = len(self.board.targets), self.model.moved
        return (
            np.arange(every) if self.model.every_target else np.array([self.board.targets.index(n) for n in names], int)
        )

    def unpacked(self, x: Array) -> tuple[dict[str, float], Array, Array]:
        """Return parameters by name, shifts of the targets, and poses."""
        n, m = len(self.model.free), len(self.chosen)
        values = {**self.known, **dict(zip(self.model.free, x[:n].tolist(), strict=True))}
        if "fy" not in self.model.free:
            values["fy"] = values["fx"]
        shifts = np.zeros(self.board.xyz.shape)
        shifts[self.chosen] = x[n : n + 3 * m].reshape(m, 3)
        return values, shifts, x[n + 3 * m :].reshape(-1, 6)

    def packed(self, values: Mapping[str, float], shifts: Array, poses: Array) -> Array:
        """Return the row of the unknowns."""
        shared = np.array([values.get(name, 0.0) for name in self.model.free])
        return np.concatenate([shared, shifts[self.chosen].ravel(), poses.ravel()])

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the predictions (2n, unknowns), by central differences of all corners at once."""
        values, shifts, poses = self.unpacked(x)
        n, m, rows = len(self.model.free), len(self.chosen), np.arange(len(self.board.uv))
        found = np.zeros((len(rows), 2, len(x)))

        def slope(change: Callable[[float], tuple[Mapping[str, float], Array, Array]], step: float) -> Array:
            high, low = (predicted(self.board, *change(sign * step)) for sign in (1.0, -1.0))
            return (high - low) / (2 * step)

        for at, name in enumerate(self.model.free):

            def moved(by: float, name: str = name) -> tuple[Mapping[str, float], Array, Array]:
                other = {**values, name: values.get(name, 0.0) + by}
                return other | ({"fy": other["fx"]} if "fy" not in self.model.free else {}), shifts, poses

            found[:, :, at] = slope(moved, 1e-3 * _scale(name))
        place = np.full(len(self.board.targets), -1)
        place[self.chosen] = np.arange(m)
        own = place[self.board.target]
        for axis in range(3):
            slopes = slope(lambda by, axis=axis: (values, shifts + by * np.eye(3)[axis], poses), 1e-3)
            there = own >= 0
            found[rows[there], :, n + 3 * own[there] + axis] = slopes[there]
        for column in range(6):
            step = _SCALES[column] * 1e-2
            slopes = slope(lambda by, column=column: (values, shifts, poses + by * np.eye(6)[column]), step)
            found[rows, :, n + 3 * m + 6 * self.board.image + column] = slopes
        return found.reshape(2 * len(rows), -1)


def fitted(board: Board, model: Model, start: Fit | None = None) -> Fit:
    """Return a board adjusted with a model by Gauss-Newton steps; corners found wrongly count linearly (Huber)."""
    width = float(max(board.size))
    known = {"fx": width, "fy": width, "cx": (board.size[0] - 1) / 2, "cy": (board.size[1] - 1) / 2}
    known |= {} if start is None else dict(start.values)
    if start is None:
        poses = np.stack([first_pose(board.only(np.array([i])), known) for i in range(len(board.images))])
        shifts = np.zeros(board.xyz.shape)
        order = [
            tuple(n for n in model.free if n in LENS[:4]),
            tuple(n for n in model.free if n in LENS[:5]),
            model.free,
        ]
    else:
        poses, shifts, order = start.poses, start.shifts, [model.free]
    sigma = 1.0 if start is None else start.sigma
    for free in order:
        unknowns = _Unknowns(board, replace(model, free=free), known)
        x = unknowns.packed(known, shifts, poses)
        for _ in range(_STEPS):
            r = (board.uv - predicted(board, *unknowns.unpacked(x))).ravel()
            sigma = max(1.4826 * float(np.median(np.abs(r))), 1e-6)
            weight = np.sqrt(np.minimum(1.0, _LOSS * sigma / np.maximum(np.abs(r), 1e-300))) / sigma
            j = unknowns.jacobian(x) * weight[:, None]
            gram, right = j.T @ j, j.T @ (r * weight)
            if model.every_target:
                own = slice(len(free), len(free) + 3 * len(board.targets))
                gram[own, own] += np.eye(3 * len(board.targets)) / model.every_target**2
                right[own] -= x[own] / model.every_target**2
            scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
            unit = gram / scale / scale[:, None] + 1e-12 * np.eye(len(x))
            step = np.linalg.solve(unit, right / scale) / scale
            x = x + step
            if np.abs(step * scale).max() < _STILL:
                break
        values, shifts, poses = unknowns.unpacked(x)
        known = values
    kept = len(model.free) + 3 * len(unknowns.chosen)
    covariance = (np.linalg.inv(unit) / scale / scale[:, None])[:kept, :kept]
    return Fit(board, model, values, shifts, poses, sigma, (covariance + covariance.T) / 2)


def _scale(name: str) -> float:
    return 1.0 if name in ("fx", "fy", "cx", "cy") else 1e-6 if name[0] == "b" else 1e-3


def gain(board: Board, before: Model, after: Model) -> tuple[float, float]:
    """Return by how much held-out images are predicted better with a larger model, and its standard error.

    It is the sum over images of the difference of their log scores, with the noise and the weights that the larger
    model has for each image: with one noise for all, an image four times as noisy as the others would decide alone.
    """
    whole = {model: fitted(board, model) for model in (before, after)}
    differences = []
    for number in range(len(board.images)):
        others, one = board.only(np.delete(np.arange(len(board.images)), number)), board.only(np.array([number]))
        left = np.abs(whole[after].residuals[board.image == number]).ravel()
        noise = 1.4826 * float(np.median(left))
        weight = np.minimum(1.0, _LOSS * noise / np.maximum(left, 1e-300))
        fits = (fitted(others, model, replace_poses(whole[model], number)) for model in (before, after))
        score, larger = (fit.log_score(one, noise, weight) for fit in fits)
        differences.append(larger - score)
    d = np.array(differences)
    return float(d.sum()), float(d.std(ddof=1) * np.sqrt(len(d)))


def replace_poses(fit: Fit, gone: int) -> Fit:
    """Return a fit without the pose of one image, as a start."""
    return replace(fit, poses=np.delete(fit.poses, gone, axis=0))


def planted(board: Board, fit: Fit, name: str, where: Mapping[str, str], values: Sequence[float]) -> Board:
    """Return the board with an effect of some sizes in its corners: the difference of two predictions is added."""
    size, shifts = dict(fit.values), fit.shifts.copy()
    if name == OF_TARGET:
        shifts[board.targets.index(where["target"])] += values
    else:
        for key, value in zip(COLUMNS[name], values, strict=True):
            size[key] = size.get(key, 0.0) + value
    change = predicted(board, size, shifts, fit.poses) - predicted(board, fit.values, fit.shifts, fit.poses)
    return replace(board, uv=board.uv + change)
