"""User-defined effects: what a definition may be, its faults with their places, and how jobs and files use it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import DOCS, SAMPLES
from simulated import lengths as simulated_lengths

from metrocli.adjust.model.quantities import Quantity
from metrocli.arrays import Array
from metrocli.cli.commands import run
from metrocli.cli.diagnosis_report.findings import of_diagnosis
from metrocli.diagnosis.linear.scans import thinned
from metrocli.diagnosis.verdict import as_data
from metrocli.effects.acting import Acting, seen_from
from metrocli.effects.effect import Effect, Parameter
from metrocli.effects.links.points import Growth, Shift
from metrocli.effects.own.define import read
from metrocli.effects.own.trials import broken
from metrocli.errors import Fault
from metrocli.formats import csv, hdf5
from metrocli.project import yaml_text
from metrocli.project.diagnosed import carry_out
from metrocli.project.job import load
from metrocli.tasks import KINDS

A = "parameters: {a: {unit: um, plausible: 10 um}}"


def faults_of(text: str, kind: str = "multilaterate") -> list[Fault]:
    task = KINDS[kind].task()
    faults: list[Fault] = []
    nodes = yaml_text.parse(text, "lab.yaml", Path()).at("define").items
    read(nodes, task.places, {effect.name for effect in task.effects}, faults)
    return faults


def one(name: str = "rest-error", acts_on: str = "length", adds: str = "a", more: str = A) -> str:
    return f"define:\n  - name: {name}\n    acts_on: {acts_on}\n    adds: {adds}\n    {more}\n"


FAULTY = {
    "unit": (one(adds="a*t"), 4, 11, "this is a speed"[:7], "expected mm"),
    "exists": (one(name="tracer-scale"), 2, 11, "exists already", "choose another name"),
    "unknown": (one(adds="a*sin(azimut)"), 4, 17, "unknown variable 'azimut'", "did you mean 'azimuth'?"),
    "not 0": (one(adds="a + distance - distance + 0*length + length"), 4, 11, "not 0 where all parameters are 0", ""),
    "idle": (one(more=f"{A[:-1]}, b: {{unit: um, plausible: 1 um}}}}"), 5, 54, "the parameter 'b' changes nothing", ""),
    "idle in effect": (
        one(adds="a + b - b", more=f"{A[:-1]}, b: {{unit: um, plausible: 1 um}}}}"), 5, 54, "'b' changes nothing", "",
    ),
    "of second order": (one(adds="a*a/length"), 5, 21, "changes nothing where all parameters are 0", "scan"),
    "quantity": (one(acts_on="lenght"), 3, 14, "there is no quantity 'lenght'", "did you mean 'length'?"),
    "vector": (one(acts_on="point-in-machine"), 4, 11, "is a vector", "x, y, z"),
    "component": (one(acts_on="point-in-machine", adds="{w: a}"), 4, 15, "no component 'w'", "x, y, z"),
    "where": (one(more=f"{A}\n    where: [tracr]"), 6, 13, "has a 'tracr'", "did you mean 'tracer'?"),
    "name": (one(name="Rest Error"), 2, 11, "not the name of an effect", "lower case"),
    "variable as parameter": (
        one(adds="t", more="parameters: {t: {unit: um, plausible: 1 um}}"), 5, 21, "'t' is a variable there", "",
    ),
    "plausible": (one(more="parameters: {a: {unit: um, plausible: 10 s}}"), 5, 43, "s is a time", "a length"),
    "absurdly small": (one(more="parameters: {a: {unit: um, plausible: 1e-30 um}}"), 5, 43, "size of 1e-30 um", "believed"),
    "absurdly large": (one(more="parameters: {a: {unit: um, plausible: 1e9 m}}"), 5, 43, "size of 1e9 m", "believed"),
    "of no size": (one(more="parameters: {a: {unit: um, plausible: 0 um}}"), 5, 43, "above zero", "believed"),
    "long": (one(adds="a" + "+a" * 500_000), 4, None, "1000001 characters", ""),
    "executed": (one(adds="__import__('os')"), 4, None, "cannot stand in a model", ""),
    "scan": (
        one(adds="a*sin(t/p)", more=f"{A}\n    scan: {{p: {{from: 9 s, to: 2 s}}}}"), 6, 31, "not above `from`", "",
    ),
    "where twice": (one(more=f"{A}\n    where: [tracer, tracer]"), 6, 21, "'tracer' is there twice", "leave it out"),
    "no derivative": (one(adds="abs(a)"), 4, 11, "has no derivative where all parameters are 0", "in proportion"),
    "no value at an end of the scan": (
        one(adds="a*sin(t/p)", more=f"{A}\n    scan: {{p: {{from: 0 s, to: 2 s}}}}"), 6, 22, "no value there", "above 0",
    ),
    "unknown key": (one(more=f"{A}\n    reveals: x"), 6, 5, "unknown key 'reveals'", "reveal"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTY)
def test_a_fault_has_its_place_and_a_hint(case: str) -> None:
    text, line, column, message, hint = FAULTY[case]
    (fault,) = faults_of(text)
    assert (fault.file, fault.line) == ("lab.yaml", line)
    assert column is None or fault.column == column
    assert message in fault.message and hint in (fault.hint or "")


def test_a_quantity_of_another_kind_is_no_quantity_here() -> None:
    assert "no quantity 'image'" in faults_of(one(acts_on="image"))[0].message


def test_a_definition_listed_twice_exists_already() -> None:
    text = one() + one().removeprefix("define:\n")
    assert "exists already" in faults_of(text)[0].message


def effect_of(text: str, kind: str) -> Effect:
    faults: list[Fault] = []
    (found,) = read(yaml_text.parse(text, "lab.yaml", Path()).at("define").items, KINDS[kind].task().places, (), faults)
    assert not faults
    return found


def test_periods_are_even_in_frequency_and_times_even() -> None:
    wave = effect_of(
        one(adds="a*sin(2*pi*X/p + b)", more="parameters: {a: {unit: um, plausible: 1 um}, "
        "b: {unit: rad, plausible: 3 rad}}\n    scan: {p: {from: 2 mm, to: 100 mm, steps: 50}}"), "multilaterate",
    )  # fmt: skip
    assert np.allclose(np.diff(1 / tried(wave)), (1 / 2 - 1 / 100) / 49)
    assert wave.space.name == "WAVE" and [p.name for p in wave.parameters] == ["a", "b"]
    step = effect_of(
        one(adds="a*(1 + (t - at)/abs(t - at))", more=f"{A}\n    scan: {{at: {{from: 1 min, to: 10 min, steps: 10}}}}"),
        "multilaterate",
    )
    assert np.allclose(tried(step), np.linspace(60, 600, 10))


def tried(effect: Effect) -> Array:
    """Return the values of a scan before the best one is refined."""
    (scanned,) = effect.scanned
    assert scanned.grid is not None
    return thinned(scanned.grid({}), scanned.tried)


def test_a_unit_that_no_dimension_has_is_in_base_units() -> None:
    squared = effect_of(
        one(adds="a*t**2", more="parameters: {a: {unit: um/s^2, plausible: 2 um/s^2}}"), "multilaterate"
    )
    parameter = squared.parameters[0]
    assert (parameter.unit, parameter.plausible) == ("mm s-2", pytest.approx(0.002))
    faults: list[Fault] = []
    node = yaml_text.parse("a: 3 um/s^2", "job.yaml", Path()).at("a")
    assert parameter.spec.read(node, faults) == pytest.approx(0.003)
    wrong = yaml_text.parse("a: 3 um/s", "job.yaml", Path()).at("a")
    parameter.spec.read(wrong, faults)
    assert "is a speed" in faults[0].message


def test_the_laws_find_what_is_wrong_with_the_effect_of_a_package() -> None:
    places = KINDS["multilaterate"].task().places
    offset = (Parameter("offset", "length", 0.1),)
    sound = Effect(
        "shop-offset", "why", offset, lambda block, where: Shift(block, Quantity.LENGTH), reveal="how", source="whence"
    )
    assert list(broken(sound, places)) == []

    class Lies(Growth):
        def step(self, value, local):  # type: ignore[no-untyped-def]
            step = super().step(value, local)
            return type(step)(step.value + 1.0, step.by_input, {self.block: 2 * step.by_block[self.block]})

    wrong = Effect(
        "shop-scale", "", offset, lambda block, where: Lies(block, Quantity.LENGTH), reveal="how", source="whence"
    )
    assert list(broken(wrong, places)) == [
        "it has no cause",
        "it is not 0 where all its parameters are 0",
        "its derivative by 'offset' is not that of its values",
    ]


def test_polar_variables_have_the_derivatives_of_their_values() -> None:
    point = np.array([[400.0, -250.0], [300.0, 80.0], [-120.0, 500.0]])
    for variable in seen_from():
        step = variable.at(point, None)  # type: ignore[arg-type]
        for axis in range(3):
            h = np.zeros((3, 1))
            h[axis] = 1e-3
            moved = variable.at(point + h, None).value - variable.at(point - h, None).value  # type: ignore[arg-type]
            assert step.by_input is not None
            assert np.allclose(step.by_input[0, axis], moved[0] / 2e-3, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("kind", [name for name, kind in KINDS.items() if kind.task().effects])
def test_every_kind_has_its_reading_and_its_points_as_places(kind: str) -> None:
    least = {
        "multilaterate": {"length", "point-in-machine"},
        "fit-points": {"point-in-part", "point-in-machine"},
        "locate-launch-unit": {"angle", "distance", "point-in-machine"},
        "selfcal-grid": {"coordinates", "point-in-machine"},
        "calibrate-machine": {"error-motion", "coordinates", "point-in-machine", "point-in-tracker"},
        "align-part": {"image", "point-in-part", "point-in-machine", "point-in-camera"},
        "calibrate-camera": {"image", "point-in-camera"},
        "adjust-network": {"sighting", "length", "point-in-tracker", "point-in-machine"},
    }[kind]
    places: tuple[Acting, ...] = KINDS[kind].task().places
    assert least <= {place.name for place in places}
    assert all(len(place.units) == len(place.components) for place in places)


LAB = """define:
  - name: rest-error
    cause: the reflector rests deeper in its nest while it is warm
    acts_on: length
    adds: a*T*elevation
    parameters: {a: {unit: um/K, plausible: 10 um/K}}
    where: [tracer]
    reveal: the nest at two temperatures
    source: procedure 17
  - name: board-wave
    acts_on: point-on-board
    adds: {z: "c*(X**2 + Y**2)"}
    parameters: {c: {unit: 1/mm, plausible: 1e-5 1/mm}}
