"""Centres of ellipses: the accuracy and the standard deviations that docs/targets.md promises."""

from __future__ import annotations

import numpy as np
import pytest
from targets import drawn

from metrocli.targets import blobs
from metrocli.targets.blobs import Ellipse
from metrocli.targets.ellipses import FittedEllipse, fit


def draws(
    diameter: float, aspect: float, noise: float, count: int, light: float = 0.0
) -> tuple[drawn.Array, drawn.Array]:
    """Return errors (count, 2) and sigmas (count,) of the fit, started from what the blob search finds."""
    rng = np.random.default_rng([int(diameter), int(10 * aspect), int(noise)])
    errors, sigmas = [], []
    for _ in range(count):
        image, centre, _ = drawn.ellipse(rng, diameter, aspect, noise, light)
        fits = [found for found in (fit(image, start) for start in blobs.ellipses(image, "bright")) if found]
        assert fits
        best = max(fits, key=lambda found: found.ellipse.long)
        errors.append([best.ellipse.u - centre[0], best.ellipse.v - centre[1]])
        sigmas.append(best.sigma)
    return np.array(errors), np.array(sigmas)


@pytest.mark.alike
@pytest.mark.parametrize("aspect", [pytest.param(1.0, marks=pytest.mark.slow), 0.6])
@pytest.mark.parametrize(("diameter", "limit"), [(6, 0.012), (10, 0.006), (30, 0.006)])
def test_centres_with_noise(diameter: int, aspect: float, limit: float) -> None:
    errors, sigmas = draws(diameter, aspect, 2.0, 50)
    assert np.sqrt(np.mean(errors**2)) < limit
    assert np.abs(errors.mean(0)).max() < 4 * np.sqrt(np.mean(errors**2) / len(errors))
    assert 0.85 < np.sqrt(np.mean(errors**2 / sigmas[:, None] ** 2)) < 1.25


@pytest.mark.alike
@pytest.mark.parametrize("aspect", [pytest.param(1.0, marks=pytest.mark.slow), 0.5])
@pytest.mark.parametrize("diameter", [6, 10, 30])
def test_centres_without_noise(diameter: int, aspect: float) -> None:
    errors, _ = draws(diameter, aspect, 0.0, 20)
    assert np.sqrt(np.mean(errors**2)) < 0.003


def test_uneven_light_does_not_move_the_centre() -> None:
    errors, sigmas = draws(20, 1.0, 1.0, 30, light=0.1)
    assert np.abs(errors.mean(0)).max() < 0.003
    assert np.sqrt(np.mean(errors**2 / sigmas[:, None] ** 2)) < 1.4


def test_axes_and_angle() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        image, centre, angle = drawn.ellipse(rng, 24, 0.6, 0.0)
        found = fit(image, Ellipse(*centre, 11.0, 8.0, angle + 0.2))
        assert found is not None
        assert found.ellipse.long == pytest.approx(12.0, abs=0.06)
        assert found.ellipse.short == pytest.approx(7.2, abs=0.1)
        assert np.sin(found.ellipse.angle - angle) == pytest.approx(0, abs=0.01)


def test_sixteen_bits_and_dark_targets() -> None:
    image, centre, angle = drawn.ellipse(np.random.default_rng(5), 14, 0.8, 0.0, ink=20, paper=200)
    deep = image.astype(np.uint16) * 200
    for picture in (image, deep):
        found = fit(picture, Ellipse(centre[0] + 0.3, centre[1], 6.5, 6.0, angle))
        assert isinstance(found, FittedEllipse)
        assert found.contrast < 0
        assert (found.ellipse.u, found.ellipse.v) == pytest.approx(tuple(centre), abs=0.004)


@pytest.mark.parametrize("start", [(0.0, 0.0), (-50.0, 5.0), (19.0, 19.0), (500.0, 3.0)])
def test_nothing_there_is_no_target(start: tuple[float, float]) -> None:
    flat = np.full((40, 40), 100, np.uint8)
    found = fit(flat, Ellipse(*start, 5.0, 5.0))
    assert found is None or found.misfit > 0.12


@pytest.mark.parametrize("left", [0.75, 0.97])
def test_an_ellipse_that_the_border_cuts_is_left_out(left: float) -> None:
    """Half an ellipse has ten times the scatter of a whole one, and every target of an image has the same weight."""
    image, centre, _ = drawn.ellipse(np.random.default_rng(5), 24, 1.0, 2.0)
    cut = np.ascontiguousarray(image[int(centre[1] + 12 - 24 * left) :])
    fits = [fit(cut, start) for start in [Ellipse(centre[0], centre[1] - len(image) + len(cut), 12.0, 12.0)]]
    assert any(fits) == (left > 0.9)
