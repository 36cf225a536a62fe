"""Accuracy and time of target detection: dots drawn here, chessboards rendered and real; one thread, CPU time.

Dots: ellipses sampled 16 x 16 finer than the pixels (8 x 8 would put 0.004 px of the drawing's own into every rms),
PSF sigma 0.7 px, grey 30 on 210, 8 bit, random sub-pixel centres and directions; bias and root mean square per axis
against the true centre.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from metrocli.formats.images import read
from metrocli.geometry.rotations import rotation_from_euler
from metrocli.targets import blobs, ellipses
from metrocli.targets.drawings import board
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern, names, pattern_points
from metrocli.targets.render import Look, PlacedDrawing, render

Array = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]

DATA = Path(__file__).parents[1] / "../shared/data"
FINE, PSF, INK, PAPER = 16, 0.7, 30.0, 210.0
SETS = (
    ("opencv-chessboards/left*.jpg", Pattern("chessboard", 9, 6, 25.0)),
    ("opencv-chessboards/right*.jpg", Pattern("chessboard", 9, 6, 25.0)),
    ("sony-chess/frame*.jpg", Pattern("chessboard", 6, 4, 30.0)),
)


def draw(rng: np.random.Generator, diameter: float, aspect: float, noise: float) -> tuple[Grey, Array]:
    """Return a crop with one dark ellipse and its centre."""
    side = int(diameter) + 26
    centre, angle = side / 2 - 0.5 + rng.uniform(-0.5, 0.5, 2), rng.uniform(0, np.pi)
    at = (np.arange(side * FINE) + 0.5) / FINE - 0.5
    du, dv = at - centre[0], (at - centre[1])[:, None]
    along, across = du * np.cos(angle) + dv * np.sin(angle), dv * np.cos(angle) - du * np.sin(angle)
    fine = (along**2 + (across / aspect) ** 2 < diameter**2 / 4).astype(np.float32)
    covered = cv2.GaussianBlur(fine, (0, 0), PSF * FINE).reshape(side, FINE, side, FINE).mean((1, 3))
    grey = PAPER + (INK - PAPER) * covered + noise * rng.standard_normal((side, side))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), centre


def ours(image: Grey) -> Array:
    """Fit the picture of a blurred ellipse, search included."""
    found = max(ellipses.fit_all(image, blobs.ellipses(image, "dark")), key=lambda fit: fit.ellipse.long)
    return np.array(found.ellipse.centre)


def grey_centroid(image: Grey) -> Array:
    """Weight pixels with their darkness, from a tenth of the contrast on."""
    paper = float(np.median(image[:4]))
    depth = paper - image.astype(float)
    weight = np.where(depth > 0.1 * depth.max(), depth, 0.0)
    v, u = np.indices(image.shape)
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


def otsu_centroid(image: Grey) -> Array:
    """Average the pixels below Otsu's threshold."""
    mask = cv2.threshold(image, 0, 1, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1]
    v, u = np.nonzero(mask)
    return np.array([u.mean(), v.mean()])


def contour_ellipse(image: Grey) -> Array:
    """Fit an ellipse to the longest contour of Otsu's mask."""
    mask = cv2.threshold(image, 0, 255, cv2.THRESH_BINARY_INV | cv2.THRESH_OTSU)[1]
    contour = max(cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0], key=len)
    return np.array(cv2.fitEllipse(contour)[0])


def simple_blob(image: Grey) -> Array:
    """Take the most central of OpenCV's SimpleBlobDetector, its filters off."""
    settings = cv2.SimpleBlobDetector_Params()
    settings.filterByCircularity = settings.filterByConvexity = settings.filterByInertia = False
    settings.minArea, settings.maxArea = 4, image.size / 2
    settings.minRepeatability = 1
    found = cv2.SimpleBlobDetector_create(settings).detect(image)
    middle = (np.array(image.shape) - 1) / 2
    points = np.array([point.pt for point in found]).reshape(-1, 2)
    return points[np.argmin(np.linalg.norm(points - middle, axis=1))] if len(points) else np.full(2, np.nan)


METHODS: tuple[tuple[str, Callable[[Grey], Array]], ...] = (
    ("metrocli", ours),
    ("grey centroid", grey_centroid),
    ("contour + fitEllipse", contour_ellipse),
    ("Otsu centroid", otsu_centroid),
    ("SimpleBlobDetector", simple_blob),
)


def dots(count: int = 100) -> None:
    """Print bias and root mean square of each method in px, and its CPU time in microseconds a target."""
    print(f"{'diameter':>8} {'aspect':>6} {'noise':>5}  " + "  ".join(f"{name:>24}" for name, _ in METHODS))
    print(" " * 23 + "  ".join(f"{'bias':>8} {'rms':>7} {'us':>7}" for _ in METHODS))
    for diameter in (6, 8, 10, 16, 30, 60):
        for aspect in (1.0, 0.6):
            for noise in (0, 2):
                cells = _row(np.random.default_rng([diameter, noise]), diameter, aspect, noise, count)
                print(f"{diameter:8d} {aspect:6.1f} {noise:5d}  " + "  ".join(cells), flush=True)