"""
JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
simulation: {mover_error: 1 um, interval: 30 s, warming: 2 K}
"""


@pytest.fixture
def shop(tmp_path: Path) -> Path:
    """A project with an effect of its own, whose simulated measurement contains it."""
    net = simulated_lengths.network(24, 5, noise=0.0)
    csv.write(tmp_path / "points.csv", net.point_table())
    csv.write(tmp_path / "tracers.csv", net.tracer_table(0.0))
    (tmp_path / "lab.yaml").write_text(LAB)
    (tmp_path / "metrocli.yaml").write_text("project: shop\njobs: [job.yaml]\neffects_from: lab.yaml\n")
    (tmp_path / "job.yaml").write_text(JOB)
    wanted = ["--effect", "rest-error:tracer=T2,a=9 um/K", "--seed", "3", "--quiet"]
    assert run(["simulate", str(tmp_path / "job.yaml"), "--out", str(tmp_path / "made"), *wanted]) == 0
    (tmp_path / "lengths.csv").write_text((tmp_path / "made" / "lengths.csv").read_text())
    return tmp_path


def test_a_simulation_has_the_effect_and_its_truth(shop: Path) -> None:
    truth = json.loads((shop / "made" / "truth.json").read_text())
    (size,) = [value for key, value in _flat(truth) if key.endswith("rest-error.T2.a")]
    assert size == pytest.approx(0.009)


