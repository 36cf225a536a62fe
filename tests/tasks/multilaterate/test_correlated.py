"""Correlated errors that a job states, against generalised least squares with their covariance written out."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from benchmarks.hidden_effects import KINDS
from metrocli.effects.correlated import StatedCorrelation, requests_of, with_all
from metrocli.formats import hdf5
from metrocli.project.job import JobOptions, load
from metrocli.project.runner import compute
from metrocli.project.yaml_text import parse
from metrocli.tasks.calibrate_machine.diagnosis import covariates

POINTS, KNOTS, LENGTH, STD, SIGMA = 40, 65, 0.25, 1.5e-3, 5e-4
JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.5 um, proportional: 0 um/m}
output: result.h5
"""
ONE = "{covariate: t_s, by: tracer, length: 0.25, std: 1 um}"
STATED = "correlated=[{covariate: t_s, by: tracer, length: 0.25, std: 1.5 um}]"


def matern(apart: np.ndarray) -> np.ndarray:
    return (1 + np.sqrt(3) * apart / LENGTH) * np.exp(-np.sqrt(3) * apart / LENGTH)


def measured(seed: int, std: float = STD) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Write the files of a network whose tracers waver; return places, tracers and lengths (points, tracers)."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0, 0], [1500, 1200, 900], (POINTS, 3))
    tracers = np.array([[-400, -300, -200], [1900, -350, -150], [800, 1700, -100], [750, 500, 1500.0]])
    share = np.linspace(0, 1, POINTS)
    root = np.linalg.cholesky(matern(np.abs(share[:, None] - share)) + 1e-9 * np.eye(POINTS))
    lengths = np.linalg.norm(points[:, None] - tracers, axis=2) - 100.0
    lengths += std * root @ rng.normal(size=(POINTS, 4)) + SIGMA * rng.normal(size=(POINTS, 4))
    rows = [f"P{i},T{k + 1},{lengths[i, k]:.9f},{30 * i}" for k in range(4) for i in range(POINTS)]
    Path("lengths.csv").write_text("\n".join(["point,tracer,length_mm,t_s", *rows, ""]))
    for name, places, head in (("points", points, "P"), ("tracers", tracers, "T")):
        first = 0 if head == "P" else 1
        listed = [f"{head}{i + first},{x:.6f},{y:.6f},{z:.6f}" for i, (x, y, z) in enumerate(places)]
        Path(f"{name}.csv").write_text("\n".join([f"{name[:-1]},x_mm,y_mm,z_mm", *listed, ""]))
    Path("job.yaml").write_text(JOB)
    return points, tracers, lengths


