"""A lens shape that no polynomial has, hidden in simulated images of a board: is it found, named, and extended?

Three kinds in turn: a smooth bump of 0.3 px, a sensor that is tilted by 2 to 5 degrees, a fisheye. The job calibrates a
pinhole with k1 k2 p1 p2. The extended job is adjusted and diagnosed again, and its lens predicts fresh images of the
same camera, whose poses alone are fitted; so does the true lens. Images are drawn by numpy alone.

    python -m benchmarks lens_shapes [KIND ...] [COUNT | FIRST-LAST]
"""

from __future__ import annotations

import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.bars import Rate
from metrocli.adjust.model.chain import LinkContext
from metrocli.adjust.model.observations import Observations
from metrocli.diagnosis.findings import Diagnosis
from metrocli.effects.links.lens_shape import LensShape
from metrocli.instruments.lenses.lens import Lens
from metrocli.project.diagnosed import carry_out, write_extended
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.calibrate_camera.task import prepared, solved

Array = npt.NDArray[np.float64]
Project = Callable[[Array], Array]
"""Takes points in the camera (n, 3) to pixels (n, 2)"""
SIZE, KINDS = (1280, 960), ("bump", "tilt", "fisheye")
CAUSES = {"bump": ("lens-shape",), "tilt": ("sensor-tilt",), "fisheye": ("the lens is a fisheye",)}
"""Names that are right"""
NOISE, COUNT = 0.08, 20
_MIDDLE = (np.array(SIZE) - 1) / 2


def _polynomial(x: Array, y: Array, k: Array) -> tuple[Array, Array]:
    r2 = x * x + y * y
    radial = 1 + k[0] * r2 + k[1] * r2**2
    across, down = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x), k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
    return x * radial + across, y * radial + down


def true_lens(kind: str, rng: np.random.Generator) -> Project:
    """Return a lens with what is hidden in it."""
    f, c = rng.uniform(800, 1100), _MIDDLE + rng.uniform(-15, 15, 2)
    k = np.array([rng.uniform(-0.25, 0.1), rng.uniform(-0.05, 0.1), *rng.uniform(-1e-3, 1e-3, 2)])
    at, wide = rng.uniform(0.2, 0.8, 2) * SIZE, rng.uniform(0.12, 0.25) * SIZE[0]
    way, tau = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(2, 5)) * rng.choice([-1, 1], 2)
    equal = np.array([rng.uniform(-0.02, 0.02), rng.uniform(-0.01, 0.01)])
    turn = Rotation.from_euler("xy", tau).as_matrix()

    def project(points: Array) -> Array:
        x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
        if kind == "fisheye":
            r = np.hypot(x, y)
            angle = np.arctan(r)
            longer = angle * (1 + equal[0] * angle**2 + equal[1] * angle**4) / np.maximum(r, 1e-12)
            return np.asarray(0.62 * f * np.stack([x * longer, y * longer], axis=1) + c)
        x, y = _polynomial(x, y, k)
        if kind == "tilt":
            h = np.stack([x, y, np.ones_like(x)], axis=1) @ turn.T
            # the sensor is the plane z = 1 turned about the principal point
            back = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
            h = h @ back.T
            x, y = h[:, 0] / h[:, 2], h[:, 1] / h[:, 2]
        uv = f * np.stack([x, y], axis=1) + c
        if kind == "bump":
            size = 0.3 * np.exp(-((uv - at) ** 2).sum(axis=1) / (2 * wide**2))
            uv = uv + size[:, None] * [np.cos(way), np.sin(way)]
        return np.asarray(uv)

    return project


@dataclass(frozen=True)
class View:
    """The corners of a board in one image."""

    pose: Array
    target: npt.NDArray[np.intp]
    uv: Array


_BOARD = np.array([[25.0 * i, 25.0 * j, 0.0] for j in range(8) for i in range(11)])


def _seen(pose: Array) -> Array:
    return np.asarray((_BOARD - _BOARD.mean(axis=0)) @ Rotation.from_rotvec(pose[3:]).as_matrix().T + pose[:3])


def views(project: Project, count: int, rng: np.random.Generator) -> Iterator[View]:
    """Yield images of the board wherever it is in the image by at least half."""
    while count:
        distance = rng.uniform(180, 420)
        tilt = Rotation.from_euler("zxy", [rng.uniform(-3, 3), *rng.uniform(-0.6, 0.6, 2)])
        pose = np.concatenate([rng.uniform(-0.5, 0.5, 2) * distance, [distance], tilt.as_rotvec()])
        points = _seen(pose)
        if points[:, 2].min() < 60:
            continue
        uv = project(points)
        inside = ((uv > 4) & (uv < np.array(SIZE) - 5)).all(axis=1)
        if inside.sum() < len(_BOARD) // 2:
            continue
        uv = uv + rng.normal(0, NOISE, uv.shape)
        yield View(pose, np.flatnonzero(inside), uv[inside])
        count -= 1


