"""What an error of an instrument usually is depends on the noise that the job declares for it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated.network import NOISE, network

from metrocli.effects.effect import Effect
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.adjust_network import usual
from metrocli.tasks.adjust_network.effects import EFFECTS
from metrocli.tasks.adjust_network.readings import read

COARSE = "{azimuth: 5 arcsec, elevation: 5 arcsec, distance: {constant: 1 mm, proportional: 2 ppm}}"


def sizes(folder: Path, names: dict[str, str]) -> dict[tuple[str, tuple[str, ...]], tuple[float, float]]:
    """Usual sizes by effect and the names of its places, for a tracker or total station at the stations S1 and S2."""
    job = network(np.random.default_rng(9), 2, 8).write(folder)
    devices = "\n".join(f"  {name}: {{type: tracker, noise: {noise}}}" for name, noise in names.items())
    text = job.read_text()
    job.write_text(text[: text.index("  A:")] + devices + "\n" + text[text.index("output:") :])
    rows = [f"S{i + 1},{list(names)[i % len(names)]}" for i in range(2)]
    (folder / "stations.csv").write_text("\n".join(["station,instrument", *rows]) + "\n")
    asked = content(load(job))
    found = usual.effects(read(asked.settings, asked.files))
    return {(one.name, one.among): one.usual_sizes for one in found if one.usual_sizes is not None}


def test_sizes_of_a_tracker_are_those_of_the_table(tmp_path: Path) -> None:
    found = sizes(tmp_path, {"A": NOISE})
    assert found["tracker-range-zero", ()] == pytest.approx((0.005, 0.1))
    assert found["station-moved", ()] == pytest.approx((0.01, 1.0))


def test_errors_of_a_coarse_instrument_are_larger(tmp_path: Path) -> None:
    found = sizes(tmp_path, {"A": COARSE})
    assert found["tracker-range-zero", ()] == pytest.approx((0.5, 10.0))
    assert found["tracker-vertical-index", ()][1] == pytest.approx(np.radians(200 / 3600), rel=0.06)
    assert found["tracker-scale", ()][1] == pytest.approx(20e-6)
    # heights are typed, lists and certificates are written: no instrument makes these errors larger
    assert found["station-height", ()] == pytest.approx((0.2, 100.0))


def test_each_instrument_of_a_network_has_its_own(tmp_path: Path) -> None:
    found = sizes(tmp_path, {"A": NOISE, "B": COARSE})
    assert found["tracker-range-zero", ("A",)][1] == pytest.approx(0.1)
    assert found["tracker-range-zero", ("B",)][1] == pytest.approx(10.0)
    assert found["station-moved", ("S1",)][1] == pytest.approx(1.0)
    assert found["station-moved", ("S2",)][1] == pytest.approx(100.0)
    assert found["point-moved", ()][1] == pytest.approx(100.0)


@pytest.mark.parametrize("effect", [one for one in EFFECTS if one.usual], ids=lambda one: f"{one.name} {one.usual}")
@pytest.mark.parametrize("factor", [3.0, 1e4, 1e7])
def test_larger_sizes_are_read_as_they_are_written(effect: Effect, factor: float) -> None:
    """Whatever the unit: that of a gradient begins with a digit."""
    assert effect.usual_sizes is not None
    assert effect.larger(factor).usual_sizes == pytest.approx([factor * size for size in effect.usual_sizes], rel=0.05)


def test_sizes_follow_the_standard_deviations_of_the_readings_too(tmp_path: Path) -> None:
    """They are declared in columns, for some of the instruments, instead of as its noise."""
    sizes(tmp_path, {"A": NOISE, "B": NOISE})
    path = tmp_path / "readings.csv"
    head, *rows = path.read_text().splitlines()
    columns = "sigma_az_urad,sigma_el_urad,sigma_d_mm"
    lines = [f"{row},{'25,25,1' if row.startswith('S2') else ',,'}" for row in rows]
    path.write_text("\n".join([f"{head},{columns}", *lines]) + "\n")
    asked = content(load(next(tmp_path.glob("*.yaml"))))
    found = {(one.name, one.among): one.usual_sizes for one in usual.effects(read(asked.settings, asked.files))}
    assert found["tracker-range-zero", ("A",)] == pytest.approx((0.005, 0.1))
    assert found["tracker-range-zero", ("B",)] == pytest.approx((0.5, 10.0))
    assert found["tracker-beam-offset", ("B",)] == pytest.approx((0.05, 2.0))
