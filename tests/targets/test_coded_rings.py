"""Ring-coded targets: every code is read, whatever way it lies, and nothing else is taken for one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from places import SHARED
from targets.camera_for_tests import Camera, about_z, tilted

from metrocli.targets import blobs, ellipses
from metrocli.targets.coded_rings import BITS, arcs, canonical, codes
from metrocli.targets.drawings import Chessboard, CodedRing, Dot
from metrocli.targets.ellipses import fit
from metrocli.targets.find import find
from metrocli.targets.pattern import Pattern
from metrocli.targets.render import RETRO_REFLECTIVE, Look, PlacedDrawing, render

DATA = SHARED / "data"
CAMERA = Camera((900, 700), 1500.0, -0.1)
RINGS = Pattern("coded-rings")


def scene(rng: np.random.Generator, chosen: list[int], radius: float, tilt: float) -> list[PlacedDrawing]:
    """Six targets in random poses on a raster that keeps them apart."""
    places = [(x, y) for x in (-95, 0, 95) for y in (-55, 55)]
    return [
        PlacedDrawing(
            CodedRing(code, radius),
            tilted(rng, tilt),
            np.array([x + rng.uniform(-9, 9), y + rng.uniform(-9, 9), 500.0]),
        )
        for code, (x, y) in zip(chosen, places, strict=False)
    ]


def test_the_list_of_codes() -> None:
    assert len(codes()) == 173
    for code in codes():
        assert canonical(code) == code and code.bit_count() % 2 == 0 and arcs(code) >= 2
    turned = {(code >> k | code << (BITS - k)) & 0xFFF: code for code in codes() for k in range(BITS)}
    assert all(bits ^ 1 << place not in turned for bits in turned for place in range(BITS))


@pytest.mark.parametrize(
    "look",
    [
        pytest.param(Look(noise=2.0), marks=pytest.mark.slow),
        pytest.param(Look(ink=220, paper=20, background=20, noise=2.0), marks=pytest.mark.slow),
        RETRO_REFLECTIVE,
    ],
)
def test_codes_at_six_pixels_ring_width_up_to_sixty_degrees(look: Look) -> None:
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(8):
        chosen = [int(code) for code in rng.choice(codes(), 6, replace=False)]
        placed = scene(rng, chosen, 2.0, np.deg2rad(60))
        found = find(RINGS, render(CAMERA.size, CAMERA.rays, placed, look, rng))
        assert found.targets == tuple(str(code) for code in sorted(chosen))
        true = {str(p.drawing.code): CAMERA.centre_of_image(p.origin, p.rotation, 2.0) for p in placed}  # type: ignore[attr-defined]
        errors += list((found.uv - [true[name] for name in found.targets]) / found.sigma[:, None])
    assert len(errors) == 48
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.3


@pytest.mark.parametrize("step", [9, pytest.param(1, marks=pytest.mark.slow)])
def test_every_code_is_read_in_any_turn(step: int) -> None:
    rng = np.random.default_rng(8)
    camera = Camera((1000, 620), 1500.0)
    places = [(x, y) for x in np.arange(-7, 8) * 20.0 for y in np.arange(-4, 5) * 20.0]
    wanted = codes()[::step]
    for first in range(0, len(wanted), len(places)):
        chosen = wanted[first : first + len(places)]
        placed = [
            PlacedDrawing(CodedRing(code, 2.0), about_z(rng.uniform(0, 7)), np.array([x, y, 500.0]))
            for code, (x, y) in zip(chosen, places, strict=False)
        ]
        found = find(RINGS, render(camera.size, camera.rays, placed, Look(), rng))
        assert found.targets == tuple(str(code) for code in chosen)


@pytest.mark.alike
@pytest.mark.parametrize("diameter", [6, 10, pytest.param(30, marks=pytest.mark.slow)])
def test_centres_agree_with_the_perspective_ellipse(diameter: float) -> None:
    rng = np.random.default_rng(9)
    errors = []
    for _ in range(10):
        rotation, origin = tilted(rng, np.deg2rad(60)), np.array([*rng.uniform(-60, 60, 2), 500.0])
        radius = diameter / 6
        image = render(
            CAMERA.size,
            CAMERA.rays,
            [PlacedDrawing(Dot(radius), rotation, origin)],
            Look(bits=16, ink=3000, paper=50000, background=50000),
            rng,
        )
        found = find(Pattern("dot"), image)
        assert found.targets == ("dot",)
        errors.append(found.uv[0] - CAMERA.centre_of_image(origin, rotation, radius))
    assert np.sqrt(np.mean(np.square(errors))) < 0.003


def test_eccentricity_is_in_the_image() -> None:
    """A large tilted circle's image is centred off the image of its centre, and the detector sees the former."""
    rotation, origin = (
        tilted(np.random.default_rng(3), 0.0) @ np.array([[1, 0, 0], [0, 0.5, -(0.75**0.5)], [0, 0.75**0.5, 0.5]]),
        np.array([0, 0, 300.0]),
    )
    image = render(
        CAMERA.size, CAMERA.rays, [PlacedDrawing(Dot(6.0), rotation, origin)], Look(), np.random.default_rng(1)
    )
    uv = find(Pattern("dot"), image).uv[0]
    assert np.linalg.norm(uv - CAMERA.project(origin[None])[0]) > 0.1
    assert uv == pytest.approx(CAMERA.centre_of_image(origin, rotation, 6.0), abs=0.003)


