"""The local tie survey of antenna-tie with an effect planted into its readings by plain formulas, to first order.

Azimuth a (counted against the clock), elevation e, distance d. Of the vertical index `e += c`; of the horizontal circle
`a += c cos 2a + s sin 2a`; of the tilt axis `a += t tan e`; a target that stands higher by h: `e += h cos e/d`,
`d += h sin e`.
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from metrocli.project.job import JobOptions, load
from metrocli.project.runner import compute

SOURCE = Path(__file__).parents[3] / "shared" / "data" / "antenna-tie"
EPOCH = "height-epoch"
WRONG = ("WAW1", "WAW2", -118.1)
"""Line of the levelling that is wrong, by the set's own description: from, to, difference [mm]"""
PLANTED = {"tracker-vertical-index": 1, "tracker-azimuth-harmonic": 2, "tracker-transit-tilt": 1, "target-height": 1}
"""Effects that are planted, with the number of their parameters"""
FILES = ("readings", "stations", "setups", "heights", "points", "covariance")


def job(
    folder: Path,
    epoch: bool,
    change: tuple[str, Mapping[str, str], Sequence[float]] | None = None,
    effects: Sequence[tuple[str, Mapping[str, str]]] = (),
) -> Path:
    """Write the job without the wrong line, and with effects in its model; with a change planted.

    If `epoch`, the mark has another height in the later levelling.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name in FILES:
        shutil.copyfile(SOURCE / f"{name}.csv", folder / f"{name}.csv")
    _write(folder / "heights.csv", [row for row in _read("heights") if not _is_wrong(row)])
    if change is not None:
        _write(folder / "readings.csv", [_changed(row, *change) for row in _read("readings")])
    text = (SOURCE / "job.yaml").read_text(encoding="utf-8")
    known = [(EPOCH, {"point": "WAW3", "method": "later-levelling"})] if epoch else []
    listed = [
        "{" + ", ".join(f"{key}: {value}" for key, value in {"name": name, **where}.items()) + "}"
        for name, where in (*known, *effects)
    ]
    own = f"effects: [{', '.join(listed)}]\n" if listed else ""
    (folder / "job.yaml").write_text(text.replace("output:", f"{own}output:"), encoding="utf-8")
    return folder / "job.yaml"


def contained(folder: Path, name: str, where: Mapping[str, str]) -> list[float]:
    """Return what the adjustment of the survey finds of an effect, beside the mark's other height."""
    result, _ = compute(load(job(folder, True, effects=[(name, where)]), JobOptions(accept_doubtful=True)))
    return [one.value for one in result.estimates if one.name.startswith(f"{name}.")]


def _is_wrong(row: Mapping[str, str]) -> bool:
    return (row["from"], row["to"], float(row["dh_mm"])) == WRONG


def _changed(row: dict[str, str], name: str, where: Mapping[str, str], sizes: Sequence[float]) -> dict[str, str]:
    """Return a row of readings with an effect, if it is of that place; angles in rad, lengths in mm."""
    if not all(row.get(key, name) == name for key, name in where.items()):
        return row
    a, e = -np.radians(float(row["hz_deg"] or 0.0)), np.radians(90 - float(row["zd_deg"] or 90.0))
    d, size = 1000 * float(row["d_m"] or "inf"), sizes[0]
    by_name = {
        "tracker-vertical-index": (0.0, size, 0.0),
        "tracker-azimuth-harmonic": (size * np.cos(2 * a) + sizes[-1] * np.sin(2 * a), 0.0, 0.0),
        "tracker-transit-tilt": (size * np.tan(e), 0.0, 0.0),
        "target-height": (0.0, size * np.cos(e) / d, size * np.sin(e)),
    }
    by_a, by_e, by_d = by_name[name]
    steps = {"hz_deg": -np.degrees(by_a), "zd_deg": -np.degrees(by_e), "d_m": by_d / 1000}
    return row | {key: repr(float(row[key]) + float(step)) for key, step in steps.items() if row[key]}


def _read(name: str) -> list[dict[str, str]]:
    with (SOURCE / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _write(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
