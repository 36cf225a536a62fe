"""Boards: points where they were drawn, the order checked and mended, and what real images give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from places import SHARED
from targets.camera_for_tests import Array, Camera, about_z, tilted

from metrocli.targets.drawings import board
from metrocli.targets.find import MODULES, find
from metrocli.targets.lattice import order_fault, ordered
from metrocli.targets.likely_board import likely_board
from metrocli.targets.pattern import TYPES, Pattern, lattice, names, pattern_points
from metrocli.targets.render import Look, PlacedDrawing, render

DATA = SHARED / "data"
real = pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not there")
CAMERA = Camera((640, 480), 533.0, -0.28)
CHESS = Pattern("chessboard", 9, 6, 25.0)
CHARUCO = Pattern("charuco", 8, 5, 25.0, marker_size=15.0)
APRIL = Pattern("aprilgrid", 5, 4, 39.0, marker_size=30.0)
CIRCLES = Pattern("circles", 10, 8, 20.0, diameter=10.0)
SHIFTED = Pattern("asymmetric-circles", 4, 11, 16.0, diameter=12.0)


def seen(
    pattern: Pattern, rng: np.random.Generator, look: Look, distance: float = 360.0, turn: float = 0.4
) -> tuple[np.ndarray, Array]:
    """Return an image of a board and the true image points of all its points."""
    _, xyz = pattern_points(pattern)
    rotation = tilted(rng, 0.6, upright=True) @ about_z(rng.uniform(-turn, turn))
    origin = np.array([*rng.uniform(-12, 12, 2), distance]) - rotation @ xyz.mean(0)
    return render(
        CAMERA.size, CAMERA.rays, [PlacedDrawing(board(pattern), rotation, origin)], look, rng
    ), CAMERA.project(xyz @ rotation.T + origin)


def test_every_type_has_its_module() -> None:
    assert set(MODULES) == set(TYPES)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [CHESS, CHARUCO, APRIL])
def test_corners_rest_on_the_edges(pattern: Pattern) -> None:
    """Also pins the pixel convention: half a pixel would be 500 times the limit."""
    image, true = seen(pattern, np.random.default_rng(1), Look())
    found = find(pattern, image)
    rows = [names(pattern).index(name) for name in found.targets]
    assert len(rows) >= 0.9 * len(true), found.reason
    error = found.uv - true[rows]
    assert np.sqrt(np.mean(error**2)) < 0.0015
    assert np.abs(error).max() < 0.006
    away = true[rows] - CAMERA.middle
    assert abs((error * away).sum() / (away**2).sum()) * CAMERA.f < 0.005, "focal length would be off"


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [CHESS, CHARUCO, APRIL])
def test_corners_know_their_scatter(pattern: Pattern) -> None:
    image, true = seen(pattern, np.random.default_rng(2), Look(noise=3.0))
    found = find(pattern, image)
    rows = [names(pattern).index(name) for name in found.targets]
    assert len(rows) >= 0.9 * len(true)
    assert 0.85 < np.sqrt(np.mean(((found.uv - true[rows]) / found.sigma[:, None]) ** 2)) < 1.2


def test_a_board_at_the_edge_of_an_unevenly_lit_image_is_found() -> None:
    """OpenCV's fast search and the sector-based one that is not exhaustive miss it."""
    rng, pattern = np.random.default_rng(27), Pattern("chessboard", 7, 4, 25.0)
    look = Look(noise=2.0, blur=rng.uniform(0.5, 2), ink=rng.uniform(10, 60), paper=rng.uniform(80, 200))
    image, true = seen(pattern, rng, replace(look, background=rng.uniform(0, 250)), distance=150)
    v, u = np.indices(image.shape)
    light = np.exp(rng.normal(0, 0.6) * (u / 640 - 0.5) + rng.normal(0, 0.6) * (v / 480 - 0.5))
    found = find(pattern, (image * light).clip(0, 255).astype(np.uint8))
    rows = [names(pattern).index(name) for name in found.targets]
    assert len(rows) == len(true), found.reason
    assert np.abs(found.uv - true[rows]).max() < 1


@pytest.mark.parametrize(
    ("columns", "rows"), [(8, 6), *(pytest.param(*size, marks=pytest.mark.slow) for size in ((9, 5), (8, 5)))]
)
def test_a_part_of_a_chessboard_is_not_taken_for_the_board(columns: int, rows: int) -> None:
    rng = np.random.default_rng(9)
    image, _ = seen(CHESS, rng, Look(noise=2.0))
    found = find(Pattern("chessboard", columns, rows, 25.0), image)
    assert len(found) == 0 and found.reason.startswith("no chessboard")


