"""What a touch probe does to the centre of a ball, probing by probing, and what of it reaches the two fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.grid import grid

from metrocli.tasks.selfcal_grid import task as selfcal_grid

LOBE, FIRST = 0.002, 0.4
"""Amplitude of a radius error of three waves in a turn [mm], and its phase"""


def centre(probings: int) -> np.ndarray:
    """The centre fitted to so many probings around the equator and one at the pole, whose radius has three lobes."""
    azimuth = 2 * np.pi * np.arange(probings) / probings
    ways = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(probings)])
    radius = 10 + LOBE * np.cos(3 * azimuth + FIRST)
    design = np.column_stack([np.concatenate([ways, [[0, 0, 1]]]), np.ones(probings + 1)])
    found, *_ = np.linalg.lstsq(design, np.append(radius, 10.0), rcond=None)
    return found[:3]


@pytest.mark.parametrize("probings, moved", [(4, LOBE), (6, 0.0), (8, 0.0)])
def test_three_lobes_move_the_centre_of_four_probings_by_their_amplitude(probings: int, moved: float) -> None:
    assert np.linalg.norm(centre(probings)[:2]) == pytest.approx(moved, abs=1e-9)


def test_what_a_probe_does_alike_at_all_balls_of_a_view_changes_no_field() -> None:
    """Another tip, or another shift by its lobes, in each view: its mounting takes all of it."""
    one = grid(3, "123456", seed=131)
    table = one.read(np.random.default_rng(132))
    views = np.array(table.texts("view"))
    tips = {name: np.random.default_rng([133, at]).normal(size=3) * 0.05 for at, name in enumerate(one.views)}
    shift = np.array([tips[name] + centre(4) for name in views])
    moved = {axis: table.numbers(axis) + shift[:, at] for at, axis in enumerate("xyz")}
    settings = one.settings(leave_one_out="no")
    before, after = (
        selfcal_grid.run(selfcal_grid.TASK.job(settings, views=rows))
        for rows in (table, replace(table, columns={**table.columns, **moved}))
    )
    for name in ("machine_error", "artefact_error"):
        fields = [result.tables[name].stacked(["ex", "ey", "ez"]) for result in (before, after)]
        assert np.abs(fields[1] - fields[0]).max() < 1e-8
    assert after.statistics["sigma0"] == pytest.approx(before.statistics["sigma0"], rel=1e-6)
