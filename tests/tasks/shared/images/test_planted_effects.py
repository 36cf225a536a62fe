"""Effects that simulate plants are found again by the job that names them, in each rig and both conventions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest
from tasks.shared.images import small_jobs
from tasks.shared.images.test_round_trips import BOUND, LENS, TRUTH, assert_true, simulated

from metrocli.tasks import KINDS

Metrocli = Callable[..., Any]
TIMES = "interval: 30 s, warming: 3 K"
LEFT_OUT = "estimate: [f, cx, cy, k1, k2, p1, p2]"


def calibration(folder: Path, rig: str, convention: str, effect: str, estimate: str = LEFT_OUT) -> Path:
    """A job with one effect to estimate, its simulation with times and temperatures."""
    job = small_jobs.JOBS[rig](folder)
    told = job.read_text().replace(LEFT_OUT, f"convention: {convention}, {estimate}")
    job.write_text(f"{told}simulation: {TRUTH[rig][:-1]}, {TIMES}}}\neffects: [{effect}]\n")
    return job


@pytest.mark.alike
@pytest.mark.parametrize("convention", ["forward", "backward"])
@pytest.mark.parametrize(
    ("rig", "effect", "planted"),
    [
        ("board", "{name: focal-drift, by: t}", "focal-drift:rate=-4e-5 1/s"),
        ("board", "{name: focal-drift, by: T}", "focal-drift:by=T,rate=2e-3 1/K"),
        ("cmm", "{name: focal-drift, by: T}", "focal-drift:by=T,rate=2e-3 1/K"),
        ("cmm", "{name: principal-point-drift}", "principal-point-drift:rate_u=20 px/h,rate_v=-30 px/h"),
        ("board", "{name: target-plane-bend}", "target-plane-bend:bxx=3e-5 1/mm,bxy=-1e-5 1/mm,byy=2e-5 1/mm"),
        ("board", "{name: rolling-shutter, image: view03.png}", "rolling-shutter:image=view03.png,a_u=3e-3,a_v=-2e-3"),
        (
            "network",
            "{name: rolling-shutter, image: view03.png}",
            "rolling-shutter:image=view03.png,a_u=-3e-3,a_v=5e-3",
        ),
        ("board", "{name: moved-target, target: T7}", "moved-target:target=T7,dx=1 mm,dy=-0.5 mm,dz=0.8 mm"),
    ],
)
def test_a_calibration_finds_what_was_planted(
    rig: str, effect: str, planted: str, convention: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    job = calibration(tmp_path, rig, convention, effect)
    truth = simulated(tmp_path, job, metrocli, "--effect", planted)
    ran = metrocli("calibrate-camera", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert_true(found, truth)
    assert 0.001 < found["statistics"]["p_value"] < 0.999
    name = planted.partition(":")[0]
    sizes = [abs(one["value"]) / one["std"] for label, one in found["estimates"].items() if label.startswith(name)]
    assert max(sizes) > 10
    with h5py.File(tmp_path / "camera.h5") as file:
        (label,) = file["effects"]
        assert label.startswith(name)
        assert len(file[f"effects/{label}/covariance"]) == len(sizes)


@pytest.mark.alike
@pytest.mark.parametrize(
    ("effect", "estimate", "names"),
    [
        ("radial-distortion", "estimate: [f, cx, cy, k1, p1, p2]", ("k2", "k3")),
        ("decentring-distortion", "estimate: [f, cx, cy, k1, k2]", ("p1", "p2")),
        ("principal-point", "estimate: [f, k1, k2, p1, p2]", ("cx", "cy")),
        ("aspect-ratio", LEFT_OUT, ("aspect",)),
        ("axis-skew", LEFT_OUT, ("skew",)),
    ],
)
def test_what_an_effect_frees_is_part_of_the_camera(
    effect: str, estimate: str, names: tuple[str, ...], tmp_path: Path, metrocli: Metrocli
) -> None:
    """The lens of the simulation has it, the job frees it by name, and a job that uses the camera is given it."""
    job = calibration(tmp_path, "cmm", "forward", f"{{name: {effect}}}", estimate)
    job.write_text(
        job.read_text().replace(
            LENS, LENS + {"aspect-ratio": ", aspect: 4e-3", "axis-skew": ", skew: -3e-3"}.get(effect, "")
        )
    )
    truth = {"k3": 0.0, "skew": 0.0, "aspect": 0.0} | simulated(tmp_path, job, metrocli)
    ran = metrocli("calibrate-camera", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    for name in names:
        assert abs(found[name]["value"] - truth[name]) < BOUND * found[name]["std"]
    with h5py.File(tmp_path / "camera.h5") as file:
        assert set(names) <= {row["parameter"].decode() for row in file["camera"][:]}
        assert set(names) <= {row["name"].decode() for row in file[f"effects/{effect}/parameters"][:]}


@pytest.mark.slow
def test_part_is_aligned_with_a_camera_that_has_effects(tmp_path: Path, metrocli: Metrocli) -> None:
    """The covariance of such a camera is that of lens and place; what an effect adds is left behind."""
    (tmp_path / "cmm").mkdir()
    job = calibration(tmp_path / "cmm", "cmm", "forward", "{name: focal-drift, by: t}")
    simulated(tmp_path / "cmm", job, metrocli, "--effect", "focal-drift:rate=-1e-5 1/s")
    assert metrocli("calibrate-camera", job, "--quiet", "--set", "inputs.observations=new/observations.csv").code == 0
    aligned = small_jobs.JOBS["align"](tmp_path)
    aligned.write_text(aligned.read_text().replace("camera.yaml", "cmm/camera.h5"))
    ran = metrocli("align-part", aligned, "--json")
    assert ran.code == 6, ran.err  # another camera than that of these readings: sigma0 is 31
    assert list(json.loads(ran.out)["estimates"]) == ["x", "y", "z", "alpha", "beta", "gamma", "gamma_s"]


ALIGNED = {
    "coupling-tilt": "alpha_s=3 mrad,beta_s=-2 mrad",
    "part-expansion": "scale=300 ppm",
    "stretched-targets": "stretch=1000 ppm,shear=500 urad",
    "moved-target": "target=C3,dx=1 mm,dy=2 mm,dz=-1 mm",
    "focal-change": "ratio=1 percent",
    "principal-point-shift": "du=40 px,dv=-30 px",
    "machine-scale": "axis=x,scale=200 ppm",
    "machine-squareness": "pair=xy,angle=1 mrad",
    "machine-straightness": "axis=x,b1=3e-3 1/m,b2=-3e-3 1/m",
    "machine-angular": "axis=x,rx=3e-3 1/m,ry=-2e-3 1/m,rz=4e-3 1/m",
    "spindle-growth": "by=t,rate=-20 um/min",
    "part-drift": "vx=20 um/min,vy=40 um/min,vz=-20 um/min",
    "radial-distortion": "dk1=0.01",
    "bad-pose": "image=image3,dx=1 mm,dy=2 mm,dz=-1 mm",
    "coupling-shift": "dx=0.5 mm,dy=-0.7 mm",
    "rolling-shutter": "image=image3,a_u=3e-3,a_v=-2e-3",
    "perspective-blur": "area=400 mm2",
}


@pytest.mark.alike
@pytest.mark.parametrize("name", ALIGNED)
def test_an_alignment_finds_what_was_planted(name: str, tmp_path: Path, metrocli: Metrocli) -> None:
    """Six targets in each image, the spindle turned between images."""
    job = small_jobs.turned(tmp_path)
    keys = [pair.partition("=") for pair in ALIGNED[name].split(",")]
    where = "".join(f", {key}: {value}" for key, _, value in keys if key in ("target", "axis", "pair", "image", "by"))
    job.write_text(f"{job.read_text()}effects: [{{name: {name}{where}}}]\n")
    truth = simulated(tmp_path, job, metrocli, "--effect", f"{name}:{ALIGNED[name]}")
    ran = metrocli("align-part", job, "--json", "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert_true(found, truth)
    own = {label: one for label, one in found["estimates"].items() if label.startswith(name)}
    assert len(own) == len(keys) - bool(where)
    assert max(abs(one["value"]) / one["std"] for one in own.values()) > 5


def test_every_effect_of_alignments_is_planted_here() -> None:
    assert {effect.name for effect in KINDS["align-part"].task().effects} - {
        "clamping-angle",
        "target-eccentricity",
    } == set(ALIGNED)


def test_a_known_effect_is_applied(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.turned(tmp_path)
    job.write_text(f"{job.read_text()}effects: [{{name: part-expansion, scale: 300 ppm}}]\n")
    truth = simulated(tmp_path, job, metrocli)
    assert truth["part-expansion.scale"] == pytest.approx(3e-4)
    observed = ("--set", "inputs.observations=new/observations.csv")
    with_it = json.loads(metrocli("align-part", job, "--json", *observed).out)
    job.write_text(job.read_text().replace("scale: 300 ppm", "scale: 0 ppm"))
    without = json.loads(metrocli("align-part", job, "--json", "--force", *observed).out)
    assert with_it["statistics"]["sigma0"] < 1.2 < without["statistics"]["sigma0"]
    assert_true(with_it, truth)


def test_effects_that_do_not_belong_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    job = calibration(tmp_path, "cmm", "forward", "{name: target-plane-bend}")
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "target-plane-bend" in ran.err
    job.write_text(job.read_text().replace("target-plane-bend", "moved-target, target: T99"))
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "there is no target 'T99'" in ran.err
    job.write_text(job.read_text().replace("moved-target, target: T99", "focal-drift"))
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "focal-drift needs a column t_s" in ran.err


def test_pictures_with_effects_are_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    job = calibration(tmp_path, "board", "forward", "{name: focal-drift, by: t}")
    job.write_text(job.read_text() + "pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}\n")
    ran = metrocli("simulate", job, "--out", tmp_path / "new", "--images", "--effect", "focal-drift:rate=1e-6 1/s")
    assert ran.code == 2 and "not in pictures" in ran.err


def test_an_effect_that_the_unknowns_absorb_is_named_with_what_shows_it(tmp_path: Path, metrocli: Metrocli) -> None:
    """Poses farther away take up the scale of a list: more images would not determine it."""
    job = calibration(tmp_path, "board", "forward", "{name: scale-of-targets}")
    simulated(tmp_path, job, metrocli, "--effect", "scale-of-targets:scale=100 ppm")
    ran = metrocli("calibrate-camera", job, "--set", "inputs.observations=new/observations.csv")
    assert ran.code == 4 and "absorb scale-of-targets: leave it out" in ran.err
    assert "a calibrated length among the targets" in ran.err and "more images" not in ran.err


def test_an_aspect_beside_two_focal_lengths_is_refused(tmp_path: Path, metrocli: Metrocli) -> None:
    two = LEFT_OUT.replace("[f,", "[fx, fy,")
    job = calibration(tmp_path, "board", "forward", "{name: aspect-ratio}", two)
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3 and "aspect-ratio goes with f: fx and fy already determine the ratio" in ran.err
    assert "leave it out" in ran.err and "measure it" not in ran.err