@real
def test_a_part_of_a_real_chessboard_is_not_taken_for_the_board() -> None:
    """OpenCV finds 8 columns of the 9 in this image, with corners as good as the others."""
    picture = cv2.imread(str(DATA / "opencv-chessboards/left02.jpg"), cv2.IMREAD_GRAYSCALE)
    assert cv2.findChessboardCorners(picture, (8, 6))[0], "OpenCV no longer shows the fault that this test is about"
    found = find(Pattern("chessboard", 8, 6, 25.0), picture)
    assert found.reason == "no chessboard: the board has more than 8 x 6 inner corners"


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [CIRCLES, SHIFTED])
def test_circles_have_their_names(pattern: Pattern) -> None:
    image, true = seen(pattern, np.random.default_rng(3), Look(noise=2.0))
    found = find(pattern, image)
    assert found.targets == names(pattern), found.reason
    assert np.abs(found.uv - true).max() < 0.3, "more than eccentricity explains"
    assert np.isfinite(found.axes).all() and np.isfinite(found.sigma).all()


@pytest.mark.slow
def test_a_chessboard_upside_down_keeps_its_names() -> None:
    rng = np.random.default_rng(4)
    _, xyz = pattern_points(CHESS)
    for turn in (np.pi / 2, np.pi):
        rotation = about_z(turn)
        origin = np.array([0, 0, 400.0]) - rotation @ xyz.mean(0)
        image = render(CAMERA.size, CAMERA.rays, [PlacedDrawing(board(CHESS), rotation, origin)], Look(), rng)
        found = find(CHESS, image)
        assert found.targets == names(CHESS)
        assert np.abs(found.uv - CAMERA.project(xyz @ rotation.T + origin)).max() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("pattern", [CHESS, CIRCLES, SHIFTED])
def test_points_in_any_order_are_put_into_theirs(pattern: Pattern) -> None:
    rng = np.random.default_rng(5)
    _, true = seen(pattern, rng, Look())
    strays = rng.uniform((0, 0), CAMERA.size, (6, 2))
    strays = strays[np.linalg.norm(strays[:, None] - true, axis=2).min(1) > 8]
    mixed = rng.permutation(np.concatenate([true, strays]))
    rows, reason = ordered(lattice(pattern), mixed)
    assert reason == ""
    np.testing.assert_array_equal(mixed[rows], true)


def test_wrong_orders_are_noticed() -> None:
    rng = np.random.default_rng(6)
    steps = lattice(CIRCLES)
    _, true = seen(CIRCLES, rng, Look())
    assert order_fault(steps, true) == ""
    assert "flat board" in order_fault(steps, true[rng.permutation(len(true))])
    swapped = true.copy()
    swapped[[33, 34]] = swapped[[34, 33]]
    assert "neighbours' middle" in order_fault(steps, swapped)
    shifted = true.copy()
    shifted[40:50] = np.roll(shifted[40:50], 1, axis=0)
    assert "flat board" in order_fault(steps, shifted)


@pytest.mark.alike
@pytest.mark.parametrize("pattern", [CHESS, CHARUCO, APRIL, CIRCLES, SHIFTED])
def test_an_image_without_the_board(pattern: Pattern) -> None:
    noise = np.random.default_rng(7).integers(0, 256, (240, 320)).astype(np.uint8)
    for picture in (
        noise,
        np.zeros((240, 320), np.uint8),
        np.full((9, 9), 255, np.uint8),
        noise.astype(np.uint16) * 257,
    ):
        found = find(pattern, picture)
        assert len(found) == 0 and found.reason.startswith("no ")


def test_settings_of_a_board_are_complete() -> None:
    assert [key for key, _ in Pattern("circles").faults()] == ["columns", "rows", "pitch"]
    assert [key for key, _ in Pattern("charuco", 5, 4, 10.0).faults()] == ["marker_size"]
    assert [key for key, _ in Pattern("charuco", 5, 4, 10.0, marker_size=10.0).faults()] == ["marker_size"]
    assert not [*Pattern("coded-rings").faults(), *Pattern("dot").faults(), *CHESS.faults()]


