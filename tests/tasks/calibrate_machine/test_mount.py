"""A mount whose encoders nobody reads, by targets that a network of trackers measured."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Ran
from simulated import mount as sim

from metrocli.cli.commands import run
from metrocli.formats.hdf5 import read
from metrocli.project.job import load
from metrocli.table import Table
from metrocli.tasks.calibrate_machine.described import machine_of
from metrocli.tasks.calibrate_machine.methods import standstill
from metrocli.tasks.calibrate_machine.methods.standstill import positions_of

Metrocli = Callable[..., Ran]


@pytest.fixture(scope="module")
def adjusted(tmp_path_factory: pytest.TempPathFactory) -> tuple[sim.Mount, Path]:
    """A mount, and the job that measures it in an adjusted network."""
    rng = np.random.default_rng(7)
    mount = sim.drawn(rng)
    job = sim.write(tmp_path_factory.mktemp("mount"), mount, rng)
    assert run(["adjust-network", str(job.with_name("network.yaml")), "--quiet"]) == 0
    return mount, job


@pytest.fixture
def measured(adjusted: tuple[sim.Mount, Path], tmp_path: Path) -> tuple[sim.Mount, Path]:
    mount, job = adjusted
    shutil.copytree(job.parent, tmp_path, dirs_exist_ok=True)
    return mount, tmp_path / job.name


def test_a_mount_without_encoders_has_its_invariant_point(measured: tuple[sim.Mount, Path], metrocli: Metrocli) -> None:
    mount, job = measured
    done = metrocli("calibrate-machine", job)
    assert done.code == 0, done.err
    assert "no reading shows where the axes are at 0" in done.out
    found = read(job.parent / "mount.h5")[0].tables["mount"]
    # A points along (cos t, 0, -sin t) for a tilt t
    truth = [*mount.invariant, mount.offset, np.pi / 2 + mount.tilt]
    value = found.stacked(("x", "y", "z", "offset", "angle"))[0]
    std = found.stacked(("sx", "sy", "sz", "s_offset", "s_angle"))[0]
    assert np.abs((value - truth) / std).max() < 4
    assert std.max() < 0.05


def test_positions_that_are_right_need_no_estimate(tmp_path: Path, metrocli: Metrocli) -> None:
    rng = np.random.default_rng(8)
    mount = sim.drawn(rng)
    job = sim.write(tmp_path, mount, rng, "given")
    assert metrocli("adjust-network", tmp_path / "network.yaml").code == 0
    assert metrocli("calibrate-machine", job).code == 0
    found = read(tmp_path / "mount.h5")[0].tables["mount"]
    assert abs(found.numbers("offset")[0] - mount.offset) < 4 * found.numbers("s_offset")[0]


def test_what_does_not_belong_together_is_said(measured: tuple[sim.Mount, Path], metrocli: Metrocli) -> None:
    _, job = measured
    text, targets = job.read_text(), (job.parent / "targets.csv").read_text()
    job.write_text(text + "noise: {beam: 1 um, lateral: 1 um}\n")
    assert "the points have the covariance of their network" in metrocli("calibrate-machine", job).err
    job.write_text(text)
    (job.parent / "targets.csv").write_text(targets.replace("P00T0", "P00T9"))
    done = metrocli("calibrate-machine", job)
    assert done.code == 3
    assert "P00T9" in done.err
    job.write_text(
        text.replace("standstill", "lengths").replace("points: targets.csv, network: network.h5", "lengths: l")
    )
    assert "standstill can estimate them" in metrocli("check", job).err


def test_a_mount_has_a_page_and_what_needs_no_network_says_so(
    measured: tuple[sim.Mount, Path], metrocli: Metrocli
) -> None:
    _, job = measured
    assert metrocli("calibrate-machine", job).code == 0
    # X, Y and Z span no volume that a figure could show
    page = metrocli("report", job.parent / "mount.h5")
    assert page.code == 0, page.err
    for command in ("plan", "simulate"):
        done = metrocli(command, job, "--out", job.parent / "new", "--set", "simulation.error=0.1 mm")
        assert done.code == 3
        assert "`inputs: network` has none of them" in done.err


def test_a_frame_that_nothing_holds_is_said(tmp_path: Path, metrocli: Metrocli) -> None:
    """One axis: the place along it and the turn about it are those of the reflectors."""
    angles = np.radians(np.arange(0, 360, 20.0))
    targets = {"R1": np.array([200.0, 0, 50]), "R2": np.array([-100.0, 170, 120]), "R3": np.array([-100.0, -170, 20])}
    seen = [
        (angle, name, sim.about(2, angle) @ at + [900.0, 50, 10]) for angle in angles for name, at in targets.items()
    ]
    rows = [
        f"P{i},{np.degrees(angle):.1f},{name},{','.join(f'{x:.4f}' for x in place)}"
        for i, (angle, name, place) in enumerate(seen)
    ]
    (tmp_path / "points.csv").write_text("\n".join(["point,c_deg,tool,mx_mm,my_mm,mz_mm", *rows]) + "\n")
    listed = [f"{name},tool,{','.join(map(str, at))}," for name, at in targets.items()]
    (tmp_path / "reflectors.csv").write_text("\n".join(["reflector,on,x_mm,y_mm,z_mm,sigma_mm", *listed]) + "\n")
    (tmp_path / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-machine\nmethod: standstill\nmachine:\n  chain: wbCt\n"
        "  axes: {c: {range: [0 deg, 360 deg], knots: 9, at: [0 mm, 0 mm, 0 mm]}}\n"
        "inputs: {points: points.csv, reflectors: reflectors.csv}\nnoise: {beam: 1 um, lateral: 1 um}\n"
        "instrument: {on: bed}\noutput: head.h5\n"
    )
    done = metrocli("calibrate-machine", tmp_path / "job.yaml")
    assert done.code == 4
    assert "a `sigma_mm` that holds the turn" in done.err
    held = (tmp_path / "reflectors.csv").read_text().replace(",\n", ",0.01\n")
    (tmp_path / "reflectors.csv").write_text(held)
    done = metrocli("calibrate-machine", tmp_path / "job.yaml")
    assert done.code == 0, done.err


def test_positions_are_not_estimated_beside_the_table_of_the_angle(
    measured: tuple[sim.Mount, Path], metrocli: Metrocli
) -> None:
    _, job = measured
    done = metrocli("calibrate-machine", job, "--set", "estimate=rotary")
    assert done.code == 3
    assert "its table ECC are the same unknowns" in done.err


def test_more_common_errors_than_are_estimated_together_are_refused(
    measured: tuple[sim.Mount, Path], metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(standstill, "_MOST", 9)
    done = metrocli("calibrate-machine", measured[1])
    assert done.code == 3
    assert "errors in common, more than the 9 that are estimated together" in done.err
    assert "list at most 3 points of this network" in done.err


def test_positions_that_differ_in_the_file_are_two(measured: tuple[sim.Mount, Path]) -> None:
    settings = load(measured[1]).settings
    near = Table.of({"point": ["P1", "P2"], "c [rad]": np.radians([203.6401, 203.6402]), "a [rad]": [0.5, 0.5]})
    machine = machine_of(settings)
    position = near.stacked([axis.letter.lower() for axis in machine.axes]).T
    found = positions_of(settings, machine, position, near).blocks
    assert [len(found[f"positions of {axis}"].members) for axis in "CA"] == [2, 1]
