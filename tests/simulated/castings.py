"""Rough castings: a block with two bores and a boss, its raw surfaces, and points on them, by plain formulas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
SIZE = np.array([1500.0, 1000.0, 400.0])
FACES = {"left": (0, -1), "right": (0, 1), "front": (1, -1), "back": (1, 1), "bottom": (2, -1), "top": (2, 1)}
ROUND = {"bore-1": (400, 300, 60, -1), "bore-2": (1150, 700, 90, -1), "boss": (750, 500, 150, 1)}
"""Place of the axis, radius, and side of the material"""
NAMES = (*FACES, *ROUND)


def turn(angles: Array) -> Array:
    """R = Rz Ry Rx."""
    (ca, cb, cg), (sa, sb, sg) = np.cos(angles), np.sin(angles)
    x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    z = np.array([[cg, -sg, 0], [sg, cg, 0], [0, 0, 1]])
    return z @ y @ x


def overstock(points: Array, surface: Array) -> Array:
    """Overstock of points in the part frame, each over the surface of its name."""
    found = np.empty(len(points))
    for name in NAMES:
        at = surface == name
        if name in FACES:
            axis, side = FACES[name]
            found[at] = points[at, axis] - SIZE[axis] if side > 0 else -points[at, axis]
        else:
            x, y, radius, side = ROUND[name]
            found[at] = side * (np.hypot(points[at, 0] - x, points[at, 1] - y) - radius)
    return found


@dataclass(frozen=True)
class Casting:
    """Points on a raw casting in the measured frame."""

    pose: Array
    """x y z alpha beta gamma of the part in the measured frame, where the casting was made"""
    surface: Array
    points: Array
    exact: Array
    """Without errors of measurement"""
    targets: Array
    sigma: float

    def overstock_at(self, pose: Array, points: Array | None = None) -> Array:
        """Overstock of the points if the part has this pose."""
        measured = self.points if points is None else points
        return overstock((measured - pose[:3]) @ turn(pose[3:]), self.surface)

    def write(
        self, folder: Path, *lines: str, named: bool = True, minimum: float = 0.5, aim: str = "even", scale: float = 1.0
    ) -> Path:
        """Write the job and its files."""
        rows = ["point,x_mm,y_mm,z_mm,sigma_mm" + (",surface" if named else "")]
        for n, (point, name) in enumerate(zip(self.points, self.surface, strict=True)):
            rows.append(
                f"P{n},{point[0]:.9f},{point[1]:.9f},{point[2]:.9f},{self.sigma}" + (f",{name}" if named else "")
            )
        for n, point in enumerate(self.targets):
            rows.append(f"T{n},{point[0]:.9f},{point[1]:.9f},{point[2]:.9f},{self.sigma}" + ("," if named else ""))
        (folder / "points.csv").write_text("\n".join(rows) + "\n")
        (folder / "part.yaml").write_text(nominal(scale))
        job = folder / "job.yaml"
        more = () if named else ("targets: [T*]",)
        head = (
            "metrocli: 1",
            "job: fit-part",
            "inputs: {points: points.csv, nominal: part.yaml}",
            f"overstock: {{minimum: {minimum} mm, aim: {aim}}}",
            "output: part.h5",
        )
        job.write_text("\n".join([*head, *more, *lines]) + "\n")
        return job


def nominal(scale: float = 1.0) -> str:
    """The ideal part as a file, in another size."""
    lines = ["surfaces:"]
    for name, (axis, side) in FACES.items():
        point, normal = scale * SIZE / 2, np.zeros(3)
        point[axis], normal[axis] = scale * SIZE[axis] if side > 0 else 0.0, side
        place = ", ".join(f"{value} mm" for value in point)
        lines.append(f"- {{name: {name}, type: plane, point: [{place}], normal: {normal.tolist()}}}")
    for name, (x, y, radius, side) in ROUND.items():
        x, y, radius, material = scale * x, scale * y, scale * radius, "inside" if side > 0 else "outside"
        lines.append(
            f"- {{name: {name}, type: cylinder, point: [{x} mm, {y} mm, 0 mm], axis: [0, 0, 1], radius: {radius} mm, material: {material}}}"
        )
    return "\n".join(lines) + "\n"


def casting(
    seed: int,
    each: int = 14,
    stock: tuple[float, float] = (2.5, 5.0),
    rough: float = 0.25,
    sigma: float = 0.03,
    angle: float = 0.1,
    less: dict[str, float] | None = None,
    scale: float = 1.0,
) -> Casting:
    """A casting whose surfaces have an overstock each, scattered by its roughness; `less` changes that of some."""
    rng = np.random.default_rng(seed)
    points, names = [], []
    for name in NAMES:
        own = rng.uniform(*stock) + (less or {}).get(name, 0.0) + rng.normal(size=each) * rough
        size = scale * SIZE
        place = rng.uniform(0.05, 0.95, size=(each, 3)) * size
        if name in FACES:
            axis, side = FACES[name]
            place[:, axis] = size[axis] + own if side > 0 else -own
        else:
            x, y, radius = scale * np.array(ROUND[name][:3])
            side = ROUND[name][3]
            about = rng.uniform(0, 2 * np.pi, each)
            place[:, 0] = x + (radius + side * own) * np.cos(about)
            place[:, 1] = y + (radius + side * own) * np.sin(about)
        points.append(place)
        names += [name] * each
    pose = np.concatenate([rng.uniform(-150, 150, 3), rng.uniform(-angle, angle, 3)])
    turned = turn(pose[3:])
    exact = np.concatenate(points) @ turned.T + pose[:3]
    targets = (rng.uniform(-0.1, 1.1, size=(6, 3)) * scale * SIZE) @ turned.T + pose[:3]
    measured = exact + rng.normal(size=exact.shape) * sigma
    return Casting(pose, np.array(names), measured.round(7), exact, targets.round(7), sigma)  # as in the file
