"""Effects act by the formulas of their pages, written here without the links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from laws.effects_of_images import alignment
from laws.effects_of_kinds import MEASURED, locate_launch_unit

from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_conditions, with_effect
from metrocli.effects.model import Model
from metrocli.tasks import KINDS

Array = npt.NDArray[np.float64]


def effect(kind: str, name: str) -> Effect:
    return next(one for one in KINDS[kind].task().effects if one.name == name)


def predicted(model: Model) -> Array:
    (group,) = (one for one in model.readings if one.observations.count)
    return group.chain.predict(model.blocks, group.observations)


def angles(model: Model) -> Array:
    """phi1 to phi4 of a launch unit, (4, n)."""
    return np.concatenate(
        [g.chain.predict(model.blocks, g.observations) for g in model.readings if "dist" not in g.name]
    )


def test_an_oval_disc_changes_its_own_encoder_by_two_waves() -> None:
    table = effect("locate-launch-unit", "encoder-harmonic")
    model = locate_launch_unit(table)
    before, after = angles(model), angles(with_effect(model, table, [("phi2",)], {"c2": 1e-5, "s2": -3e-5}))
    expected = np.zeros_like(before)
    expected[1] = 1e-5 * np.cos(2 * before[1]) - 3e-5 * np.sin(2 * before[1])
    assert np.allclose(after - before, expected, rtol=0, atol=1e-13)


def test_a_beam_that_passes_above_turns_the_two_tilts_apart() -> None:
    table = effect("locate-launch-unit", "beam-height")
    model = locate_launch_unit(table)
    before, after = angles(model), angles(with_effect(model, table, [()], {"v": 0.01}))
    (lengths,) = (g.chain.predict(model.blocks, g.observations) for g in model.readings if "dist" in g.name)
    expected = np.zeros_like(before)
    expected[1], expected[2] = -0.01 / lengths[0], 0.01 / lengths[0]
    assert np.allclose(after - before, expected, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("axis, across", [("x", (1, 2)), ("y", (2, 0)), ("z", (0, 1))])
def test_a_bent_axis_acts_as_poses_on_an_arc(axis: str, across: tuple[int, int]) -> None:
    table = effect("align-part", "machine-straightness")
    model = with_conditions(alignment(table))
    bends = {"b1": 3e-6, "b2": -5e-6}
    poses = model.blocks["spindle"]
    moved = poses.values.copy()
    along = poses.values[:, "xyz".index(axis)]
    for column, bend in zip(across, bends.values(), strict=True):
        moved[:, column] += bend * (along - (along.min() + along.max()) / 2) ** 2
    by_hand = model.with_blocks({**model.blocks, "spindle": replace(poses, values=moved)})
    found = predicted(with_effect(model, table, [(axis,)], bends))
    assert np.abs(predicted(by_hand) - predicted(model)).max() > 1e-3
    assert np.allclose(found, predicted(by_hand), rtol=0, atol=1e-6)


@pytest.mark.parametrize("axis", "xyz")
def test_an_axis_that_rolls_pitches_and_yaws_acts_as_poses_that_turn(axis: str) -> None:
    """Rotations by hand, to second order; the lever is that from the spindle's position to the camera."""
    table = effect("align-part", "machine-angular")
    model = with_conditions(alignment(table))
    rates = {"rx": 3e-8, "ry": -5e-8, "rz": 4e-8}
    held = model.blocks["spindle"]
    along = held.values[:, "xyz".index(axis)]
    turn = np.outer(along - (along.min() + along.max()) / 2, list(rates.values()))
    by_hand = model.with_blocks({**model.blocks, "spindle": held.moved(np.hstack([np.zeros_like(turn), turn]))})
    found = predicted(with_effect(model, table, [(axis,)], rates))
    assert np.abs(predicted(by_hand) - predicted(model)).max() > 1e-3
    assert np.allclose(found, predicted(by_hand), rtol=0, atol=1e-6)


def test_a_spindle_that_grows_moves_its_poses_along_it() -> None:
    table = effect("align-part", "spindle-growth")
    model = with_conditions(alignment(table))
    held = model.blocks["spindle"]
    (group,) = model.readings
    first = [int(np.argmax(group.observations.index["spindle"] == image)) for image in range(12)]
    growth = -1e-4 * group.observations.conditions["elapsed"][first]
    moved = held.values.copy()
    moved[:, :3] += held.rotations[:, :, 2] * growth[:, None]
    by_hand = model.with_blocks({**model.blocks, "spindle": replace(held, values=moved)})
    found = predicted(with_effect(model, table, [()], {"rate": -1e-4}))
    assert np.abs(predicted(by_hand) - predicted(model)).max() > 1e-2
    assert np.allclose(found, predicted(by_hand), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["calibrate-camera", "align-part"])
def test_rows_that_are_read_later_are_displaced_by_the_motion_of_one_image(kind: str) -> None:
    table = effect(kind, "rolling-shutter")
    model = MEASURED[kind].model(table)
    (group,) = model.readings
    image = model.places["image"].names[2]
    before, after = predicted(model), predicted(with_effect(model, table, [(image,)], {"a_u": 2e-3, "a_v": -1e-3}))
    here = group.observations.index["view"] == 2
    expected = np.outer([2e-3, -1e-3], (before[1] - 885.0) * here)
    assert np.allclose(after - before, expected, rtol=0, atol=1e-9)
    assert np.abs(expected).max() > 0.5


def test_air_that_is_warmer_above_shortens_lengths_by_half_the_height() -> None:
    table = effect("multilaterate", "air-gradient")
    model = MEASURED["multilaterate"].model(table)
    (group,) = model.readings
    points, tracers = model.blocks["point"].values, model.blocks["tracer"].values
    beam = points[group.observations.index["point"]] - tracers[group.observations.index["tracer"]][:, :3]
    change = predicted(with_effect(model, table, [()], {"gradient": -9.55e-10})) - predicted(model)
    expected = -9.55e-10 * np.linalg.norm(beam, axis=1) * beam[:, 2] / 2
    assert np.allclose(change[0], expected, rtol=1e-4, atol=1e-9)
