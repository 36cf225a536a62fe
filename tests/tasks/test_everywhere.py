"""`effects: [{name, std}]`: sizes of its own at every place, where the readings distinguish the places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest

Metrocli = Callable[..., Any]


@pytest.mark.parametrize(
    ("sample", "kind", "job", "entry", "place"),
    [
        ("otf-tracker", "calibrate-machine", "feed-2500", "{name: backlash, std: 5 um}", "axis"),
        ("xm60-launch-unit", "locate-launch-unit", "table", "{name: encoder-offset, std: 5 arcsec}", "encoder"),
    ],
)
def test_places_that_readings_do_not_distinguish_are_refused(
    sample: str, kind: str, job: str, entry: str, place: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    metrocli("init", tmp_path / "p", "--sample", sample)
    path = tmp_path / "p" / "jobs" / f"{job}.yaml"
    path.write_text(path.read_text() + f"effects: [{entry}]\n")
    ran = metrocli(kind, path)
    assert ran.code == 3
    assert f"takes no `std`: a reading does not concern one {place} alone" in ran.err
    assert f"write one entry for each {place}" in ran.err and not list((tmp_path / "p").rglob("*.h5"))


def test_places_that_readings_distinguish_have_sizes_of_their_own(tmp_path: Path, metrocli: Metrocli) -> None:
    metrocli("init", tmp_path / "p", "--sample", "gear-m3d3")
    path = min((tmp_path / "p" / "jobs").glob("*.yaml"))
    path.write_text(path.read_text() + "effects: [{name: tracer-scale, std: 1 ppm}]\n")
    ran = metrocli("multilaterate", path, "--json", "--output", tmp_path / "r.h5")
    assert ran.code in (0, 6), ran.err
    with h5py.File(tmp_path / "r.h5") as result:
        places = {str(row[0], "utf8") for row in result["effects/tracer-scale/parameters"][:].tolist()}
        tracers = {str(row[0], "utf8") for row in result["tracers"][:].tolist()}
    assert places == tracers and len(tracers) == 4
