"""Geometric errors of the tracker: the formulas of their pages, and what a diagnosis concludes on them.

The whole campaign: python -m benchmarks tracker_errors
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from laws.effects_of_kinds import calibrate_machine

from benchmarks import tracker_errors
from benchmarks.hidden import machine
from metrocli.diagnosis.diagnose import what_can_be_seen
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_effect
from metrocli.effects.model import Model
from metrocli.tasks.calibrate_machine.effects import EFFECTS

Array = npt.NDArray[np.float64]
SIZE = 1e-4
"""Value of each parameter [mm or rad]"""


@cache
def plain() -> Model:
    return calibrate_machine(effect("tracker-range-zero"))


def effect(name: str) -> Effect:
    return next(one for one in EFFECTS if one.name == name)


def polar(model: Model) -> tuple[Array, Array, Array]:
    """What the tracker would read without noise: distance, azimuth, elevation."""
    (group,) = model.readings
    x, y, z = group.chain.predict(model.blocks, group.observations)
    level = np.sqrt(x * x + y * y)
    return np.sqrt(x * x + y * y + z * z), np.arctan2(y, x), np.arctan(z / level)


@pytest.mark.parametrize("name, parameter, which, expected", [
    ("tracker-range-zero", "r0", 0, lambda r, a, e: np.ones_like(r)),
    ("tracker-scale", "scale", 0, lambda r, a, e: r),
    ("tracker-beam-offset", "h", 1, lambda r, a, e: 1 / (r * np.cos(e))),
    ("tracker-beam-offset", "v", 2, lambda r, a, e: 1 / r),
    ("tracker-transit-tilt", "angle", 1, lambda r, a, e: np.tan(e)),
    ("tracker-mirror-tilt", "angle", 1, lambda r, a, e: 1 / np.cos(e)),
    ("tracker-vertical-index", "angle", 2, lambda r, a, e: np.ones_like(r)),
    ("tracker-eccentricity", "s1", 1, lambda r, a, e: np.sin(a)),
    ("tracker-azimuth-harmonic", "c2", 1, lambda r, a, e: np.cos(2 * a)),
    ("tracker-vertical-eccentricity", "s1", 2, lambda r, a, e: np.sin(e)),
    ("tracker-vertical-harmonic", "c2", 2, lambda r, a, e: np.cos(2 * e)),
])  # fmt: skip
def test_a_reading_changes_by_the_formula_and_the_others_do_not(name, parameter, which, expected) -> None:  # type: ignore[no-untyped-def]
    known = {p.name: SIZE if p.name == parameter else 0.0 for p in effect(name).parameters}
    before, after = polar(plain()), polar(with_effect(plain(), effect(name), [()], known))
    for at in range(3):
        wanted = SIZE * expected(*before) if at == which else np.zeros_like(before[0])
        assert np.allclose(after[at] - before[at], wanted, rtol=1e-6, atol=1e-10)


@pytest.mark.slow
def test_an_error_that_shows_is_named() -> None:
    found = [tracker_errors.outcome("tracker-range-zero", number, machine.SMALL) for number in (1, 2, 3, 4)]
    assert all((one.status, one.wrong) == ("named", ()) and one.made > 0.01 for one in found)
    # where another error would fit about as well, the report lists it instead of choosing
    assert {one.verdict for one in found} == {"explained", "indistinct"}


@pytest.mark.slow
def test_what_an_error_that_does_not_show_changes_is_covered_by_what_it_hides() -> None:
    name, size = "tracker-vertical-index", tracker_errors.ERRORS["tracker-vertical-index"]
    quiet = machine.measurement(np.random.default_rng(5), machine.SMALL)
    loud = replace(quiet, read=quiet.read + machine.change(quiet, name, {}, size))
    before, after = quiet.adjusted(), loud.adjusted()
    made = np.linalg.norm(tracker_errors.tables(after) - tracker_errors.tables(before), axis=1).max()
    (candidate,) = (
        one for one in what_can_be_seen(after).candidates if one.alternative.effect.name == "tracker-vertical-index"
    )
    assert candidate.detectable > size["angle"]
    assert 0.001 < made <= candidate.undetected.size < 0.05