def _row(rng: np.random.Generator, diameter: int, aspect: float, noise: int, count: int) -> list[str]:
    drawn = [draw(rng, diameter, aspect, noise) for _ in range(count)]
    cells = []
    for _, method in METHODS:
        before = time.thread_time()
        centres = np.array([method(image) for image, _ in drawn])
        spent = (time.thread_time() - before) / count * 1e6
        error = centres - np.array([centre for _, centre in drawn])
        cells.append(f"{error.mean():8.4f} {np.sqrt(np.mean(error**2)):7.4f} {spent:7.0f}")
    return cells


def corners_of(method: str, pattern: Pattern, image: Grey) -> dict[str, Array]:
    """Return image points by name of a method: metrocli, SB, or window N."""
    if method == "metrocli":
        found = find(pattern, image)
        return dict(zip(found.targets, found.uv, strict=True))
    rows, columns = pattern.shape
    if method == "SB":
        seen, corners = cv2.findChessboardCornersSB(image, (columns, rows))
    else:
        seen, corners = cv2.findChessboardCorners(image, (columns, rows))
        if seen:
            half = int(method.split()[1])
            corners = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), (3, 100, 1e-4))
    return dict(zip(names(pattern), corners.reshape(-1, 2).astype(float), strict=True)) if seen else {}


def chessboards() -> None:
    """Print what OpenCV's calibration (k1 k2 p1 p2) makes of each method's corners, on real and on rendered boards."""
    print(f"\n{'images':32} {'corners by':12} views    rms  held out      fx      fy  worst view/median")
    sets = [(name, pattern, [read(path) for path in sorted(DATA.glob(name))]) for name, pattern in SETS]
    rendered, pattern = _rendered()
    for name, board_, images in [*sets, ("rendered: fx 533, noise 2", pattern, rendered)]:
        for method in ("metrocli", "SB", "window 3", "window 5", "window 8", "window 11"):
            views = [found for image in images if (found := corners_of(method, board_, image))]
            if len(views) > 2:
                print(
                    f"{name:32} {method:12} {len(views):5d} {_calibration(board_, views, images[0].shape)}", flush=True
                )


def _rendered() -> tuple[list[Grey], Pattern]:
    """Return 13 images of a board in random poses, by a camera with fx = fy = 533 px and k1 = -0.28."""
    rng = np.random.default_rng(13)
    pattern, middle = SETS[0][1], np.array([319.5, 239.5])

    def rays(uv: Array) -> Array:
        far = (uv - middle) / 533.0
        near = far.copy()
        for _ in range(40):
            near = far / (1 - 0.28 * (near**2).sum(1, keepdims=True))
        directions = np.column_stack([near, np.ones(len(near))])
        return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))

    images = []
    while len(images) < 13:
        rotation = rotation_from_euler(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.4, 0.4))
        centre = np.array([*rng.uniform(-50, 50, 2), rng.uniform(320, 420)])
        origin = centre - rotation @ pattern_points(pattern)[1].mean(0)
        placed = PlacedDrawing(board(pattern), rotation, origin)
        image = render((640, 480), rays, [placed], Look(noise=2.0), rng).astype(np.uint8)
        if all(corners_of(method, pattern, image) for method in ("metrocli", "SB", "window 3")):
            images.append(image)
    return images, pattern


def _calibration(pattern: Pattern, views: list[dict[str, Array]], shape: tuple[int, ...]) -> str:
    places = dict(zip(*pattern_points(pattern), strict=True))
    xyz = [np.array([places[name] for name in view], np.float32) for view in views]
    uv = [np.array(list(view.values()), np.float32) for view in views]
    size = shape[1], shape[0]
    solved = cv2.calibrateCameraExtended(xyz, uv, size, None, None, flags=cv2.CALIB_FIX_K3)
    by_view = solved[-1].ravel()
    squares, count = 0.0, 0
    for k in range(len(views)):
        _, camera, lens, *_ = cv2.calibrateCamera(
            xyz[:k] + xyz[k + 1 :], uv[:k] + uv[k + 1 :], size, None, None, flags=cv2.CALIB_FIX_K3
        )
        _, turn, shift = cv2.solvePnP(xyz[k], uv[k], camera, lens)
        off = cv2.projectPoints(xyz[k], turn, shift, camera, lens)[0].reshape(-1, 2) - uv[k]
        squares, count = squares + float((off**2).sum()), count + len(off)
    fx, fy = solved[1][0, 0], solved[1][1, 1]
    ratio = by_view.max() / np.median(by_view)
    return f"{solved[0]:.4f}    {np.sqrt(squares / count):.4f}  {fx:6.2f}  {fy:6.2f}  {ratio:.2f}"


def main() -> None:
    """Print both tables."""
    cv2.setNumThreads(1)
    dots()
    chessboards()


if __name__ == "__main__":
    main()
