"""Scales of the axes with their own temperature: positioning is given at 20 degC, with what this leaves uncertain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.formats import csv, hdf5
from metrocli.result import Result
from metrocli.settings import KnownQuantity
from metrocli.table import Column, Columns
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.settings import Settings
from metrocli.tasks.shared.part import Warm

GLASS = Warm(KnownQuantity(22.0, 0.1), KnownQuantity(8e-6, 0.5e-6))
GROWN = 16e-6
STD = float(np.linalg.norm([2 * 0.5e-6, 8e-6 * 0.1, 0.5e-6 * 0.1]))
JOB = """metrocli: 1
job: calibrate-machine
method: standstill
machine:
  chain: wXbYZt
  axes:
    x: {range: [0 mm, 600 mm], knots: 4, scale: {temperature: 24 degC, expansion: 25e-6 1/K}}
    y: {range: [-260 mm, 260 mm], knots: 4}
    z: {range: [-500 mm, 0 mm], knots: 4}
  tools: {T1: [0 mm, 0 mm, 120 mm], T2: [110 mm, 20 mm, 150 mm], T3: [-30 mm, 100 mm, 210 mm]}
inputs: {points: new/points.csv}
noise: {beam: 0.01 um, lateral: 0.01 um}
simulation: {error: 20 um, points: 200}
output: o.h5
"""


def with_scale(settings: Settings, **scales: Warm) -> Settings:
    axes = settings.machine.axes
    changed = {name: replace(getattr(axes, name), scale=scale) for name, scale in scales.items()}
    return replace(settings, machine=replace(settings.machine, axes=replace(axes, **changed)))


def test_positioning_is_that_of_a_scale_at_20_degc() -> None:
    """By hand: the growth times the way from the reference is taken off, and its uncertainty is added."""
    rng = np.random.default_rng(3)
    table = lengths.measured(sim.random_machine(rng), rng, n=120)
    job = lengths.settings(knots=(5, 6, 5))

    def run(settings: Settings) -> Result:
        return calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=table))

    warm, cold = run(job), run(with_scale(job, x=GLASS, y=GLASS))
    for name in ("EXX", "EYY", "EZZ", "EYX", "ECX"):
        before, after = (result.tables[f"tables/{name}"] for result in (warm, cold))
        way = before.numbers("position") if name in ("EXX", "EYY") else np.zeros(len(before))
        assert after.numbers("value") == pytest.approx(before.numbers("value") - GROWN * way, abs=1e-12)
        expected = np.hypot(before.numbers("std"), STD * np.abs(way))
        assert after.numbers("std") == pytest.approx(expected, abs=1e-12)
    assert [note for note in cold.notes if "EXX is given for a scale of 20 degC" in note]
    hidden = "temperature of the machine (positioning errors)"
    assert hidden in cold.tables["not_controlled"].texts("effect")
    whole = run(with_scale(job, x=GLASS, y=GLASS, z=GLASS))
    assert hidden not in whole.tables["not_controlled"].texts("effect")
    exact = {axis: replace(GLASS, temperature=replace(GLASS.temperature, std=0.0)) for axis in "xyz"}
    exact = {axis: replace(one, expansion=replace(one.expansion, std=0.0)) for axis, one in exact.items()}
    assert hidden in run(with_scale(job, **exact)).tables["not_controlled"].texts("effect")
    # the predicted error of the tool follows
    before, after = (result.tables["volume"] for result in (warm, cold))
    for axis, grown in (("x", GROWN), ("y", GROWN), ("z", 0.0)):
        less = before.numbers(f"e{axis}") - after.numbers(f"e{axis}")
        assert less == pytest.approx(grown * before.numbers(axis), abs=1e-9)


def test_a_simulated_machine_is_measured_warm_and_reported_at_20_degc(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("job.yaml").write_text(JOB)
    assert metrocli("simulate", "job.yaml", "--out", "new", "--seed", "2").code == 0
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 0, ran.err
    columns = (Column("error", "text"), Column("position", "length"), Column("value", "length", may_be_empty=True))
    truth = csv.read(Path("new/true_errors.csv"), Columns(columns))
    found = hdf5.read(Path("o.h5"))[0].tables["tables/EXX"]
    rows = np.array(truth.texts("error")) == "EXX"
    assert found.numbers("value") == pytest.approx(truth.numbers("value")[rows], abs=3e-4)


def test_a_scale_without_its_positioning_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("job.yaml").write_text(JOB + "estimate: [EYX, EYY]\n")
    ran = metrocli("check", "job.yaml")
    assert ran.code == 3
    assert "job.yaml:7" in ran.err
    assert "EXX" in ran.err
