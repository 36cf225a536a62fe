"""A network of unknown targets whose list is only roughly right: the start finds lens, poses and targets all the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.halves import turned
from metrocli.arrays import Array
from metrocli.errors import NotConvergedError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Inputs, Settings

FOCAL, SIZE, NOISE = 7000.0, (8688, 5792), 0.1
NOWHERE = Path("nowhere")
DEPTH = np.array([600.0, 600.0, 120.0])
"""Half the extent of the targets [mm]: rather flat, so that the views alone tell little of the focal length"""
ESTIMATE = ("f", "cx", "cy", "k1", "k2", "k3", "p1", "p2")


def seen_from(rng: np.random.Generator, places: Array) -> tuple[Array, Array]:
    """Return which targets an image shows, and where: from 1.6 to 3.2 m in any direction, two in five of those inside."""
    turn = turned(rng.uniform(-np.pi, np.pi, 3))
    at = places @ turn.T + [*rng.normal(0, 150, 2), rng.uniform(1600, 3200)]
    ideal = at[:, :2] / at[:, 2:]
    r2 = (ideal**2).sum(axis=1, keepdims=True)
    uv = FOCAL * ideal * (1 - 0.09 * r2 + 0.1 * r2**2) + [4348.0, 2881.0]
    inside = (uv > 0).all(axis=1) & (uv < SIZE).all(axis=1) & (r2[:, 0] < 0.5)
    shown = np.flatnonzero(inside & (rng.random(len(places)) < 0.4))
    return shown, uv[shown] + rng.normal(0, NOISE, (len(shown), 2))


def calibrated(seed: int, rough: float, mixed: str = "") -> Result:
    """Calibrate by 15 images of 90 targets; each coordinate of the list is off by `rough` mm (standard deviation).

    The names of the targets are `mixed` in one image.
    """
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (90, 3)) * DEPTH
    shown, uv = zip(*(seen_from(rng, places) for _ in range(15)), strict=True)
    target = np.concatenate(shown)
    image = np.repeat([f"i{number:02d}" for number in range(15)], [len(one) for one in shown])
    target[image == mixed] = rng.permutation(target[image == mixed])
    u, v = np.concatenate(uv).T
    names = np.array([f"T{number:02d}" for number in range(90)])
    x, y, z = (places + rng.normal(0, rough, places.shape)).T
    observations = Table({"image": image, "target": names[target], "u": u, "v": v}, {"u": "px", "v": "px"})
    targets = Table({"target": names, "x": x, "y": y, "z": z}, dict.fromkeys("xyz", "mm"))
    settings = Settings(
        rig="network",
        inputs=Inputs(observations=NOWHERE, targets=NOWHERE),
        noise="estimated",
        camera=CameraSettings(image_size=SIZE, estimate=ESTIMATE),
    )
    return calibrate_camera.run(calibrate_camera.TASK.job(settings, observations=observations, targets=targets))


@pytest.mark.parametrize(("seed", "rough"), [(7, 30.0), pytest.param(122, 60.0, marks=pytest.mark.slow)])
def test_the_lens_is_found(seed: int, rough: float) -> None:
    result = calibrated(seed, rough)
    focal = next(one for one in result.estimates if one.name == "f")
    assert result.statistics["sigma0"] == pytest.approx(NOISE, rel=0.1)
    assert abs(focal.value - FOCAL) < 5 * focal.std
    assert not result.doubts


@pytest.mark.slow
def test_a_start_that_failed_is_doubtful_though_the_noise_is_estimated() -> None:
    """A tenth of the size of the part is too rough here: sigma0 alone would pass for a noise of 100 px."""
    result = calibrated(121, 60.0)
    assert result.statistics["sigma0"] > 1000 * NOISE
    assert any("lens and poses were not found" in text for text in result.doubts)


def test_an_image_with_names_of_other_targets_is_named() -> None:
    with pytest.raises(NotConvergedError, match="the points of i03 do not fit those of the other images"):
        calibrated(8, 1.0, mixed="i03")
