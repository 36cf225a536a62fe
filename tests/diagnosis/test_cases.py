"""Measurements with a hidden effect that were simulated elsewhere (skipped where they are absent).

One case for each effect, place and shape of a measurement; `python -m benchmarks cases` judges all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks import cases

LEFT_OUT = {
    "align-part": {2, 3, 10, 17, 18, *range(19, 34)},
    "calibrate-camera": {*range(18), 20, 28, 29} - {5, 12},
    "locate-launch-unit": {*range(18, 33)},
    "calibrate-machine": {*range(16)} - {3, 9, 12},
    "selfcal-grid": {*range(27)} - {3, 7, 8},
}
"""Those that take some 5 s each and show what another one shows"""
MISSED = {"align-part/034": "nine degrees of freedom do not separate three wrong coordinates from an effect"}
FOLDERS = [
    folder
    for kind in cases.KINDS
    for folder in cases.folders(kind)
    if int(folder.name) not in LEFT_OUT.get(kind, set())
]
pytestmark = pytest.mark.skipif(not FOLDERS, reason=f"no cases at {cases.CASES}")


def _marked(folder: Path) -> Any:
    name = f"{folder.parent.name}/{folder.name}"
    missed = pytest.mark.xfail(name in MISSED, reason=MISSED.get(name, ""), strict=True)
    return pytest.param(folder, marks=missed, id=name)


@pytest.mark.parametrize("folder", [_marked(folder) for folder in FOLDERS])
def test_the_verdict_is_right(folder: Path) -> None:
    diagnosis, truth = cases.diagnosed(folder)
    if f"{folder.parent.name}/{folder.name}" == cases.BAD_POSE and not diagnosis.findings:
        assert {one.keys["pose"] for one in diagnosis.outliers} == {truth["effects"][0]["where"]["pose"]}
        pytest.xfail("a bad pose that shows in its distance only is reported as a wrong distance")
    assert not cases.faults(diagnosis, truth)
