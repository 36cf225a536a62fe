"""Columns of weather in another unit are named: whole, or in the rows of one source."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
AIR = {"temp": ("temp_degC", 20.3), "pressure": ("pressure_hPa", 1011.0)}
REST = {"temp": "pressure: 1011 hPa", "pressure": "temperature: 20.3 degC"}
FAHRENHEIT, KELVIN = lambda v: 1.8 * v + 32, lambda v: v + 273.15
"""Numbers of one unit from those of another"""


def sample(
    metrocli: Metrocli, folder: Path, name: str, path: str, numbers: Callable[[Mapping[str, str]], float]
) -> None:
    """Write a sample whose readings have a column of weather."""
    metrocli("init", folder, "--sample", name)
    file, text = folder / path, []
    for line in file.read_text().splitlines():
        if line.startswith("#"):
            continue
        head = text[0].split(",") if text else []
        text.append(f"{line},{numbers(dict(zip(head, line.split(','), strict=False)))}" if text else line + ",NEW")
    file.write_text("\n".join(text) + "\n")


def hall(metrocli: Metrocli, folder: Path, column: str, wrong: Callable[[float], float], tracers: str = "LT2") -> Path:
    heading, right = AIR[column]
    path = "data/lengths.csv"
    sample(metrocli, folder, "laboratory-effects", path, lambda r: wrong(right) if r["tracer"] in tracers else right)
    file, job = folder / path, folder / "jobs" / "hall.yaml"
    file.write_text(file.read_text().replace("NEW", heading, 1))
    job.write_text(job.read_text() + f"environment: {{{REST[column]}, humidity: 50 percent}}\n")
    return job


ONE = {
    "temp_degC of tracer LT2 is in degF": ("temp", FAHRENHEIT),
    "temp_degC of tracer LT2 is in K": ("temp", KELVIN),
    "pressure_hPa of tracer LT2 is in kPa": ("pressure", lambda v: v / 10),
    "pressure_hPa of tracer LT2 is in Pa": ("pressure", lambda v: v * 100),
    "pressure_hPa of tracer LT2 is in mmHg": ("pressure", lambda v: v / 1.333223684),
}


@pytest.mark.parametrize("words", ONE)
def test_the_tracer_in_another_unit_is_named(words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """A drift of the refraction, or another scale of the tracer, was named."""
    ran = metrocli("diagnose", hall(metrocli, tmp_path / "p", *ONE[words]), "--quick")
    assert ran.code == 0 and words in ran.out, ran.out + ran.err


def test_a_run_names_them_too(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("multilaterate", hall(metrocli, tmp_path / "F", "temp", FAHRENHEIT))
    assert "temp_degC of tracer LT2 seems to be in degF: 68.54 degC is read, and 68.54 degF are 20.3 degC" in ran.err
    ran = metrocli("multilaterate", hall(metrocli, tmp_path / "K", "temp", KELVIN))
    assert ran.code == 3 and "293.45 K are 20.3 degC: look at the unit of temp_degC" in ran.err


def test_two_tracers_are_one_warning(tmp_path: Path, metrocli: Metrocli) -> None:
    """Each was named, and then their rows again."""
    ran = metrocli("multilaterate", hall(metrocli, tmp_path / "p", "temp", FAHRENHEIT, "LT2 LT3"))
    assert "temp_degC of tracer LT2 and of tracer LT3 seems to be in degF: 68.54" in ran.err
    assert ran.err.count("seems to be in") == 1


def test_the_air_of_a_machine_is_in_another_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    """All lengths are too short by 46 um/m, which its axes take and its tools do not: other tools were advised."""
    folder = tmp_path / "p"
    sample(metrocli, folder, "machine-lengths", "data/lengths.csv", lambda _: FAHRENHEIT(20.3))
    file, job = folder / "data" / "lengths.csv", folder / "jobs" / "lengths.yaml"
    file.write_text(file.read_text().replace("NEW", "temp_degC", 1))
    job.write_text(job.read_text() + "environment: {pressure: 1011 hPa, humidity: 50 percent}\n")
    ran = metrocli("diagnose", job, "--quick")
    assert ran.code == 0 and "lengths: temp_degC is in degF" in ran.out and "tool" not in ran.out, ran.out + ran.err


def test_a_number_in_the_internal_unit_is_not_explained_by_itself(tmp_path: Path, metrocli: Metrocli) -> None:
    job = hall(metrocli, tmp_path / "p", "pressure", lambda v: v)
    file = tmp_path / "p" / "data" / "lengths.csv"
    file.write_text(file.read_text().replace("pressure_hPa", "pressure_Pa"))
    assert (
        "1011 Pa is read, and 1011 hPa are usual: look at the unit of pressure_Pa" in metrocli("multilaterate", job).err
    )


def test_large_numbers_are_written_as_the_file_has_them(tmp_path: Path, metrocli: Metrocli) -> None:
    job = hall(metrocli, tmp_path / "p", "pressure", lambda v: 100 * v)
    assert "101100 hPa is read, and 101100 Pa are 1011 hPa" in metrocli("multilaterate", job).err


WHOLE = {
    "temp_degC seems to be in degF": ("temp", FAHRENHEIT),
    "pressure_hPa seems to be in kPa": ("pressure", lambda v: v / 10),
}


@pytest.mark.parametrize("words", WHOLE)
def test_a_whole_column_in_another_unit_is_remarked(words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """Lengths contradict no common scale: such a job was done, without a remark."""
    ran = metrocli("multilaterate", hall(metrocli, tmp_path / "p", *WHOLE[words], tracers="LT1 LT2 LT3 LT4 LT5"))
    assert words in ran.err, ran.err


def test_warm_air_is_no_other_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("multilaterate", hall(metrocli, tmp_path / "p", "temp", lambda v: v + 15))
    assert "seems to be in" not in ran.err


def test_the_station_of_a_machine_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    path = "data/lengths.csv"
    sample(metrocli, tmp_path, "machine-lengths", path, lambda r: 68.5 if r["station"] == "S3" else 20.3)
    (tmp_path / path).write_text((tmp_path / path).read_text().replace("NEW", "temp_degC", 1))
    job = tmp_path / "jobs" / "lengths.yaml"
    job.write_text(job.read_text() + "environment: {pressure: 1011 hPa, humidity: 50 percent}\n")
    ran = metrocli("calibrate-machine", job)
    assert "temp_degC of station S3 is in degF" in ran.out + ran.err