def _flat(value: object, key: str = "") -> list[tuple[str, object]]:
    if isinstance(value, dict):
        return [pair for name, item in value.items() for pair in _flat(item, f"{key}/{name}")]
    return [(key, value)]


def test_diagnose_names_it_and_the_extended_job_estimates_it(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(shop / "job.yaml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in found["effects"]] == ["rest-error"]
    assert found["effects"][0]["where"] == {"tracer": "T2"}
    own = [one for one in found["candidates"] if one["name"] == "rest-error"]
    assert len(own) == 5
    # what is named is in the model and hides nothing; the same effect of the other tracers could
    assert all((one["hides"] is None) == (one["where"] == {"tracer": "T2"}) for one in own)
    assert all(one["hides"]["value"] > 0 for one in own if one["hides"])
    extended = shop / "job.extended.yaml"
    assert run(["multilaterate", str(extended), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    size = result["estimates"]["rest-error.T2.a"]
    assert abs(size["value"] - 0.009) < 4 * size["std"] and size["unit"] == "mm K-1"
    held, record = hdf5.read(Path(result["result"]))
    assert "adds: 'a*T*elevation'" in held.tables["effects/rest-error.T2/definition"].texts("define")[0]
    assert any(one.path.endswith("lab.yaml") for one in record.inputs)


def test_a_direction_that_no_reading_shows_hides_its_own_plausible_size(
    shop: Path, metrocli: Callable[..., Any]
) -> None:
    """A scale of all lengths is one of all places: 5 um/m of the way from their centre, whatever `a` could be."""
    job = shop / "job.yaml"
    parameters = "{a: {unit: um/K, plausible: 10 um/K}, s: {unit: um/m, plausible: 5 um/m}}"
    own = f"{{name: warm-scale, acts_on: length, adds: a*T + s*distance, parameters: {parameters}}}"
    job.write_text(f"{job.read_text()}define: [{own}]\n")
    ran = metrocli("diagnose", job, "--design", "--json")
    assert ran.code == 0, ran.err
    (found,) = (one for one in json.loads(ran.out)["candidates"] if one["name"] == "warm-scale")
    places = np.loadtxt(shop / "points.csv", delimiter=",", skiprows=1, usecols=(1, 2, 3))
    way = np.linalg.norm(places - places.mean(axis=0), axis=1).max() / 1000
    # an upper bound over sizes of both parameters: up to twice what one does alone
    assert found["hides"]["unit"] == "um" and 1 < found["hides"]["value"] / (5 * way) < 2


@pytest.mark.slow
def test_a_scan_is_refined_between_its_values(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wave = """define:
  - {name: belt, acts_on: length, adds: "a*sin(2*pi*t/p) + b*cos(2*pi*t/p)", where: [tracer],
     parameters: {a: {unit: um, plausible: 10 um}, b: {unit: um, plausible: 10 um}},
     scan: {p: {from: 3 min, to: 20 min, steps: 12}}}
"""
    (shop / "lab.yaml").write_text(wave)
    job, made = shop / "job.yaml", shop / "again"
    planted = ["--effect", "belt:tracer=T2,a=3 um,b=1 um,p=362 s", "--seed", "5", "--quiet"]
    assert run(["simulate", str(job), "--out", str(made), *planted]) == 0
    assert run(["diagnose", str(job), "--set", f"inputs.lengths={made / 'lengths.csv'}", "--json", "--quiet"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["effects"]
    assert (found["name"], found["where"]) == ("belt", {"tracer": "T2"})
    # the values that are tried are 335 s and 392 s there
    assert found["parameters"]["p"]["value"] == pytest.approx(362, rel=0.03)


FAST = """define:
  - {name: pump, acts_on: length, adds: "a*sin(2*pi*t/p + phase)", where: [tracer],
     parameters: {a: {unit: um, plausible: 10 um}, phase: {unit: rad, plausible: 3.2 rad}},
     scan: {p: {from: 65 s, to: 600 s, steps: 4}}}
"""


@pytest.mark.slow
def test_a_fast_wave_between_two_values_of_a_coarse_scan_is_found_once(
    shop: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (shop / "lab.yaml").write_text(FAST)
    # the values of the scan are three cycles of the measurement apart, and the wave lies between two of them
    planted = ["--effect", "pump:tracer=T2,a=3 um,phase=0.4 rad,p=83 s", "--seed", "5", "--quiet"]
    assert run(["simulate", str(shop / "job.yaml"), "--out", str(shop / "again"), *planted]) == 0
    lengths = f"inputs.lengths={shop / 'again' / 'lengths.csv'}"
    assert run(["diagnose", str(shop / "job.yaml"), "--set", lengths, "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out)
    (found,) = data["effects"]
    assert (found["name"], found["where"]) == ("pump", {"tracer": "T2"})
    assert data["verdict"] == "explained" and data["noise"]["as_declared"]
    assert found["parameters"]["p"]["value"] == pytest.approx(83, rel=0.01)


def test_a_scan_that_is_too_coarse_for_the_readings_excludes_nothing(
    shop: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (shop / "lab.yaml").write_text(FAST)
    statuses = []
    for most in (1000, 4):
        monkeypatch.setattr("metrocli.diagnosis.linear.scans._MOST", most)
        assert run(["diagnose", str(shop / "job.yaml"), "--design", "--json", "--quiet"]) == 0
        design = json.loads(capsys.readouterr().out)
        statuses.append({one["status"] for one in design["candidates"] if one["name"] == "pump"})
    assert statuses == [{"excluded"}, {"cannot-see"}]


PUMP = """metrocli: 1
job: multilaterate
inputs: {lengths: ../data/tip4_lengths.csv, points: ../data/points.csv, tracers: ../data/tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
simulation: {mover_error: 2 um, tracer_error: 5 mm}
define:
  - {name: pump, acts_on: length, adds: "a*sin(2*pi*t/p + phase)", where: [tracer],
     parameters: {a: {unit: um, plausible: 10 um}, phase: {unit: rad, plausible: 3.2 rad}},
     scan: {p: {from: 60 s, to: 3600 s, steps: 12}}}
"""


@pytest.mark.slow
def test_noise_of_the_tracer_in_which_a_wave_is_found_does_not_stay_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(SAMPLES / "gear-m3d3", tmp_path / "gear")
    job = tmp_path / "gear" / "jobs" / "pump.yaml"
    job.write_text(PUMP)
    planted = ["--effect", "pump:tracer=LT2,a=3um,phase=0.4rad,p=128s", "--seed", "5", "--quiet"]
    assert run(["simulate", str(job), "--out", str(tmp_path / "made"), *planted]) == 0
    # the wave hides between two values, so at first LT2 passes for noisier by a factor of ten
    monkeypatch.setattr("metrocli.diagnosis.linear.scans._MOST", 12)
    made = [f"inputs.{name}={tmp_path / 'made' / name}.csv" for name in ("lengths", "tracers")]
    assert run(["diagnose", str(job), "--set", made[0], "--set", made[1], "--json", "--quiet"]) == 0
    data = json.loads(capsys.readouterr().out)
    (found,) = data["effects"]
    assert (found["name"], found["where"]) == ("pump", {"tracer": "LT2"})
    assert data["noise"]["as_declared"] and data["noise"]["apart"] == []


@pytest.mark.slow
def test_a_step_is_not_tried_at_the_time_of_a_reading(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    step = """define:
  - {name: slip, acts_on: length, adds: "a*(1 + (t - at)/abs(t - at))/2", where: [tracer],
     parameters: {a: {unit: um, plausible: 10 um}}, scan: {at: {from: 0 s, to: 690 s, steps: 24}}}
"""
    (shop / "lab.yaml").write_text(step)
    job, made = shop / "job.yaml", shop / "again"
    planted = ["--effect", "slip:tracer=T2,a=3 um,at=315 s", "--seed", "5", "--quiet"]
    assert run(["simulate", str(job), "--out", str(made), *planted]) == 0
    again = ["diagnose", str(job), "--set", f"inputs.lengths={made / 'lengths.csv'}", "--json", "--quiet"]
    # there is a reading every 30 s
    assert run(again) == 0
    (slip,) = [one for one in json.loads(capsys.readouterr().out)["candidates"] if one["name"] == "slip"]
    assert slip["status"] == "not-tested"
    assert "slip: 'abs(t - at)' has no derivative at the reading point" in slip["reason"]
    assert "it has a corner" in slip["reason"]
    (shop / "lab.yaml").write_text(step.replace("690 s", "720 s"))
    assert run(again) == 0
    data = json.loads(capsys.readouterr().out)
    (found,) = data["effects"]
    # `reveal` is not given
    assert data["separate_by"] == ["points measured before and after the jump"]
    # a jump of the dead path is the same
    assert {"dead-path-jump", "slip"} == {found["name"], *(one["name"] for one in found["alternatives"])}
    assert found["parameters"]["at"]["value"] == pytest.approx(315, abs=15)


def test_the_command_lists_own_effects_of_the_project(
    shop: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shop)
    assert run(["effects", "multilaterate", "--json", "--check"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in found["effects"] if one["own"]] == ["rest-error"]
    length = next(place for place in found["places"] if place["acts_on"] == "length")
    assert length["unit"] == "mm" and length["variables"]["azimuth"] == "rad" and length["components"] == []
    assert run(["effects", "calibrate-camera"]) == 0
    assert "board-wave" in capsys.readouterr().out


def test_the_command_lists_each_effect_once_and_where_own_ones_have_sizes_of_their_own(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(["effects", "--json"]) == 0
    for name, kind in json.loads(capsys.readouterr().out)["kinds"].items():
        forms = [(one["name"], one["by"], one["formula"], *one["where"], *one["among"]) for one in kind["effects"]]
        assert len(set(forms)) == len(forms), name
        assert run(["effects", name]) == 0
        text = capsys.readouterr().out
        effects, places = text.split("user-defined effects act on")
        rows = effects.splitlines()
        assert len(set(rows) - {""}) == len([row for row in rows if row])
        for place in kind["places"]:
            (row,) = [one for one in places.splitlines() if one.startswith(f"{place['acts_on']} ")]
            assert " ".join(place["where"]) in row


def test_a_fault_in_the_file_of_a_job_has_its_place(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (shop / "lab.yaml").write_text(LAB.replace("a*T*", "a*T*T*"))
    assert run(["check", str(shop / "job.yaml")]) == 3
    assert f"{shop / 'lab.yaml'}:5:11: error: define[1].adds: this is " in capsys.readouterr().err
    (shop / "metrocli.yaml").write_text("project: shop\njobs: [job.yaml]\neffects_from: gone.yaml\n")
    assert run(["check", str(shop / "job.yaml")]) == 3
    assert "effects_from: no such file" in capsys.readouterr().err


def test_a_name_that_exists_is_a_fault_in_a_file_also_if_the_definition_fits_other_kinds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wobble = (
        "  - {name: NAME, acts_on: point-in-machine, adds: {x: a*X/Y}, parameters: {a: {unit: um, plausible: 9 um}}}\n"
    )
    for name, place in (("tracer-scale", ""), ("wobble", wobble.replace("NAME", "wobble"))):
        (tmp_path / "lab.yaml").write_text(f"define:\n{place}{wobble.replace('NAME', name)}")
        assert run(["effects", "multilaterate", "--from", str(tmp_path / "lab.yaml")]) == 3
        assert f"an effect '{name}' exists already" in capsys.readouterr().err


def test_a_job_and_its_project_can_name_the_same_file(
    shop: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(shop)
    (shop / "job.yaml").write_text(f"{JOB}effects_from: lab.yaml\n")
    assert run(["check", "job.yaml"]) == 0, capsys.readouterr().err


def test_without_the_column_it_needs_the_effect_is_not_tested(shop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [line.split(",") for line in (shop / "lengths.csv").read_text().splitlines()]
    keep = [i for i, name in enumerate(rows[0]) if name != "temp_degC"]
    (shop / "lengths.csv").write_text("\n".join(",".join(row[i] for i in keep) for row in rows) + "\n")
    assert run(["diagnose", str(shop / "job.yaml"), "--json", "--design"]) == 0
    found = json.loads(capsys.readouterr().out)["candidates"]
    (own,) = [one for one in found if one["name"] == "rest-error"]
    assert own["status"] == "not-tested" and "temp_degC" in own["reason"]


def test_the_examples_of_the_page_are_definitions() -> None:
    section = (DOCS / "effects" / "own.md").read_text(encoding="utf-8").partition("## An example for each kind")[2]
    lines = [line[4:] for line in section.partition("## ")[0].splitlines() if line.startswith("    ")]
    found: dict[str, list[str]] = {}
    for line in lines:
        if line.startswith("# "):
            found[line[2:].partition(":")[0]] = []
        else:
            found[list(found)[-1]].append(line)
    assert set(found) == {name for name, kind in KINDS.items() if kind.task().places}
    for kind, text in found.items():
        assert faults_of("define:\n" + "\n".join(text), kind) == []


@pytest.mark.slow
def test_an_effect_without_a_value_at_a_reading_is_not_tested_and_the_others_are(
    metrocli: Callable[..., Any], shop: Path
) -> None:
    job = shop / "job.yaml"
    own = "\ndefine: [{name: logarithm, acts_on: length, adds: a*log(azimuth/pi), "
    job.write_text(job.read_text() + own + "parameters: {a: {unit: um, plausible: 5 um}}, where: [tracer]}]\n")
    ran = metrocli("diagnose", job, "--design", "--json")
    assert ran.code == 0, ran.err
    found = {one["name"]: one for one in json.loads(ran.out)["candidates"]}
    assert found["tracer-scale"]["status"] == "excluded"
    one = found["logarithm"]
    assert one["status"] == "not-tested"
    assert "log(azimuth/pi)" in one["reason"] and "the reading point P" in one["reason"]
    job.write_text(job.read_text() + "effects: [{name: logarithm, tracer: T1}]\n")
    ran = metrocli("multilaterate", job, "--set", "noise.constant=0.1 mm")  # or a wrong heading is looked for
    assert ran.code == 3 and "'log(azimuth/pi)' has no value at" in ran.err


def test_a_period_that_even_sampling_makes_of_another_is_listed_beside_it(
    shop: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A point each 30 s: waves of 70 s and of `1/(1/30 - 1/70)` = 52.5 s have the same values at all of them."""
    sizes = "{a: {unit: um, plausible: 5 um}, phase: {unit: rad, plausible: 3.2 rad}}"
    scan = "scan: {p: {from: 45 s, to: 90 s, steps: 60}}"
    own = (
        f"{{name: pump, acts_on: length, adds: a*sin(2*pi*t/p + phase), parameters: {sizes}, where: [tracer], {scan}}}"
    )
    job = shop / "pump.yaml"
    job.write_text(f"{JOB}define: [{own}]\n")
    planted = ["--effect", "pump:tracer=T2,a=3um,phase=0.4rad,p=70s", "--seed", "6", "--quiet", "--force"]
    assert run(["simulate", str(job), "--out", str(shop / "made"), *planted]) == 0
    (shop / "lengths.csv").write_text((shop / "made" / "lengths.csv").read_text())
    diagnosis = carry_out(load(job))
    (found,) = as_data(diagnosis)["effects"]
    both = [found["parameters"]["p"]["value"], *(alias["value"] for alias in found["aliases"])]
    assert sorted(both) == pytest.approx([52.5, 70.0], abs=0.3)
    assert {(one["parameter"], one["unit"]) for one in found["aliases"]} == {("p", "s")}
    assert "s fits as well (odds" in " ".join(of_diagnosis(diagnosis, None).split())
