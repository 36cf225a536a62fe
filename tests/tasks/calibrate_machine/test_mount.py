"""A mount whose encoders nobody reads, by targets that a network of trackers measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Ran
from simulated import mount as sim

from metrocli.formats.hdf5 import read

Metrocli = Callable[..., Ran]


@pytest.fixture
def measured(tmp_path: Path, metrocli: Metrocli) -> tuple[sim.Mount, Path]:
    """A mount, and the job that measures it in an adjusted network."""
    rng = np.random.default_rng(7)
    mount = sim.drawn(rng)
    job = sim.write(tmp_path, mount, rng)
    assert metrocli("adjust-network", tmp_path / "network.yaml").code == 0
    return mount, job


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