def calibrated(pattern: Pattern, paths: list[Path]) -> tuple[float, float, Array, int]:
    """Return RMS, fx, RMS per view and the number of views, by OpenCV with k1 k2 p1 p2."""
    index = dict(zip(*(names(pattern), range(len(names(pattern)))), strict=True))
    _, xyz = pattern_points(pattern)
    board_points, image_points = [], []
    for path in paths:
        found = find(pattern, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
        if len(found):
            board_points.append(xyz[[index[name] for name in found.targets]].astype(np.float32))
            image_points.append(found.uv.astype(np.float32))
    solved = cv2.calibrateCameraExtended(board_points, image_points, CAMERA.size, None, None, flags=cv2.CALIB_FIX_K3)
    return solved[0], solved[1][0, 0], solved[-1].ravel(), len(board_points)


@real
@pytest.mark.parametrize(
    ("files", "pattern", "rms", "fx"),
    [
        ("opencv-chessboards/left*.jpg", CHESS, 0.162, 533.8),
        pytest.param("opencv-chessboards/right*.jpg", CHESS, 0.160, 537.4, marks=pytest.mark.slow),
        pytest.param("sony-chess/frame*.jpg", Pattern("chessboard", 6, 4, 30.0), 0.141, 709.0, marks=pytest.mark.slow),
    ],
)
def test_real_chessboards(files: str, pattern: Pattern, rms: float, fx: float) -> None:
    """All 13 views are found, none is an outlier, and the RMS is far below that of OpenCV's corners (0.235, 0.236, 0.154)."""
    got, focal, by_view, views = calibrated(pattern, sorted(DATA.glob(files)))
    assert views == 13
    assert got < rms
    assert focal == pytest.approx(fx, abs=0.3)
    assert by_view.max() < 2.5 * np.median(by_view)


@pytest.mark.slow
@real
def test_real_circles_where_opencv_gives_a_wrong_order() -> None:
    pattern = Pattern("circles", 10, 8, 25.0, diameter=15.0)
    picture = cv2.imread(str(DATA / "sony-circles/image00001.jpg"), cv2.IMREAD_GRAYSCALE)
    blobs = cv2.SimpleBlobDetector_Params()
    blobs.maxArea, blobs.minRepeatability = 5000, 1
    detector = cv2.SimpleBlobDetector_create(blobs)
    flags = cv2.CALIB_CB_SYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    claimed, centres = cv2.findCirclesGrid(picture, (10, 8), flags=flags, blobDetector=detector)
    assert claimed, "OpenCV no longer shows the fault that this test is about"
    assert "flat board" in order_fault(lattice(pattern), centres.reshape(-1, 2).astype(float))
    rows, reason = ordered(lattice(pattern), centres.reshape(-1, 2).astype(float))
    assert (
        reason == ""
        and order_fault(lattice(pattern)[rows >= 0], centres.reshape(-1, 2).astype(float)[rows[rows >= 0]]) == ""
    )
    found = find(pattern, picture)
    assert len(found) == 80 and order_fault(lattice(pattern), found.uv) == ""
    rms, focal, by_view, views = calibrated(pattern, sorted(DATA.glob("sony-circles/*.jpg")))
    assert views == 6
    assert rms < 0.49 and focal == pytest.approx(456.4, abs=3)
    assert by_view.max() < 2.5 * np.median(by_view)


@pytest.mark.alike
@pytest.mark.parametrize(
    ("columns", "rows", "words"),
    [
        (11, 4, "4 x 11: is it columns: 4, rows: 11?"),
        pytest.param(5, 10, "4 x 11: is it columns: 4, rows: 11?", marks=pytest.mark.slow),
        (4, 8, "4 x 11: is it columns: 4, rows: 11?"),
    ],
)
def test_circles_counted_in_the_other_order_are_no_chessboard(columns: int, rows: int, words: str) -> None:
    image, _ = seen(SHIFTED, np.random.default_rng(3), Look())
    assert likely_board(Pattern("asymmetric-circles", columns, rows, 16.0, diameter=12.0), [image]) == words


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(3))
def test_circles_on_a_grained_surface_are_found_and_named(seed: int) -> None:
    """Grain of a quarter of the contrast makes hundreds of faint ellipses, and no circle fits its grey values well."""
    rng, pattern = np.random.default_rng(seed), replace(SHIFTED, pitch=14.0, diameter=10.0)
    image, true = seen(pattern, rng, Look(ink=70, paper=120, background=120))
    grain = cv2.GaussianBlur(rng.normal(0, 1, image.shape), (0, 0), 0.7)
    image = (image + 10 * grain / grain.std()).clip(0, 255).astype(np.uint8)
    found = find(pattern, image)
    rows = [names(pattern).index(name) for name in found.targets]
    assert len(rows) >= 0.9 * len(true), found.reason
    assert np.sqrt(np.mean((found.uv - true[rows]) ** 2)) < 0.25
    wrong = Pattern("chessboard", 9, 6, 25.0)
    assert "is it type: asymmetric-circles, columns: 4, rows: 11?" in likely_board(wrong, [image])
