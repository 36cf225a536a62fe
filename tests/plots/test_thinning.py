"""Thinning keeps extremes and counts; magnification is a round number that fits."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.plots.magnify import in_words, length_in_words, magnification, round_size, thinned, thinned_vectors, words


def test_few_points_are_all_shown() -> None:
    assert thinned(np.arange(50.0), np.zeros(50), 50).tolist() == list(range(50))
    assert words(50, 50, "all") == ""


@pytest.mark.parametrize("count", [900, 30_000])
def test_lowest_and_highest_of_each_strip_stay(count: int) -> None:
    rng = np.random.default_rng(871)
    x, y = rng.random(count) ** 3 * 70, rng.standard_t(3, count)
    rows = thinned(x, y, 400)
    assert len(rows) <= 400 and (np.diff(rows) > 0).all()
    strip = np.minimum((x - x.min()) // (np.ptp(x) / 100), 99)
    for one in np.unique(strip):
        whole, shown = y[strip == one], y[rows][strip[rows] == one]
        assert shown.min() == whole.min() and shown.max() == whole.max()


def test_the_density_of_what_is_shown_is_that_of_all() -> None:
    rng = np.random.default_rng(872)
    x, y = np.arange(100_000.0), rng.normal(size=100_000)
    rows = thinned(x, y, 4000)
    inner = np.abs(y[rows]) < 1.0
    # half of the rows are a plain sample, of which 68 % are inside one standard deviation; the outline is outside
    assert inner.sum() / 2000 == pytest.approx(0.683, abs=0.04)


def test_equal_places_are_thinned_too() -> None:
    y = np.arange(5000.0)
    rows = thinned(np.zeros(5000), y, 100)
    assert {0, 4999} <= set(rows.tolist()) and len(rows) <= 100


def test_the_longest_vector_of_each_cell_stays() -> None:
    rng = np.random.default_rng(873)
    places, sizes = rng.random((20_000, 2)) * [640, 480], rng.random(20_000)
    rows = thinned_vectors(places, sizes, 400)
    assert len(rows) <= 400 and int(np.argmax(sizes)) in rows
    low, span = places.min(axis=0), np.ptp(places, axis=0)
    cell = np.minimum((places - low) // (span / 20), 19) @ [20, 1]
    assert all(sizes[cell == cell[row]].max() == sizes[row] for row in rows)


@pytest.mark.parametrize(
    ("longest", "wanted", "factor"),
    [
        (0.003, 50.0, 10_000.0),
        (0.02, 50.0, 2000.0),
        (1.0, 1.0, 1.0),
        (300.0, 50.0, 0.1),
        (0.0, 50.0, 1.0),
        (np.nan, 1.0, 1.0),
    ],
)
def test_magnification(longest: float, wanted: float, factor: float) -> None:
    assert magnification(longest, wanted) == pytest.approx(factor)


def test_magnification_in_words() -> None:
    assert (in_words(20_000.0), in_words(1.0), in_words(0.5)) == ("× 20 000", "× 1", "× 0.5")
    assert round_size(260.0) == 200.0
    assert length_in_words(0.000214) == "0.21 µm"