def generalised(points: np.ndarray, tracers: np.ndarray, lengths: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the points of a free network by least squares with the whole covariance of its lengths, and chi-squared."""
    knots = np.linspace(0, 1, KNOTS)
    values, vectors = np.linalg.eigh(matern(np.abs(knots[:, None] - knots)))
    kept = values > 1e-4 * values[-1]  # as the program leaves out what knots hardly show
    basis = np.stack([np.interp(np.linspace(0, 1, POINTS), knots, row) for row in np.eye(KNOTS)], axis=1)
    smooth = basis @ (vectors[:, kept] * values[kept]) @ vectors[:, kept].T @ basis.T
    weigh = np.linalg.inv(np.linalg.cholesky(SIGMA**2 * np.eye(POINTS) + STD**2 * smooth))
    x = np.concatenate([points.ravel(), tracers.ravel(), np.full(4, 100.0)])
    for _ in range(6):
        p, t = x[: 3 * POINTS].reshape(-1, 3), x[3 * POINTS : -4].reshape(-1, 3)
        beam = p[:, None] - t
        far = np.linalg.norm(beam, axis=2)
        jacobian = np.zeros((4, POINTS, len(x)))
        for k in range(4):
            for i in range(POINTS):
                unit = beam[i, k] / far[i, k]
                jacobian[k, i, 3 * i : 3 * i + 3] = unit
                jacobian[k, i, 3 * POINTS + 3 * k : 3 * POINTS + 3 * k + 3] = -unit
                jacobian[k, i, -4 + k] = -1.0
        left = (lengths - far + x[-4:]).T
        whitened = (weigh @ jacobian).reshape(-1, len(x))
        step = np.linalg.lstsq(whitened, (left @ weigh.T).ravel(), rcond=1e-9)[0]
        x = x + step
    rest = (left @ weigh.T).ravel() - whitened @ step
    return x[: 3 * POINTS].reshape(-1, 3), float(rest @ rest)


def test_the_result_is_that_of_generalised_least_squares(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., object]
) -> None:
    monkeypatch.chdir(tmp_path)
    true = measured(7)
    points, chi2 = generalised(*true)
    assert metrocli("multilaterate", "job.yaml", "--set", STATED).code == 0
    result, _ = hdf5.read(Path("result.h5"))
    table = result.tables["points"]
    found = np.stack([table.numbers(axis) for axis in "xyz"], axis=1)
    assert pdist(found) == pytest.approx(pdist(points), abs=1e-7)
    assert result.statistics["chi2"] == pytest.approx(chi2, rel=1e-6)
    assert "effects/correlated-error/parameters" in result.tables
    metrocli("multilaterate", "job.yaml", "--set", "output=plain.h5")
    white = hdf5.read(Path("plain.h5"))[0].tables["points"]
    off = [
        np.sqrt(((pdist(places) - pdist(true[0])) ** 2).mean())
        for places in (found, np.stack([white.numbers(a) for a in "xyz"], axis=1))
    ]
    assert off[0] < 0.8 * off[1]


def test_an_error_of_ten_times_the_noise_leaves_the_noise_as_declared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What its functions left out was as large as the noise, in no stated uncertainty: sigma0 was 1.24."""
    monkeypatch.chdir(tmp_path)
    large = JobOptions(overrides=(STATED.replace("1.5 um", "5 um"),))
    squares = []
    for seed in range(8):
        measured(seed, 10 * SIGMA)
        squares.append(compute(load(Path("job.yaml"), large))[0].statistics["sigma0"] ** 2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.12)


def test_the_extended_job_states_what_diagnose_found_and_is_clean(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., object]
) -> None:
    monkeypatch.chdir(tmp_path)
    measured(8)
    first = metrocli("diagnose", "job.yaml")
    assert "errors: its uncertainties include the structure left" in first.out
    extended = Path("job.extended.yaml").read_text()
    assert "correlated:" in extended
    assert "model: structured" not in extended
    assert metrocli("diagnose", "job.extended.yaml").out.startswith("verdict: clean")


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ("{covariate: temp_degC, by: tracer, length: 0.25, std: 1 um}", "no covariate 'temp_degC'"),
        ("{covariate: t_s, by: image, length: 0.25, std: 1 um}", "no 'image' of their own"),
        ("{covariate: t_s, by: tracer, only: T9, length: 0.25, std: 1 um}", "there is no tracer 'T9'"),
        ("{covariate: t_s, only: T1, length: 0.25, std: 1 um}", "`only` without `by`"),
        ("{covariate: t_s, by: tracer, length: 0.005, std: 1 um}", "resolves no length below"),
        ("{covariate: t_s, by: tracer, length: 0.25, std: 1 px}", "is not a size of these readings"),
        ("{covariate: t_s, by: tracer, length: 0.25, std: 1 m}", "at most 1000 times the declared noise of 0.0005 mm"),
        (f"{ONE}, {ONE}", "the same error is listed twice"),
        ("{covariate: t_s, by: tracer, length: 2, std: 1 um}", "2 is out of range"),
        ("{covariate: t_s, by: tracer, length: 0.25}", "the key 'std' is missing"),
    ],
)
def test_what_the_readings_cannot_have_is_refused_in_words(
    stated: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., object]
) -> None:
    monkeypatch.chdir(tmp_path)
    measured(9)
    ran = metrocli("multilaterate", "job.yaml", "--set", f"correlated=[{stated}]")
    assert ran.code == 3
    assert words in ran.err
    assert not Path("result.h5").exists()


@pytest.mark.parametrize("size", ["1 um", "2 urad"])
def test_an_error_of_displacements_and_angles_is_as_many_times_the_noise_of_each(size: str) -> None:
    """A laser for six degrees of freedom, with a noise of 0.5 um and 1 urad: an error of 1 um is one of 2 urad."""
    model = KINDS["six-dof"].case(0, True).adjusted().model
    node = parse("{covariate: t_s}", "job.yaml", Path())
    extended = with_all(model, requests_of([StatedCorrelation("t_s", 0.5, size)], [node], covariates))
    (added,), (group,) = extended.added, extended.readings
    wanted = frozenset({added.block})
    steps = group.chain.steps(extended.blocks, group.observations, wanted)
    by_size = group.chain.derivatives(steps, wanted)[added.block]
    found = added.std * np.sqrt((by_size**2).sum(axis=1).mean(axis=1))
    assert found == pytest.approx([1e-3] * 3 + [2e-6] * 3, rel=0.05)
