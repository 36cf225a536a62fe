"""Blur in the plane of the targets: rendered dots, and alignments by plain formulas with noise of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from laws.effects_of_images import calibration

from benchmarks.hidden.images import Images
from benchmarks.hidden.scenes import board_scene, part_scene
from metrocli.adjust.adjustment import adjust
from metrocli.diagnosis.diagnose import what_can_be_seen
from metrocli.diagnosis.status import Status, status
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_effect
from metrocli.effects.model import Model
from metrocli.tasks import KINDS

Array = npt.NDArray[np.float64]
PER_PIXEL = 5
"""Samples of a pixel along each side"""


def blur(kind: str) -> Effect:
    return next(one for one in KINDS[kind].task().effects if one.name == "perspective-blur")


def predicted(model: Model) -> Array:
    (group,) = model.readings
    return group.chain.predict(model.blocks, group.observations)


def centroid(turn: Array, place: Array, lens: dict[str, float], std: float) -> Array:
    """Centroid (2,) of the grey values of a dot at `place` in the camera, blurred on its plane to a normal distribution."""
    middle = np.round(lens["f"] * place[:2] / place[2] + [lens["cx"], lens["cy"]])
    reach = np.ceil(6 * std * lens["f"] / place[2])
    side = (np.arange((2 * reach + 1) * PER_PIXEL) + 0.5) / PER_PIXEL - 0.5 - reach
    u, v = np.meshgrid(middle[0] + side, middle[1] + side)
    rays = np.stack([(u.ravel() - lens["cx"]) / lens["f"], (v.ravel() - lens["cy"]) / lens["f"], np.ones(u.size)])
    x, y, w = np.linalg.solve(np.column_stack([turn[:, :2], place]), rays)
    grey = np.exp(-((x / w) ** 2 + (y / w) ** 2) / (2 * std**2))
    return np.array([u.ravel() @ grey, v.ravel() @ grey]) / grey.sum()


def test_the_centroid_of_a_rendered_dot_is_displaced_by_four_times_its_variance() -> None:
    table = blur("calibrate-camera")
    model = calibration(table)
    lens = model.blocks["lens"]
    pinhole = lens.with_values(np.where(np.isin(lens.columns, ["k1", "k2"]), 0.0, lens.values))
    model = model.with_blocks({**model.blocks, "lens": pinhole})
    std, views = 1.5, model.blocks["view"]
    before, after = predicted(model), predicted(with_effect(model, table, [()], {"area": 4 * std**2}))
    index = model.readings[0].observations.index
    for reading in (3, 70, 140, 200, 290, 400):
        turn, shift = views.rotations[index["view"][reading]], views.values[index["view"][reading], :3]
        place = turn @ model.blocks["target"].values[index["target"][reading]] + shift
        found = centroid(turn, place, pinhole.named(), std) - before[:, reading]
        expected = after[:, reading] - before[:, reading]
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected) + 2e-5
    assert np.hypot(*(after - before)).max() > 0.02


def test_circles_without_a_radius_are_an_area_of_the_square_of_it() -> None:
    """Ellipses by the conic: an unknown circle of radius r is blur of 4 s^2 = r^2."""
    rng = np.random.default_rng(5)
    scene = replace(part_scene(rng), radius=6.0)
    uv = scene.predicted(scene.start(), {"factor": 1.0})
    job = Images(replace(scene, radius=np.nan), uv + rng.normal(0, scene.noise, uv.shape)).adjusted()
    model = with_effect(job.model, blur("align-part"), [()], {})
    solution = adjust(model.blocks.values(), model.groups, model.datum)
    block = model.added[-1].block
    found, std = solution.blocks[block].values[0, 0], solution.std(block)[0, 0]
    assert abs(found - 36.0) < 4 * std < 24.0


def test_a_flat_board_cannot_show_it_and_the_change_that_it_can_hide_is_stated() -> None:
    rng = np.random.default_rng(15)
    scene = board_scene(rng)
    uv = scene.predicted(scene.start(), {}) + rng.normal(0, scene.noise, (len(scene.view), 2))
    candidates = what_can_be_seen(Images(scene, uv).adjusted()).candidates
    (one,) = (one for one in candidates if one.alternative.effect.name == "perspective-blur")
    assert status(one) == Status.CANNOT_SEE
    assert one.detectable > 10 * one.plausible
    assert one.undetected is not None and one.undetected.size > 0
