"""Mistakes in the files of a job are found by adjusting it without them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import SAMPLES

from benchmarks.hidden import lengths
from metrocli.diagnosis.adjusted_job import AdjustedJob, misfit_of
from metrocli.diagnosis.corrections import Mistake, corrections
from metrocli.diagnosis.mistakes import without_mistakes
from metrocli.diagnosis.trials import adjusted_trials
from metrocli.errors import NotConvergedError
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.tasks.shared.lengths import LengthNoise

Metrocli = Callable[..., Any]
SETTINGS = Settings(Inputs(Path("-"), Path("-")), LengthNoise(*lengths.NOISE))


def files(seed: int = 0) -> dict[str, Table]:
    m = lengths.measurement(np.random.default_rng([5, seed]), 20)
    point, tracer = np.array([f"P{i}" for i in m.point]), np.array([f"T{j}" for j in m.tracer])

    def places(key: str, letter: str, values: np.typing.NDArray[np.float64]) -> Table:
        names = np.array([f"{letter}{i}" for i in range(len(values))])
        return Table({key: names, **dict(zip("xyz", values.T, strict=True))}, dict.fromkeys("xyz", "mm"))

    return {
        "lengths": Table({"point": point, "tracer": tracer, "length": m.length}, {"length": "mm"}),
        "points": places("point", "P", m.nominal),
        "tracers": places("tracer", "T", m.said),
    }


def changed(table: Table, **columns: np.typing.NDArray[np.float64]) -> Table:
    return replace(table, columns={**table.columns, **columns})


def adjust(inputs: dict[str, Table]) -> object:
    return multilaterate.diagnosed(multilaterate.TASK.job(SETTINGS, **inputs))


WRONG = {
    "lengths in inches": (
        "lengths",
        lambda t: changed(t, length=t.numbers("length") / 25.4),
        "lengths: length_mm is in inches",
    ),
    "x and z swapped": (
        "points",
        lambda t: changed(t, x=t.numbers("z"), z=t.numbers("x")),
        "points: x and z are swapped",
    ),
    "y mirrored": ("tracers", lambda t: changed(t, y=-t.numbers("y")), "tracers: y has the wrong sign"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_the_mistake_is_told(name: str) -> None:
    key, spoil, words = WRONG[name]
    inputs = files()
    adjusted, mistaken = without_mistakes({**inputs, key: spoil(inputs[key])}, adjust)
    assert mistaken is not None
    assert any(str(mistake).startswith(words) for mistake in mistaken.mistakes), [str(m) for m in mistaken.mistakes]
    assert misfit_of(adjusted).worst < 1
    assert mistaken.after < mistaken.before / 10


@pytest.mark.parametrize(("symbol", "times"), [("um", 1e-3), ("m", 1e3)])
def test_places_in_another_unit_keep_or_tighten_what_is_known_of_them(symbol: str, times: float) -> None:
    """Standard deviations shrink with places in a smaller unit; they do not grow, or the places would yield to all."""
    places = {axis: np.array([100.0, 250.0]) for axis in "xyz"}
    table = Table({**places, "sigma": np.array([0.02, 0.03])}, dict.fromkeys([*"xyz", "sigma"], "mm"))
    words = f"points: x_mm, y_mm and z_mm are in {symbol}"
    (changed,) = (inputs["points"] for mistake, inputs in corrections({"points": table}) if str(mistake) == words)
    assert isinstance(changed, Table)
    assert changed.stacked("xyz") == pytest.approx(table.stacked("xyz") * times)
    assert changed.numbers("sigma") == pytest.approx(table.numbers("sigma") * min(times, 1.0))


def test_axes_of_lists_are_tried_last() -> None:
    inputs = {**files(), "lengths": Table({"length": np.ones(4), "az": np.ones(4)}, {"length": "mm", "az": "rad"})}
    order = [(mistake.sort, mistake.input) for mistake, _ in corrections(inputs)]
    assert {of for sort, of in order[: sum(sort == "units" for sort, _ in order)]} == set(inputs)
    assert order[-1][1] == "tracers" and order[-1][0].startswith("turned")


def test_a_list_with_a_frame_of_its_own_is_mirrored_once_and_never_turned() -> None:
    """Each correction in vain: eleven turns and five of six mirrorings of the points lead to the same fit."""
    found = list(corrections(files(), ("points",)))
    assert not [one for one, _ in found if one.input == "points" and one.sort.startswith(("turned", "x, y, z"))]
    tried = []

    def in_vain(mistake: Mistake) -> AdjustedJob:
        tried.append(mistake)
        raise NotConvergedError("in vain")

    assert not list(adjusted_trials((mistake, partial(in_vain, mistake)) for mistake, _ in found))
    mirrored = [mistake.input for mistake in tried if mistake.sort == "handed"]
    assert mirrored == ["points", *["tracers"] * 6]


def test_a_job_without_mistakes_is_left_alone() -> None:
    calls = []

    def counted(inputs: dict[str, Table]) -> object:
        calls.append(1)
        return adjust(inputs)

    _, mistaken = without_mistakes(files(), counted)
    assert mistaken is None
    assert len(calls) == 1


@pytest.mark.slow
def test_of_equally_good_corrections_that_of_the_fewest_columns_is_first(
    tmp_path: Path, metrocli: Callable[..., Any]
) -> None:
    """Distances in m fit a launch unit as well as places in um, of which there are three columns."""
    metrocli("init", tmp_path / "unit", "--sample", "xm60-launch-unit")
    path = tmp_path / "unit" / "data" / "table.csv"
    head, *rows = [line.split(",") for line in path.read_text().splitlines() if not line.startswith("#")]
    at = head.index("distance_mm")
    for row in rows:
        row[at] = repr(float(row[at]) / 1000) if row[at] else ""
    path.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    ran = metrocli("locate-launch-unit", tmp_path / "unit" / "jobs" / "table.yaml")
    assert ran.code == 3
    assert "distance_mm is in m: with this corrected" in ran.err
    assert "write distance_m in the heading; as good" in ran.err


@pytest.mark.slow
def test_a_list_whose_frame_is_unknown_is_mirrored_in_any_axis(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    shutil.copytree(SAMPLES / "raw-part", tmp_path / "part")
    targets = tmp_path / "part" / "cmm" / "targets.csv"
    targets.write_text(targets.read_text().replace("target,x_mm,y_mm,z_mm", "target,z_mm,y_mm,x_mm"))
    job = tmp_path / "part" / "jobs" / "camera.yaml"
    found, refused = metrocli("diagnose", job), metrocli("calibrate-camera", job)
    assert (found.code, refused.code) == (0, 3)
    ways = [f"{one} are swapped" for one in ("x and y", "x and z", "y and z")]
    ways += [f"{one} has the wrong sign" for one in "xyz"]
    assert all(way in text for text in (found.out, refused.err) for way in ways)
    assert "which the readings do not distinguish" in found.out


@pytest.mark.parametrize(("rows", "words"), [(range(50, 100), "lines 51 to 100"), ((3, 40, 77), "lines 4, 41, 78")])
def test_rows_in_another_unit_are_named(rows: Iterable[int], words: str) -> None:
    """Readings of two operators, or numbers that lost their decimal comma: no tracer has all of them."""
    right = files()
    length = right["lengths"].numbers("length").copy()
    length[list(rows)] /= 1000
    table = right["lengths"]
    wrong = {**right, "lengths": changed(table, length=length)}
    _, mistaken = without_mistakes(wrong, adjust)
    assert mistaken is not None
    assert str(mistaken.mistakes[0]) == f"lengths: length_mm in {words} is in m"
    assert mistaken.mistakes[0].write == f"length_mm in {words} times 1000"
    assert without_mistakes(right, adjust)[1] is None


def test_rows_in_another_unit_explain_more_than_a_list_that_does_not_fit(tmp_path: Path, metrocli: Metrocli) -> None:
    """It was "check that they are not those of another list of points", for each tracer."""
    metrocli("init", tmp_path / "p", "--sample", "laboratory-effects")
    file = tmp_path / "p" / "data" / "lengths.csv"
    head, *lines = file.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    half = [[a, b, f"{float(c) / 1000:.9f}" if i >= 100 else c, *rest] for i, (a, b, c, *rest) in enumerate(cells)]
    file.write_text("\n".join([head, *map(",".join, half)]) + "\n")
    ran = metrocli("multilaterate", tmp_path / "p" / "jobs" / "hall.yaml")
    assert ran.code == 3 and "length_mm in lines 102 to 201 is in m" in ran.err, ran.err
    assert "write length_mm in lines 102 to 201 times 1000" in ran.err


def test_a_view_in_another_unit_is_named_with_what_to_write(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "ball-cube")
    file = tmp_path / "p" / "data" / "views.csv"
    head, *lines = file.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    file.write_text("\n".join([head, *(",".join(
        [*row[:4], *(f"{float(v) / 1000:.9f}" for v in row[4:7]), *row[7:]] if row[0] == "4" else row
    ) for row in cells)]) + "\n")  # fmt: skip
    ran = metrocli("selfcal-grid", tmp_path / "p" / "jobs" / "views.yaml")
    assert ran.code == 3 and "write x_mm, y_mm and z_mm of view 4 times 1000" in ran.err, ran.err