def held_out(project: Project, fresh: list[View]) -> float:
    """Return the root mean square residual [px] of fresh images whose poses alone are fitted."""
    squares, count = 0.0, 0
    for view in fresh:

        def off(pose: Array, view: View = view) -> Array:
            return np.asarray((project(_seen(pose))[view.target] - view.uv).ravel())

        found = least_squares(off, view.pose, x_scale=[10, 10, 10, 0.1, 0.1, 0.1])
        squares, count = squares + 2 * float(found.cost), count + view.uv.size
    return float(np.sqrt(squares / count))


_JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {{observations: obs.csv, targets: targets.csv}}
noise: {noise} px
camera: {{image_size: [{w}, {h}]}}
output: camera.h5
"""


def write(folder: Path, seen: list[View]) -> Path:
    """Write the job of these images."""
    every = ((i, t, *uv) for i, one in enumerate(seen) for t, uv in zip(one.target, one.uv, strict=True))
    rows = (f"I{i:02d},T{t:03d},{u:.5f},{v:.5f}" for i, t, u, v in every)
    (folder / "obs.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]) + "\n")
    listed = (f"T{i:03d},{x:.3f},{y:.3f},{z:.3f}" for i, (x, y, z) in enumerate(_BOARD - _BOARD.mean(axis=0)))
    (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]) + "\n")
    path = folder / "camera.yaml"
    path.write_text(_JOB.format(noise=NOISE, w=SIZE[0], h=SIZE[1]))
    return path


def fitted(path: Path) -> Project:
    """Return the lens of a job, as adjusted."""
    settings, problem = prepared(content(load(path)))
    blocks, chain = solved(replace(settings, outliers="report"), problem).solution.blocks, problem.images.chain
    links = [link for link in chain.links if isinstance(link, Lens | LensShape)]

    def project(points: Array) -> Array:
        value = points.T
        for link in links:
            local = LinkContext(blocks, Observations(np.zeros((2, len(points))), np.ones(1), {}), frozenset())
            value = link.step(value, local).value
        return np.nan_to_num(value.T, nan=1e6)

    return project


@dataclass(frozen=True)
class Found:
    """What became of one camera."""

    first: Diagnosis
    again: Diagnosis | None
    errors: tuple[float, float, float]
    """Held-out errors [px] of the job, the extended job and the true lens"""
    seconds: float

    @property
    def names(self) -> list[str]:
        """Names of all that was found."""
        own = [one.effect.alternative.effect.name for one in self.first.findings]
        wrong = [] if self.first.mistaken is None else [self.first.mistaken.mistakes[0].words]
        return [*wrong, *own, *(one.effect.name for one in self.first.scatters)]


def found(kind: str, number: int) -> Found:
    """Return what becomes of the camera of a number."""
    rng = np.random.default_rng([411, KINDS.index(kind), number])
    project = true_lens(kind, rng)
    seen, fresh = list(views(project, 24, rng)), list(views(project, 12, rng))
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), seen)
        before = time.process_time()
        job = load(path)
        first = carry_out(job)
        seconds = time.process_time() - before
        extended = write_extended(job, first)
        own = held_out(fitted(path), fresh)
        better, again = own, None
        if extended is not None:
            better, again = held_out(fitted(extended.path), fresh), carry_out(load(extended.path))
    return Found(first, again, (own, better, held_out(project, fresh)), seconds)


def main(arguments: list[str]) -> int:
    """Print each camera and the rates."""
    kinds = [one for one in arguments if one in KINDS] or list(KINDS)
    spans = [span for one in arguments if (span := re.fullmatch(r"(?:(\d+)-)?(\d+)", one))]
    numbers = range(COUNT)
    for span in spans:
        numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    results: dict[str, list[Found]] = {}
    for number in numbers:
        for kind in kinds:
            one = found(kind, number)
            results.setdefault(kind, []).append(one)
            errors = " ".join(f"{error:.4f}" for error in one.errors)
            names = f"{one.first.verdict} {one.names}, then {one.again.verdict if one.again else ''}"
            print(f"{kind} {number}: {names}; {errors} px, {one.seconds:.1f} s", flush=True)
    for kind, each in results.items():
        clean = sum(one.again is not None and one.again.verdict in ("clean", "explained") for one in each)
        print(Rate(f"{kind}: found", sum(one.first.verdict != "clean" for one in each), len(each), least=0.95))
        named = sum(bool(set(one.names) & set(CAUSES[kind])) for one in each)
        print(Rate(f"{kind}: {' or '.join(CAUSES[kind])} named", named, len(each), least=0.95))
        print(Rate(f"{kind}: extended job clean or explained", clean, len(each), least=0.95))
        close = sum(one.errors[1] <= 1.1 * one.errors[2] for one in each)
        print(Rate(f"{kind}: held-out error within 10 % of the true lens", close, len(each), least=0.95))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
