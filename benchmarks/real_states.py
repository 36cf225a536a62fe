"""Causes of single series, drifts, shapes of lens and board, planted into real images: how often `diagnose` names them.

The middle images are a series of their own, by their file names, or all have times and temperatures that somebody may
have noted. With what an adjustment by numpy (benchmarks/real/boards.py) has of it in the set, each cause is 2 and 4
times the least size that the diagnosis states for the set as it is, in a random direction. What the set as it is has of
a cause is known to first order only, so no interval is judged. Sets that are absent are named and left out.

    python -m benchmarks real_states [SET ...]    # left left_SB right sony-chess sony-circles
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bars import Rate
from benchmarks.real import boards
from benchmarks.real.boards import Array, Board, Fit, Model
from benchmarks.real.sets import BOARDS, DATA, LENS, BoardSet
from benchmarks.real_causes import Case, diagnosed

TIMES = (2.0, 4.0)
SERIES, OTHER = "evening", "morning"
INTERVAL = 30.0
"""Seconds from image to image"""


@dataclass(frozen=True)
class Scene:
    """A set of images, adjusted without metrocli."""

    board: Board
    fit: Fit

    @cached_property
    def predicted(self) -> Array:
        """Image coordinates of the corners by the fit, (n, 2)."""
        return boards.predicted(self.board, self.fit.values, self.fit.shifts, self.fit.poses)

    @property
    def off_axis(self) -> Array:
        """Image coordinates from the principal point, (n, 2)."""
        return self.predicted - [self.fit.values["cx"], self.fit.values["cy"]]

    @property
    def evening(self) -> Array:
        """1 for the images of the middle, 0 for the others, (images,)."""
        count = len(self.board.images)
        return (np.abs(np.arange(count) - (count - 1) / 2) <= count / 5).astype(float)

    @property
    def time(self) -> Array:
        """Seconds of each image, (images,)."""
        return INTERVAL * np.arange(len(self.board.images))

    @property
    def warming(self) -> Array:
        """Temperature above the beginning of each image, as of a room with a heating, (images,) K."""
        return 6 * (1 - np.exp(-self.time / 150)) - 2.5 * np.sin(self.time / 60)

    def each(self, of_images: Array) -> Array:
        """Return values of images for their corners, (n, 1)."""
        return of_images[self.board.image][:, None]

    def with_values(self, **sizes: float) -> Array:
        """Return the change of image coordinates by changes of parameters, (n, 2)."""
        values = {**self.fit.values, **{name: self.fit.values.get(name, 0.0) + size for name, size in sizes.items()}}
        return boards.predicted(self.board, values, self.fit.shifts, self.fit.poses) - self.predicted

    def tilted(self, about_x: float, about_y: float) -> Array:
        """Return the change of image coordinates on a sensor that is tilted, (n, 2): the rays meet its plane."""
        focal = np.array([self.fit.values["fx"], self.fit.values["fy"]])
        x, y = (self.off_axis / focal).T
        (sx, sy), (cx, cy) = np.sin([about_x, about_y]), np.cos([about_x, about_y])
        depth = sy * x - cy * sx * y + cy * cx
        return np.stack([cx * x / depth, (cy * y - sx * sy * x) / depth], axis=1) * focal - self.off_axis


@dataclass(frozen=True)
class Cause:
    """A cause with the change that it makes, by its sizes in the units of the reports."""

    name: str
    change: Callable[[Scene, Sequence[float]], Array]
    steps: tuple[float, ...]
    """Small sizes, from which its derivatives are taken"""
    file: str = ""
    """`series` where images are named by it, `times` where the file has times and temperatures"""
    by: str = ""


CAUSES = {
    "series-principal-point": Cause(
        "series-principal-point", lambda s, z: s.each(s.evening) * np.array(z), (1.0, 1.0), "series"
    ),
    "series-focal-length": Cause(
        "series-focal-length", lambda s, z: s.each(s.evening) * s.off_axis * z[0], (1e-3,), "series"
    ),
    "focal-drift by time": Cause("focal-drift", lambda s, z: s.each(s.time) * s.off_axis * z[0], (1e-6,), "times", "t"),
    "focal-drift by temperature": Cause(
        "focal-drift", lambda s, z: s.each(s.warming) * s.off_axis * z[0], (1e-4,), "times", "T"
    ),
    "principal-point-drift": Cause(
        "principal-point-drift", lambda s, z: s.each(s.time) * np.array(z), (1e-3, 1e-3), "times"
    ),
    "sensor-tilt": Cause("sensor-tilt", lambda s, z: s.tilted(*z), (1e-3, 1e-3)),
    "radial-distortion k3": Cause("radial-distortion", lambda s, z: s.with_values(k3=z[0]), (1e-2,)),
    "target-plane-bend": Cause(
        "target-plane-bend", lambda s, z: s.with_values(bxx=z[0], bxy=z[1], byy=z[2]), (1e-6, 1e-6, 1e-6)
    ),
}


def of_set(one: BoardSet, folder: Path) -> Iterator[Case]:
    """Yield the cases of a set of images."""
    board = one.read(folder)
    scene = Scene(board, boards.fitted(board, Model(LENS)))
    as_it_is: dict[str, Mapping[str, Any]] = {}
    for at, (title, cause) in enumerate(CAUSES.items()):
        named, columns = board, dict[str, Array]()
        if cause.file == "series":
            series = [SERIES if there else OTHER for there in scene.evening]
            named = replace(board, images=tuple(f"{name}_{i:02d}.png" for i, name in enumerate(series)))
        elif cause.file == "times":
            columns = {"t_s": scene.time, "temp_degC": 20 + scene.warming}
        if cause.file not in as_it_is:
            as_it_is[cause.file] = diagnosed(one.job(folder / f"as-is-{cause.file}", named, LENS, columns), False)[0]
        plain = as_it_is[cause.file]
        spot = _candidate(plain, cause)
        if spot is None or spot["minimal_detectable"] is None or spot["status"] == "named":
            continue
        least, truth = float(spot["minimal_detectable"]["value"]), _spot(spot)
        direction = np.random.default_rng([20261129, at, *one.name.encode()]).normal(size=len(cause.steps))
        direction /= np.linalg.norm(direction)
        units = np.eye(len(cause.steps)) * cause.steps
        signature = np.stack([cause.change(scene, unit.tolist()) / unit.sum() for unit in units], axis=-1)
        contained = scene.fit.contained(signature)
        for times in TIMES:
            true = times * least * direction
            uv = board.uv + cause.change(scene, (true - contained).tolist())
            job = one.job(folder / f"{title}-{times:g}", replace(named, uv=uv), LENS, columns)
            data, seconds, _ = diagnosed(job, extend=False)
            names = frozenset(map(_spot, plain["effects"]))
            yield Case(
                f"{one.name}: {title} {times:g}x", f"{times:g}x", data, seconds, truth, tuple(true.tolist()), names
            )


def _candidate(data: Mapping[str, Any], cause: Cause) -> Mapping[str, Any] | None:
    """Return what a diagnosis states of a cause where it was planted, None if it is not a candidate there."""
    rows = [row for row in data["candidates"] if row["name"] == cause.name]
    if cause.by:
        rows = [row for row in rows if row["where"].get("by") == cause.by]
    if cause.file == "series":
        rows = [row for row in rows if any(str(place).startswith(SERIES) for place in row["where"].values())]
    return rows[0] if rows else None


def _spot(row: Mapping[str, Any]) -> tuple[str, tuple[str, ...]]:
    return row["name"], tuple(str(place) for key, place in row["where"].items() if key != "by")


def main(arguments: list[str]) -> int:
    """Print the cases and their rates; return 1 where a bar is not met."""
    cases: list[Case] = []
    for one in BOARDS:
        if arguments and one.name not in arguments:
            continue
        if not (DATA / one.stem).parent.is_dir():
            print(f"{one.name}: no data at hand")
            continue
        with tempfile.TemporaryDirectory() as folder:
            for case in of_set(one, Path(folder)):
                print(case, flush=True)
                cases.append(case)
    met = True
    for times in TIMES:
        of = [case for case in cases if case.sort == f"{times:g}x"]
        for what, count in (("named", sum(case.found for case in of)), ("first", sum(case.first for case in of))):
            rate = Rate(f"planted {times:g}x: {what}", count, len(of), least=0.9)
            print(rate)
            met &= rate.met
    wrong = Rate("false exclusions", sum(case.false_exclusion for case in cases), len(cases), most=0.0)
    print(wrong)
    return 0 if met and wrong.met else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
