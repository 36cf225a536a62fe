"""What align-part and locate-launch-unit list as not controlled, planted into the files of the samples."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from statements.plain_adjustment import SAMPLES, Array, numbers, read_columns
from statements.test_spindle_camera import HELD, LENS, PART, SEEN, of_part

from metrocli.formats import hdf5
from metrocli.result import Result

Metrocli = Callable[..., Any]
SPINDLE, UNIT = SAMPLES / "spindle-camera/machine", SAMPLES / "xm60-launch-unit/data/errors.csv"


def written(file: Path, key: str, names: list[str], columns: dict[str, Array]) -> None:
    rows = zip(names, *(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join([key, *columns]), *(",".join([row[0], *map(repr, row[1:])]) for row in rows)]
    file.write_text("\n".join(lines) + "\n")


def hidden(result: Result, word: str) -> float:
    table = result.tables["not_controlled"]
    return float(table.numbers("hides")[[word in effect for effect in table.texts("effect")]][0])


def part(folder: Path, metrocli: Metrocli, scale: float = 1.0, seat: float = 0.0) -> Result:
    """Align the part of the sample with its lists scaled, and its camera higher in the spindle than it is."""
    folder.mkdir()
    targets, poses = read_columns(SPINDLE / "targets.csv"), read_columns(SPINDLE / "poses.csv")
    listed, held = (numbers(one, "x_mm", "y_mm", "z_mm") for one in (targets, poses))
    order = [targets["target"].index(SEEN[image]) for image in poses["image"]]
    read = of_part(PART, np.append(LENS, HELD), listed[order], held)
    read = read + np.random.default_rng(3).normal(0, 0.02, read.shape)
    names = ("x_mm", "y_mm", "z_mm")
    written(folder / "targets.csv", "target", targets["target"], dict(zip(names, scale * listed.T, strict=True)))
    written(folder / "poses.csv", "image", poses["image"], dict(zip(names, scale * held.T, strict=True)))
    seen = [f"{image},{SEEN[image]}" for image in poses["image"]]
    written(folder / "seen.csv", "image,target", seen, dict(zip(("u_px", "v_px"), read.T, strict=True)))
    camera = (SPINDLE / "true_camera.yaml").read_text()
    (folder / "camera.yaml").write_text(re.sub(r"z: -320.3 mm", f"z: {-320.3 + seat!r} mm", camera))
    assert (seat != 0) == ((folder / "camera.yaml").read_text() != camera)
    (folder / "job.yaml").write_text(
        "metrocli: 1\njob: align-part\nestimate: [part-pose, clamping-angle]\nnoise: 0.02 px\noutput: r.h5\n"
        "inputs: {camera: camera.yaml, observations: seen.csv, poses: poses.csv, targets: targets.csv}\n"
    )
    ran = metrocli("align-part", folder / "job.yaml")
    assert ran.code == 0, ran.err
    return hdf5.read(folder / "r.h5")[0]


def place(result: Result) -> Array:
    return np.array([next(e.value for e in result.estimates if e.name == axis) for axis in "xyz"])


def test_scale_and_seat_of_an_alignment(tmp_path: Path, metrocli: Metrocli) -> None:
    before, scaled = part(tmp_path / "a", metrocli), part(tmp_path / "b", metrocli, scale=1 + 1e-5)
    higher = part(tmp_path / "c", metrocli, seat=5e-3)
    for after in (scaled, higher):
        assert abs(after.statistics["chi2"] - before.statistics["chi2"]) < 1e-2 * before.statistics["chi2"]
    assert np.allclose(place(higher) - place(before), [0, 0, hidden(before, "seat")], atol=2e-5)
    # the error of a distance between places at the ends of the volume
    ends = np.ptp(numbers(read_columns(SPINDLE / "poses.csv"), "x_mm", "y_mm", "z_mm"), axis=0)
    assert np.isclose(hidden(before, "common scale"), 1e-5 * np.linalg.norm(ends), rtol=1e-6)


def unit(folder: Path, metrocli: Metrocli, scale: float = 1.0, longer: float = 0.0) -> tuple[Result, Array]:
    """Locate the unit of the sample with its receiver places scaled, or with a receiver that is longer than assumed."""
    folder.mkdir()
    poses = read_columns(UNIT)
    places = numbers(poses, "x_mm", "y_mm", "z_mm") * scale + [0, 0, longer]
    for at, name in enumerate(("x_mm", "y_mm", "z_mm")):
        poses[name] = [repr(value) for value in places[:, at].tolist()]
    lines = [",".join(poses), *map(",".join, zip(*poses.values(), strict=True))]
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    (folder / "job.yaml").write_text(
        "metrocli: 1\njob: locate-launch-unit\ninputs: {poses: poses.csv}\nnoise: {encoder: 50 urad}\noutput: r.h5\n"
    )
    ran = metrocli("locate-launch-unit", folder / "job.yaml")
    assert ran.code == 0, ran.err
    return hdf5.read(folder / "r.h5")[0], places


def test_scale_and_length_of_a_location(tmp_path: Path, metrocli: Metrocli) -> None:
    before, receivers = unit(tmp_path / "a", metrocli)
    (scaled, larger), (longer, _) = (
        unit(tmp_path / "b", metrocli, scale=1 + 1e-5),
        unit(tmp_path / "c", metrocli, longer=0.01),
    )
    for after in (scaled, longer):
        assert abs(after.statistics["chi2"] - before.statistics["chi2"]) < 1e-6 * before.statistics["chi2"]
    assert np.allclose(place(longer) - place(before), [0, 0, hidden(before, "control point")], atol=1e-7)
    seen = (place(scaled) - larger) - (place(before) - receivers)
    assert np.isclose(np.linalg.norm(seen, axis=1).max(), hidden(before, "common scale"), rtol=1e-4)
