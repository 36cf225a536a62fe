"""One lens in the words of others: backward distortion, the photogrammetric form, and where a model folds over."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.instruments.lenses.conventions import converted, image_grid, photogrammetric, projection_range
from metrocli.instruments.lenses.lens import ideal_point, image_point

SIZE = (2400, 1800)
FORWARD = {"f": 2600.0, "cx": 1210.0, "cy": 885.0, "k1": -0.12, "k2": 0.09, "k3": -0.02, "p1": 4e-4, "p2": -3e-4}


@pytest.mark.parametrize("convention", ["forward", "backward"])
def test_the_other_convention_sees_the_same_rays(convention: str) -> None:
    other = "backward" if convention == "forward" else "forward"
    found = converted(FORWARD, convention, SIZE)
    u, v = image_grid(SIZE)
    gap = [
        found.values["f"] * (a - b)
        for a, b in zip(ideal_point(FORWARD, u, v, convention), ideal_point(found.values, u, v, other), strict=True)
    ]
    distance = np.hypot(*gap)
    assert found.largest < 0.3
    assert distance.max() == pytest.approx(found.largest, rel=0.15)
    assert np.sqrt((distance**2).mean()) == pytest.approx(found.rms, rel=0.15)
    assert {name: found.values[name] for name in ("f", "cx", "cy")} == {
        name: FORWARD[name] for name in ("f", "cx", "cy")
    }


def test_there_and_back_is_nearly_the_same_lens() -> None:
    there = converted(FORWARD, "forward", SIZE)
    back = converted(there.values, "backward", SIZE)
    u, v = image_grid(SIZE)
    one, two = ideal_point(FORWARD, u, v), ideal_point(back.values, u, v)
    assert FORWARD["f"] * np.hypot(one[0] - two[0], one[1] - two[1]).max() < 2 * (there.largest + back.largest)


def test_a_lens_without_distortion_stays_one() -> None:
    plain = {"f": 2600.0, "cx": 1200.0, "cy": 900.0}
    found = converted(plain, "forward", SIZE)
    assert found.largest < 1e-9
    assert max(abs(found.values[name]) for name in ("k1", "k2", "k3", "p1", "p2")) < 1e-12


def test_distortion_is_undone() -> None:
    u, v = image_grid(SIZE)
    for lens in (FORWARD, {**FORWARD, "k4": 0.05, "s1": 1e-3, "s4": -1e-3, "skew": 0.01}):
        again = image_point(lens, *ideal_point(lens, u, v))
        assert np.hypot(again[0] - u, again[1] - v).max() < 1e-6


R0, PIXEL = 3.0, 0.0035


@pytest.mark.parametrize("extra", [{}, {"aspect": 2e-3}, {"skew": 1e-3}], ids=["plain", "affinity", "shear"])
def test_photogrammetric_values_give_the_same_image(extra: dict[str, float]) -> None:
    """The formula of close-range photogrammetry, written out, puts points where the lens puts them."""
    lens = {**FORWARD, **extra}
    c, x0, y0, a1, a2, a3, b1, b2, c1, c2 = photogrammetric(lens, PIXEL, SIZE, R0).values
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-0.4, 0.4, 9), np.linspace(-0.3, 0.3, 7)))
    xi, eta = c * x, -c * y  # camera looks along -Z, image y up
    r2 = xi**2 + eta**2
    radial = a1 * (r2 - R0**2) + a2 * (r2**2 - R0**4) + a3 * (r2**3 - R0**6)
    right = x0 + xi * (1 + radial) + b1 * (r2 + 2 * xi**2) + 2 * b2 * xi * eta + c1 * xi + c2 * eta
    up = y0 + eta * (1 + radial) + b2 * (r2 + 2 * eta**2) + 2 * b1 * xi * eta
    u, v = right / PIXEL + (SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2 - up / PIXEL
    expected = image_point(lens, x, y)
    # the affinity acts on the distorted point in one form and on the ideal one in the other: their product is left
    product = 0.1 * abs(sum(extra.values())) * lens["f"] * 0.4
    assert np.hypot(u - expected[0], v - expected[1]).max() < 1e-6 + product


def test_photogrammetric_derivatives_are_those_of_the_values() -> None:
    lens = {**FORWARD, "aspect": 1e-3, "skew": 1e-3}
    form = photogrammetric(lens, PIXEL, SIZE, R0)
    for at, name in enumerate(lens):
        h = {"f": 1.0, "cx": 1.0, "cy": 1.0}.get(name, 1e-4)
        ahead, behind = (photogrammetric({**lens, name: lens[name] + s * h}, PIXEL, SIZE, R0).values for s in (1, -1))
        expected = (ahead - behind) / (2 * h)
        assert np.allclose(form.by_lens[:, at], expected, rtol=1e-5, atol=1e-6 * np.abs(expected).max())


def radius_where_it_folds(k1: float) -> float:
    """r (1 + k1 r^2) is largest at r = 1/sqrt(-3 k1), where it is 2/3 r."""
    return float(2 / 3 / np.sqrt(-3 * k1))


CENTRED = {"f": 1000.0, "cx": 1199.5, "cy": 899.5}


def test_a_fold_inside_the_image_is_found() -> None:
    for k1 in (-0.5, -0.2, -0.1):
        assert projection_range({**CENTRED, "k1": k1}, SIZE) == pytest.approx(
            1000 * radius_where_it_folds(k1), rel=2e-3
        )


def test_a_fold_far_out_that_bends_into_the_image_is_found() -> None:
    """r / (1 + k4 r^2) is largest at r = 1/sqrt(k4), where it is r/2: the field angle goes far beyond the image's."""
    reach = np.hypot(1.1995, 0.8995)
    for share in (0.6, 0.8, 0.95):
        k4 = (1 / (2 * share * reach)) ** 2
        assert projection_range({**CENTRED, "k4": k4}, SIZE) == pytest.approx(1000 * share * reach, rel=2e-3)


@pytest.mark.parametrize("terms", [{}, {"k1": 0.3}, {"k1": -0.05}, {"k2": -0.0155}, {"k3": -0.0045}, {"k4": 0.08}])
def test_a_fold_outside_the_image_does_no_harm(terms: dict[str, float]) -> None:
    assert projection_range({**CENTRED, **terms}, SIZE) is None
