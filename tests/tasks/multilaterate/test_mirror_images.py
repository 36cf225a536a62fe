"""Two places that fit lengths alike, one the mirror image of the other: a list decides, or the job is refused."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from simulated.lengths import NOWHERE

from metrocli.errors import UndeterminedError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.tasks.shared.lengths import LengthNoise

Array = npt.NDArray[np.float64]
ANCHORS = np.array([[0.0, 0, 2400], [5000, 300, 2600], [4800, 5200, 2300], [200, 4900, 2500], [2500, 2500, 2700]])
NOISE = 30.0


def table(key: str, places: Array, **more: Array) -> Table:
    names = np.array([f"{key[0]}{i}" for i in range(len(places))])
    return Table({key: names, **dict(zip("xyz", places.T, strict=True)), **more}, dict.fromkeys("xyz", "mm"))


def run(points: Table, tracers: Table | None, truth: Array, anchors: Array, measures: str = "absolute") -> Result:
    i, j = np.indices((len(truth), len(anchors))).reshape(2, -1)
    rng = np.random.default_rng(4)
    length = np.linalg.norm(truth[i] - anchors[j], axis=1) + rng.normal(0, NOISE, len(i))
    names = {"point": np.array([f"p{k}" for k in i]), "tracer": np.array([f"t{k}" for k in j])}
    lengths = Table({**names, "length": length - (0 if measures == "absolute" else 700)}, {"length": "mm"})
    settings = Settings(Inputs(lengths=NOWHERE, points=NOWHERE), LengthNoise(NOISE), measures=measures)
    return multilaterate.run(multilaterate.TASK.job(settings, lengths, points, tracers))


def flat(height: float) -> Array:
    """A path that is flat up to a height."""
    return np.random.default_rng(1).uniform(0, 1, (40, 3)) * [5000, 5000, height]


@pytest.mark.parametrize("measures", ["absolute", "changes"])
@pytest.mark.parametrize("height", [0.0, 20.0])
def test_anchors_of_a_flat_path_without_a_list_are_refused(height: float, measures: str) -> None:
    path = flat(height)
    with pytest.raises(UndeterminedError, match=r"two places fit the lengths alike(.|\n)*inputs: tracers"):
        run(table("point", path, sigma=np.zeros(40)), None, path, ANCHORS, measures)


def test_a_list_in_the_plane_does_not_decide() -> None:
    path = flat(20.0)
    listed = ANCHORS * [1, 1, 0.05]
    with pytest.raises(UndeterminedError, match="tracer t0 at"):
        run(table("point", path, sigma=np.zeros(40)), table("tracer", listed), path, ANCHORS)


def test_a_rough_list_decides_and_the_result_says_so() -> None:
    path, rough = flat(20.0), ANCHORS + [400, -300, -500]
    result = run(table("point", path, sigma=np.zeros(40)), table("tracer", rough), path, ANCHORS)
    assert np.abs(result.tables["tracers"].stacked("xyz") - ANCHORS).max() < 6 * NOISE
    hidden = result.tables["not_controlled"]
    assert sum("mirror image of tracer" in text for text in hidden.texts("effect")) == 5
    assert hidden.numbers("hides")[0] == pytest.approx(4800, rel=0.1)


def test_a_path_that_leaves_the_plane_decides_by_itself() -> None:
    path = flat(1500.0)
    result = run(table("point", path, sigma=np.zeros(40)), None, path, ANCHORS)
    assert np.abs(result.tables["tracers"].stacked("xyz") - ANCHORS).max() < 6 * NOISE


@pytest.mark.parametrize("stations", [3, 4])
def test_points_beside_stations_in_one_plane(stations: int) -> None:
    """Stations at the ceiling: a start below decides, a start in their plane does not."""
    anchors = ANCHORS[:stations] * [1, 1, 0] + [0, 0, 2500]
    truth = np.array([[2000.0, 1500, 400], [3000, 2500, 900]])
    known = table("tracer", anchors, sigma=np.zeros(stations))
    result = run(table("point", np.tile([2500.0, 2500, 1000], (2, 1))), known, truth, anchors)
    assert np.abs(result.tables["points"].stacked("xyz") - truth).max() < 6 * NOISE
    assert "mirror image of point p0" in result.tables["not_controlled"].texts("effect")[0]
    with pytest.raises(UndeterminedError, match="point p0 at"):
        run(table("point", np.tile([2500.0, 2500, 2500], (2, 1))), known, truth, anchors)


@pytest.mark.parametrize("start", [(2500.0, 2500.0, 1000.0), (-9000.0, 9000.0, -9000.0)])
def test_single_points_are_exact(start: tuple[float, float, float]) -> None:
    """Distances without noise to four known stations, from any start: the point to 1e-9 mm."""
    anchors, truth = ANCHORS[[0, 1, 2, 4]], np.array([1234.5, 2345.6, 345.7])
    length = np.linalg.norm(truth - anchors, axis=1)
    names = {"point": np.full(4, "p0"), "tracer": np.array([f"t{k}" for k in range(4)])}
    settings = Settings(Inputs(lengths=NOWHERE, points=NOWHERE), LengthNoise(1e-3), measures="absolute")
    known = table("tracer", anchors, sigma=np.zeros(4))
    job = multilaterate.TASK.job(
        settings, Table({**names, "length": length}, {"length": "mm"}), table("point", np.array([start])), known
    )
    assert np.abs(multilaterate.run(job).tables["points"].stacked("xyz") - truth).max() < 1e-9
