"""Whatever stands in a job file, it is read or refused in words."""

from __future__ import annotations

from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from texts import texts

from metrocli.errors import InputError
from metrocli.project.job import load

GOOD = """metrocli: 1
job: straight-line
title: x
inputs: {readings: readings.csv}
noise: 0.1 mm
limits: {range: [0 mm, 1 m], robust: true}
labels: {a: b}
effects: []
require: {sigma0: ["< 1.5", "> 0.5"]}
output: o.h5
"""
PIECES = st.sampled_from([": ", "\n", "  ", "[", "]", "{", "}", "- ", "'", '"', "&a", "*a", "!!x", "|", ">", "?", "#", ",", "\t", "0", "nan", "µ", "\0", "---\n", "~", "<<", "%", "\u2028", "\ufeff"])  # fmt: skip
EDITS = st.lists(st.tuples(st.integers(0, len(GOOD)), st.integers(0, 12), PIECES | texts(4)), min_size=1, max_size=4)


@given(EDITS)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=100)
def test_any_edit_is_read_or_refused(job: Path, edits: list[tuple[int, int, str]]) -> None:
    text = GOOD
    for at, length, new in edits:
        text = text[:at] + new + text[at + length :]
    job.write_text(text, encoding="utf-8", errors="replace", newline="")
    try:
        load(job)
    except InputError as error:
        assert all(fault.file and str(fault).count("error: ") >= 1 for fault in error.faults)
