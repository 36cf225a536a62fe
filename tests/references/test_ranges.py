"""Radio ranges that are too long in proportion to the distance: the cause is named from the data (skipped if absent).

Known of these two runs (Djugash et al., and the reference beside the data): held-out median errors fall from 0.83 to
0.36 m and from 1.34 to 0.38 m when the scale is in the model.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from places import SHARED

from metrocli.diagnosis.diagnose import diagnose
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load
from metrocli.units import parse_quantity

DATA = SHARED / "data" / "plaza-ranges"
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA}")
JOB = """metrocli: 1
job: multilaterate
inputs: {{lengths: {run}_lengths.csv, points: {run}_points.csv, tracers: {run}_tracers.csv}}
noise: {{constant: 500 mm}}
measures: absolute
datum: points
output: result.h5
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "before", "after"),
    [pytest.param("plaza1", "0.83 m", "0.36 m", marks=pytest.mark.slow), ("plaza2", "1.34 m", "0.38 m")],
)
def test_the_scale_of_the_ranges_is_named_first(run: str, before: str, after: str, tmp_path: Path) -> None:
    path = tmp_path / "job.yaml"
    path.write_text(JOB.format(run=DATA.resolve() / run))
    diagnosis = diagnose(adjusted_job_of(load(path)))
    first = diagnosis.findings[0]
    assert first.effect.alternative.effect.name == "length-scale"
    assert not first.effect.rivals
    assert first.gain.shown
    assert abs(first.gain.median_before - parse_quantity(before, "length")) < parse_quantity("60 mm", "length")
    assert abs(first.gain.median_after - parse_quantity(after, "length")) < parse_quantity("20 mm", "length")
    assert 0.06 < first.effect.values[0] < 0.08