def test_a_code_seen_twice_is_left_out_and_told() -> None:
    rng = np.random.default_rng(10)
    found = find(RINGS, render(CAMERA.size, CAMERA.rays, scene(rng, [5, 9, 5], 3.0, 0.3), Look(), rng))
    assert found.targets == ("9",)
    assert "5 occur" in found.reason


@pytest.mark.slow
def test_no_code_in_noise_or_chessboards_or_dots() -> None:
    rng = np.random.default_rng(11)
    pictures = [rng.integers(0, 256, (400, 400)).astype(np.uint8)]
    pictures += [cv2.GaussianBlur(rng.integers(0, 256, (400, 400)).astype(np.uint8), (0, 0), s) for s in (1, 2, 4)]
    board = PlacedDrawing(Chessboard(9, 6, 12.0), np.eye(3), np.array([-48, -30, 500.0]))
    pictures.append(render(CAMERA.size, CAMERA.rays, [board], Look(noise=2.0), rng))
    pictures.append(
        render(CAMERA.size, CAMERA.rays, [PlacedDrawing(Dot(3.0), np.eye(3), np.array([0, 0, 500.0]))], Look(), rng)
    )
    for code in (0, 1, 0b111, 0xFFF):
        pictures.append(render(CAMERA.size, CAMERA.rays, scene(rng, [code], 3.0, 0.5), Look(), rng))
    for picture in pictures:
        found = find(RINGS, picture)
        assert len(found) == 0 and "no coded target" in found.reason


@pytest.mark.slow
@pytest.mark.skipif(not DATA.exists(), reason="../shared/data is not there")
def test_no_code_in_real_images() -> None:
    for path in sorted(DATA.glob("*/*.jpg"))[::3]:
        assert len(find(RINGS, cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))) == 0, path


@pytest.mark.slow
def test_a_dot_among_thousands_of_specks_is_found_and_few_of_them_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    sheet = np.full((600, 800), 100.0)
    sheet[rng.integers(0, 600, 4000), rng.integers(0, 800, 4000)] += 250
    u, v = np.meshgrid(np.arange(800), np.arange(600))
    sheet = np.where(np.hypot(u - 300.25, v - 400.5) < 16, 100.0, sheet)
    sheet += 60 * np.clip(10.5 - np.hypot(u - 300.25, v - 400.5), 0, 1)
    picture = cv2.GaussianBlur(sheet, (0, 0), 1.0).round().astype(np.uint8)
    fitted = []
    monkeypatch.setattr(ellipses, "fit", lambda *what: fitted.append(what) or fit(*what))
    found = find(Pattern("dot", polarity="bright"), picture)
    assert len(blobs.ellipses(picture, "bright")) > 5 * len(fitted)
    assert found.uv[0] == pytest.approx([300.25, 400.5], abs=0.05)


def test_dots_that_cannot_be_told_apart() -> None:
    rng = np.random.default_rng(12)
    two = [PlacedDrawing(Dot(3.0), np.eye(3), np.array([x, 0, 500.0])) for x in (-40, 40)]
    found = find(Pattern("dot", target="T1"), render(CAMERA.size, CAMERA.rays, two, Look(), rng))
    assert len(found) == 0 and "2 dots" in found.reason and "T1" in found.reason
    assert "no dot" in find(Pattern("dot"), np.zeros((50, 60), np.uint8)).reason
