"""The real sets: their jobs, and what an adequate model of each estimates."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from benchmarks.fetched import Images
from benchmarks.one_board import CAMERAS, IMAGES
from benchmarks.real.boards import Array, Board
from metrocli.formats import images
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern, pattern_points

DATA = Path(__file__).parents[3] / "shared" / "data"
LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {{observations: {stem}.observations.csv, targets: {stem}.targets.csv}}
camera: {{image_size: [{width}, {height}], estimate: [{estimate}]}}
noise: {noise} px
output: camera.h5
"""
_FEWEST = 5
"""Images of a part"""
RANGES = """metrocli: 1
job: multilaterate
inputs: {{lengths: {stem}_lengths.csv, points: {stem}_points.csv, tracers: {stem}_tracers.csv}}
measures: absolute
noise: {{constant: 500 mm}}
outliers: remove
effects: {effects}
output: beacons.h5
"""


@dataclass(frozen=True)
class BoardSet:
    """Images of a board."""

    name: str
    stem: str
    """Of its corners, or a pattern of image files"""
    noise: float
    """Declared noise of a corner [px]"""
    pattern: Pattern | None = None
    """Where the corners are found here"""
    size: tuple[int, int] = (640, 480)
    folder: Path = DATA

    def read(self, folder: Path) -> Board:
        """Return its corners, found in the images if nobody has."""
        if self.pattern is None:
            return Board.read(self.folder / self.stem, self.size)
        names, points = pattern_points(self.pattern)
        stem = folder / self.name
        with Path(f"{stem}.observations.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("image", "target", "u_px", "v_px"))
            for path in sorted(self.folder.glob(self.stem)):
                found = find(self.pattern, images.read(path))
                writer.writerows((path.name, t, *uv) for t, uv in zip(found.targets, found.uv.tolist(), strict=True))
        with Path(f"{stem}.targets.csv").open("w", newline="", encoding="utf-8") as file:
            rows = [(name, *place) for name, place in zip(names, np.asarray(points).tolist(), strict=True)]
            csv.writer(file).writerows([("target", "x_mm", "y_mm", "z_mm"), *rows])
        return Board.read(stem, self.size)

    def job(
        self, folder: Path, board: Board, estimate: tuple[str, ...], of_images: Mapping[str, Array] | None = None
    ) -> Path:
        """Write the job of a board with its corners, with further columns perhaps; return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        board.written(folder / "board", of_images)
        width, height = board.size
        names = ", ".join(estimate)
        text = JOB.format(stem="board", width=width, height=height, estimate=names, noise=self.noise)
        (folder / "job.yaml").write_text(text, encoding="utf-8")
        return folder / "job.yaml"


@dataclass(frozen=True)
class PartOfBoard(BoardSet):
    """Some of the images of a board, drawn at random: a smaller set of another geometry."""

    whole: BoardSet | None = None
    seed: int = 0

    @classmethod
    def of(cls, whole: BoardSet, seed: int) -> PartOfBoard:
        """Return at least five of the images of a set, chosen by a seed."""
        known = {each.name: getattr(whole, each.name) for each in fields(BoardSet)}
        return cls(**known | {"name": f"{whole.name} part {seed}"}, whole=whole, seed=seed)

    def read(self, folder: Path) -> Board:
        """Return the corners of the images that are drawn."""
        board = (self.whole or self).read(folder)
        rng = np.random.default_rng([self.seed, *self.name.encode()])
        count = int(rng.integers(min(_FEWEST, len(board.images)), len(board.images) + 1))
        return board.only(np.sort(rng.permutation(len(board.images))[:count]))


BOARDS = (
    BoardSet("left", "opencv-chessboards/left", 0.15),
    BoardSet("left_SB", "opencv-chessboards/left_SB", 0.1),
    BoardSet("right", "opencv-chessboards/right*.jpg", 0.1, Pattern("chessboard", 9, 6, 25.0)),
    BoardSet("sony-chess", "sony-chess/points", 0.1),
    BoardSet("sony-circles", "sony-circles/image0000[02345].jpg", 0.1, Pattern("circles", 8, 10, 25.0, diameter=15.0)),
)
ENDOSCOPE = Images(
    "endocal",
    "endocal-18.2.13-py2.py3-none-any.whl",
    "5dacf1bc3340f5295e74dc01b57fb5d79cce15f6d77e8d3b119f1255eef97482",
    "endocal/data/sample_001",
)
BOARD = Pattern("chessboard", 7, 4, 60.0)
CIRCLES = Pattern("asymmetric-circles", 3, 11, 1.0, diameter=0.86, polarity="dark")
FETCHED = {
    IMAGES: [BoardSet(one, f"{one}_*.jpg", 0.05, BOARD, (1088, 1920), IMAGES.folder) for one in CAMERAS],
    ENDOSCOPE: [BoardSet("endoscope", "frame_*.jpg", 0.12, CIRCLES, (768, 710), ENDOSCOPE.folder)],
}
"""Four cameras that see one board, and an endoscope (Endocal 18.2.13, BSD 3-Clause): no number was set on them"""
DRIVES = ("plaza1", "plaza2")


def ranges_job(folder: Path, drive: str, effects: str, lengths: Mapping[str, list[str]] | None = None) -> Path:
    """Write the job of a drive, with other lengths perhaps (columns of its file); return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    source = DATA / "plaza-ranges"
    for what in ("points", "tracers", "lengths"):
        (folder / f"{drive}_{what}.csv").write_text((source / f"{drive}_{what}.csv").read_text(), encoding="utf-8")
    if lengths is not None:
        with (folder / f"{drive}_lengths.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([tuple(lengths), *zip(*lengths.values(), strict=True)])
    (folder / "job.yaml").write_text(RANGES.format(stem=drive, effects=effects), encoding="utf-8")
    return folder / "job.yaml"
