"""Images taken in motion, by plain formulas with noise of their own: rolling shutters, and motion during the exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.hidden.images import Images
from benchmarks.hidden.scenes import Scene, board_scene, cmm_scene, part_scene
from metrocli.adjust.adjustment import adjust
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.effects.effect import Effect
from metrocli.effects.extension import with_effect, with_effect_everywhere
from metrocli.tasks import KINDS

Array = npt.NDArray[np.float64]
SCENES = {"calibrate-camera": board_scene, "align-part": part_scene}


def shutter(kind: str) -> Effect:
    return next(one for one in KINDS[kind].task().effects if one.name == "rolling-shutter")


def rolled(scene: Scene, rng: np.random.Generator, per_image: Array) -> Images:
    """Images whose rows are displaced by `per_image` (images, 2) times their distance from the principal point's row."""

    def later(scene: Scene, off: Array, points: Array) -> Array:
        return np.asarray(per_image[scene.view] * off[:, 1:])

    uv = scene.predicted(scene.start(), {"outside": later, "size": 1.0})
    return Images(scene, uv + rng.normal(0, scene.noise, uv.shape))


def sought(images: Images) -> AdjustedJob:
    """The job of a camera with a rolling shutter."""
    return replace(images.adjusted(), not_sought={})


def in_one(scene: Scene) -> Array:
    """A motion in one image, that with the most targets."""
    motion = np.zeros((len(scene.time), 2))
    motion[fullest(scene)] = 4e-3, -3e-3
    return motion


def fullest(scene: Scene) -> int:
    """The image with the most targets."""
    return int(np.bincount(scene.view).argmax())


@pytest.mark.parametrize("kind", ["calibrate-camera", pytest.param("align-part", marks=pytest.mark.slow)])
def test_the_image_with_a_rolling_shutter_is_named(kind: str) -> None:
    rng = np.random.default_rng(5)
    scene = SCENES[kind](rng)
    diagnosis = diagnose(sought(rolled(scene, rng, in_one(scene))))
    (finding,) = diagnosis.findings
    alternative = finding.effect.alternative
    assert (diagnosis.verdict, alternative.effect.name) == ("explained", "rolling-shutter")
    assert alternative.where == {"image": f"I{fullest(scene):03d}"}


@pytest.mark.parametrize("kind", SCENES)
def test_the_job_that_names_it_finds_its_size(kind: str) -> None:
    rng = np.random.default_rng(15)
    scene = SCENES[kind](rng)
    job = rolled(scene, rng, in_one(scene)).adjusted()
    model = with_effect(job.model, shutter(kind), [(f"I{fullest(scene):03d}",)], {})
    solution = adjust(model.blocks.values(), model.groups, model.datum)
    block = model.added[-1].block
    found, std = solution.blocks[block].values[-1], solution.std(block)[-1]
    assert np.all(np.abs(found - in_one(scene)[fullest(scene)]) < 4 * std)
    assert np.all(np.abs(found) > 5 * std)


@pytest.mark.slow
def test_a_shutter_in_every_image_is_one_effect_with_a_standard_deviation() -> None:
    rng = np.random.default_rng(25)
    scene = board_scene(rng)
    motion = rng.normal(0, 2e-3, (len(scene.time), 2))
    job = sought(rolled(scene, rng, motion))
    diagnosis = diagnose(job)
    assert [one.effect.name for one in diagnosis.scatters] == ["rolling-shutter"]
    model = with_effect_everywhere(job.model, shutter("calibrate-camera"), 2e-3)
    solution = adjust(model.blocks.values(), model.groups, model.datum)
    block = model.added[-1].block
    off = (solution.blocks[block].values - np.vstack([np.zeros(2), motion]))[1:] / solution.std(block)[1:]
    assert np.abs(off).max() < 4.5
    assert 0.6 < np.sqrt((off**2).mean()) < 1.5


@pytest.mark.slow
def test_one_motion_in_all_images_is_a_skew_and_an_aspect_of_the_lens() -> None:
    """The page: it cannot be told from them."""
    rng = np.random.default_rng(35)
    scene = board_scene(rng)
    # half of it is within chance of a tilt of the sensor by 5 degrees, which is one cause, not two
    diagnosis = diagnose(sought(rolled(scene, rng, np.tile([6e-3, 4e-3], (len(scene.time), 1)))))
    assert {one.effect.alternative.effect.name for one in diagnosis.findings} == {"axis-skew", "aspect-ratio"}
    assert not diagnosis.scatters


def test_images_of_one_target_do_not_show_it() -> None:
    """Rig cmm: one pose for all images, so that a displaced image is a wrong reading."""
    rng = np.random.default_rng(45)
    job = sought(rolled(scene := cmm_scene(rng, 20), rng, np.zeros((len(scene.time), 2))))
    assert "rolling-shutter" not in {one.alternative.effect.name for one in what_can_be_seen(job).candidates}


def exposed(scene: Scene, rng: np.random.Generator) -> Images:
    """Mean image points over an exposure in which the board moves by 4 mm and turns by 10 mrad in each image."""
    first = scene.start()
    poses = np.zeros(len(first))
    per_view = rng.normal(0, 1, (len(scene.time), 6)) * [2.0, 2.0, 2.0, 5e-3, 5e-3, 5e-3]
    poses[len(scene.lens_free) :] = per_view.ravel()
    along = np.linspace(-0.5, 0.5, 21)
    uv = np.mean([scene.predicted(first + share * poses, {}) for share in along], axis=0)
    return Images(scene, uv + rng.normal(0, scene.noise, uv.shape))


def test_a_motion_during_the_exposure_is_taken_in_by_the_poses() -> None:
    """docs/tasks/calibrate-camera.md: centres blurred by some pixels do no harm, neither to the lens nor to a name."""
    rng = np.random.default_rng(65)
    scene = board_scene(rng)
    job = exposed(scene, rng).adjusted()
    solution = adjust(job.model.blocks.values(), job.model.groups, job.model.datum)
    lens = solution.blocks["lens"]
    true = np.array([scene.lens[name] for name in lens.columns])
    assert np.all((np.abs(lens.values - true) / solution.std("lens"))[lens.free] < 4)
    assert diagnose(job).verdict == "clean"


@pytest.mark.slow
def test_an_image_that_is_noisier_along_its_motion_is_reported_as_noisier() -> None:
    rng = np.random.default_rng(75)
    scene = board_scene(rng)
    images = rolled(scene, rng, np.zeros((len(scene.time), 2)))
    along = np.array([np.cos(0.6), np.sin(0.6)])
    images.uv[scene.view == 5] += np.outer(rng.normal(0, 4 * scene.noise, (scene.view == 5).sum()), along)
    diagnosis = diagnose(images.adjusted())
    assert [one.name for one in diagnosis.variance_groups] == ["I005"]
    assert not diagnosis.findings


@pytest.mark.alike
@pytest.mark.parametrize("kind", SCENES)
def test_without_a_rolling_shutter_it_is_not_sought(kind: str) -> None:
    rng = np.random.default_rng(85)
    job = rolled(scene := SCENES[kind](rng), rng, np.zeros((len(scene.time), 2))).adjusted()
    (reason,) = [one.reason for one in what_can_be_seen(job).not_tested if one.effect.name == "rolling-shutter"]
    assert "write `shutter: rolling`" in reason
