"""Features of corrected points in a job: their uncertainty, faults, and what a result holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from simulated.features import cloud
from simulated.lengths import Array, Network, network, settings

from metrocli.errors import InputError, UndeterminedError
from metrocli.nodes import Node, Source
from metrocli.result import Result
from metrocli.settings import KnownQuantity, LocatedValue
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Correction
from metrocli.tasks.shared.features.ideal import IdealFeature
from metrocli.tasks.shared.features.requested import SHAPES, Feature
from metrocli.tasks.shared.part import Part

BALLS = np.array([[150.0, 150.0, 100.0], [800.0, 420.0, 380.0]])


def asked(**features: str | Feature) -> Mapping[str, LocatedValue]:
    return {
        name: LocatedValue(value, Node("scalar", Source("job.yaml", (), Path()), f"features.{name}"))
        for name, value in features.items()
    }


def run(net: Network, probed: Array, names: list[str], features: Mapping[str, LocatedValue], **more: Any) -> Result:
    """The job with the first points of a network probed at `probed`."""
    columns = {"feature": np.array(names), "point": np.array(net.names[: len(names)])}
    table = Table(columns | dict(zip("xyz", probed.T, strict=True)), dict.fromkeys("xyz", "mm"), "probing.csv")
    job = replace(settings(), features=dict(features), **more)
    # a loose prior of the tracers' places spares the search for them
    files = (net.lengths(), net.point_table(), net.tracer_table(0.0, sigma=np.full(len(net.tracers), 1000.0)))
    return multilaterate.run(multilaterate.TASK.job(job, *files, probing=table))


def two_balls(rng: np.random.Generator) -> tuple[Network, list[str]]:
    """14 points on each of two balls of 15 mm and 12 elsewhere, read by six tracers."""
    unit = rng.normal(size=(2, 14, 3))
    unit /= np.linalg.norm(unit, axis=2)[:, :, None]
    points = np.concatenate([(BALLS[:, None] + 15 * unit).reshape(-1, 3), rng.uniform(0, 1, (12, 3)) * [900, 600, 500]])
    net = replace(network(40, 6, seed=5), points=points, nominal=points + 0.01 * np.sin(points / 200))
    return net, ["A"] * 14 + ["B"] * 14


def test_the_uncertainty_of_features_is_what_they_scatter_by() -> None:
    """16 measurements with 1 um at each probing: radii, and the distance of two centres with their covariance."""
    rng = np.random.default_rng(8)
    net, names = two_balls(rng)
    scores = []
    features = asked(A="sphere", B=Feature("sphere"))
    for _ in range(16):
        probed = net.nominal[:28] + 0.001 * rng.normal(size=(28, 3))
        result = run(net.read(rng), probed, names, features, correction=Correction(0.0, 0.001))
        found = result.tables["features"]
        centres, covariance = found.stacked("xyz"), result.arrays["features_covariance"]
        away = centres[1] - centres[0]
        along = away / np.linalg.norm(away)
        gradient = np.concatenate([-along, np.zeros(6), along, np.zeros(6)])
        off = np.linalg.norm(away) - np.linalg.norm(BALLS[1] - BALLS[0])
        scores.append(
            [
                off / np.sqrt(gradient @ covariance @ gradient),
                *(found.numbers("radius") - 15) / found.numbers("s_radius"),
            ]
        )
    # 16 distances and 32 radii: chi-square bounds of 99.9 %, both sides
    squares = np.square(scores)
    assert 0.24 < squares[:, 0].mean() < 2.48
    assert 0.38 < squares[:, 1:].mean() < 2.01


def test_points_of_one_replay_share_its_error() -> None:
    """28 probings at two replays: the mean of 14 is no better known than the replay."""
    rng = np.random.default_rng(2)
    net, _ = two_balls(rng)
    probed = np.repeat(net.nominal[:2], 14, axis=0) + 0.3 * rng.uniform(-1, 1, (28, 3))
    columns = {"feature": np.repeat(["A", "B"], 14), "point": np.full(28, "")}
    table = Table(columns | dict(zip("xyz", probed.T, strict=True)), dict.fromkeys("xyz", "mm"), "probing.csv")
    job = replace(settings(), features=dict(asked(A="sphere")), correction=Correction(0.002, 0.0))
    result = multilaterate.run(multilaterate.TASK.job(job, net.read(rng).lengths(), net.point_table(), probing=table))
    centre, replay = result.arrays["features_covariance"][:3, :3], result.arrays["points_covariance"][0]
    # the returns at the probing are 14, that of the replay is one
    assert np.linalg.eigvalsh(centre - replay - 0.002**2 * np.eye(3)).min() > 0


def sphere(points: Array) -> Array:
    """Centre and radius of least squares of the distances."""
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    start = np.linalg.lstsq(matrix, (points**2).sum(axis=1), rcond=None)[0]
    start[3] = np.sqrt(start[3] + start[:3] @ start[:3])
    found = least_squares(lambda s: np.linalg.norm(points - s[:3], axis=1) - s[3], start, method="lm", xtol=1e-14)
    return np.asarray(found.x)


def test_part_and_tips_reach_radii_and_the_distance_of_centres_as_by_hand() -> None:
    """Two balls, a tip each: differences of a fit of its own, and one covariance of all coordinates and the growth."""
    rng = np.random.default_rng(11)
    net, names = two_balls(rng)
    net, with_tip, sigmas = net.read(rng), np.repeat([0, 1], 14), (0.0005, 0.002)
    columns = {"feature": np.array(names), "point": np.array(net.names[:28]), "tip": np.array(["T1", "T2"])[with_tip]}
    probing = Table(columns | dict(zip("xyz", net.nominal[:28].T, strict=True)), dict.fromkeys("xyz", "mm"))
    tips = Table({"tip": np.array(["T1", "T2"]), **dict.fromkeys("xyz", np.zeros(2)), "sigma": np.array(sigmas)})
    growth, u_growth = 12e-6 * 4, np.sqrt((4 * 1e-6) ** 2 + (12e-6 * 0.3) ** 2 + (1e-6 * 0.3) ** 2)
    part = Part(KnownQuantity(24.0, 0.3), KnownQuantity(12e-6, 1e-6))
    job = replace(settings(), features=asked(A="sphere", B="sphere"), part=part, correction=Correction(0.001, 0.0007))
    files = (net.lengths(), net.point_table(), net.tracer_table())
    result = multilaterate.run(multilaterate.TASK.job(job, *files, probing=probing, tips=tips))

    common, core = result.arrays["points_common"][:28], result.arrays["points_core"]
    whole = np.einsum("aik,kl,bjl->aibj", common, core, common)
    each = result.arrays["points_covariance"][:28] + (2 * 0.001**2 + 0.0007**2) * np.eye(3)
    whole[range(28), :, range(28)] = each
    for one, sigma in enumerate(sigmas):
        whole += sigma**2 * np.einsum("a,b,ij->aibj", with_tip == one, with_tip == one, np.eye(3))
    warm = result.tables["corrected"].stacked("xyz") * (1 + growth)

    def figures(at: Array, grown: float) -> Array:
        a, b = (sphere(at[14 * k : 14 * k + 14] / (1 + grown)) for k in (0, 1))
        return np.array([a[3], b[3], np.linalg.norm(b[:3] - a[:3])])

    steps = 1e-3 * np.eye(84).reshape(84, 28, 3)
    by_place = np.array([(figures(warm + s, growth) - figures(warm - s, growth)) / 2e-3 for s in steps]).T
    by_growth = (figures(warm, growth + 1e-4) - figures(warm, growth - 1e-4)) / 2e-4
    expected = by_place @ whole.reshape(84, 84) @ by_place.T + u_growth**2 * np.outer(by_growth, by_growth)

    found, stated = result.tables["features"], result.arrays["features_covariance"]
    away = np.diff(found.stacked("xyz"), axis=0)[0]
    to = np.zeros((3, 18))
    to[0, 6] = to[1, 15] = 1
    to[2, 9:12] = away / np.linalg.norm(away)
    to[2, :3] = -to[2, 9:12]
    assert to @ stated @ to.T == pytest.approx(expected, rel=2e-3, abs=1e-9)
    assert found.numbers("s_radius") == pytest.approx(np.sqrt(np.diag(expected)[:2]), rel=1e-3)
    assert found.numbers("radius") == pytest.approx(15 / (1 + growth), abs=2e-4)
    assert np.linalg.norm(away) == pytest.approx(np.linalg.norm(BALLS[1] - BALLS[0]) / (1 + growth), abs=5e-4)


def test_a_plane_through_points_near_a_line_is_refused_by_its_direction() -> None:
    rng = np.random.default_rng(3)
    net, names = two_balls(rng)
    line = np.linspace(0, 1, 14)[:, None] * [60.0, 40, 20] + [100, 100, 100] + 1e-3 * rng.normal(size=(14, 3))
    probed = np.concatenate([line, net.nominal[14:28]])
    with pytest.raises(UndeterminedError, match="do not determine a plane: .* its direction turns by") as found:
        run(net.read(rng), probed, names, asked(A="plane"), tolerance=1e3, correction=Correction(0.0, 0.02))
    assert "radius" not in str(found.value)
    # the lengths fit, so that no file is taken to be in another unit
    assert found.value.misfit == 0.0


def test_a_job_gives_both_fits_of_each_shape() -> None:
    rng = np.random.default_rng(4)
    kinds = list(IdealFeature)
    parts = [cloud(shape, 20, 0.01, rng) / 3 + [500, 300, 250] for shape in kinds]
    points = np.concatenate([*parts, rng.uniform(0, 1, (12, 3)) * [900, 600, 500]])
    net = replace(network(132, 5, seed=6), points=points, nominal=points.copy()).read(rng)
    names = [str(shape) for shape in kinds for _ in range(20)]
    result = run(net, points[:120], names, asked(**{str(one): Feature(str(one), "both") for one in kinds}))
    found, of_points = result.tables["features"], result.tables["features_points"]
    assert found.texts("feature") == [str(one) for one in kinds for _ in range(2)]
    assert found.texts("fit") == ["least-squares", "minimum-zone"] * 6
    form = found.numbers("form").reshape(6, 2)
    assert (form[:, 1] < form[:, 0]).all()
    assert np.isnan(found.numbers("radius").reshape(6, 2)[:2]).all()
    assert (found.numbers("s_form") > 0).all()
    assert result.arrays["features_covariance"].shape == (108, 108)
    for row, name in enumerate(found.texts("feature")):
        own = (of_points.columns["feature"] == name) & (of_points.columns["fit"] == found.texts("fit")[row])
        deviation = of_points.numbers("deviation")[own]
        width = 2 * deviation.max() if name == "line" else np.ptp(deviation)
        assert width == pytest.approx(found.numbers("form")[row], abs=1e-12)
        assert of_points.numbers("contact")[own].sum() == pytest.approx(row % 2)


def test_minimum_zones_that_other_points_can_hold_are_named() -> None:
    """A twisted square of 40 um holds a plane; of two points inside, one is 10 um from the limit and one 20 um."""
    rng = np.random.default_rng(4)
    at = np.array([[0, 0, 0], [90, 0, 0.04], [90, 90, 0], [0, 90, 0.04], [45, 45, 0.03], [40, 45, 0.02]])
    points = np.concatenate([at + [500, 300, 250], rng.uniform(0, 1, (14, 3)) * [900, 600, 500]])
    net = replace(network(20, 6, seed=6), points=points, nominal=points.copy()).read(rng, 0.0)
    for probe, expected in ((1e-5, 0), (3.6e-3, 1), (7e-3, 2)):
        wanted = asked(A=Feature("plane", "both"))
        result = run(net, points[:6], ["A"] * 6, wanted, correction=Correction(0.0, probe))
        found = result.tables["features"]
        assert found.numbers("may_touch").tolist() == [0, expected]
        listed_at = [line for line in result.notes if "errors can lay on other points" in line]
        assert len(listed_at) == (expected > 0)
        assert not listed_at or f"A ({expected} more)" in listed_at[0]


def test_a_job_can_ask_for_every_shape() -> None:
    assert tuple(IdealFeature) == SHAPES


def test_features_without_covariance_between_points_are_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metrocli.tasks.multilaterate.report.factors", lambda covariance, block, chosen: {})
    net, names = two_balls(np.random.default_rng(1))
    result = run(net.read(np.random.default_rng(1)), net.nominal[:28], names, asked(A="sphere"))
    assert any("features take their points as independent" in line for line in result.warnings)
    assert result.tables["features"].numbers("s_radius")[0] > 0


def test_faults_of_features_are_listed() -> None:
    net, names = two_balls(np.random.default_rng(1))
    net = net.read(np.random.default_rng(1))
    with pytest.raises(InputError) as found:
        run(net, net.nominal[:28], [*names[:27], "C"], asked(a="sphere", C="plane"))
    assert [fault.message for fault in found.value.faults] == [
        "features.a: no point of `probing` is of feature 'a'",
        "features.C: feature 'C' has 1 points",
    ]
    assert [fault.hint for fault in found.value.faults] == ["did you mean 'A'?", "expected 3 or more for a plane"]
    turn = np.linspace(0, 6, 14)
    ring = np.column_stack([30 * np.cos(turn), 30 * np.sin(turn), 0 * turn]) + [100, 100, 100]
    with pytest.raises(UndeterminedError, match="feature 'A': the 14 points do not determine a cylinder") as open_one:
        run(net, np.concatenate([ring, net.nominal[14:28]]), names, asked(A="cylinder"), tolerance=1e3)
    assert open_one.value.misfit == 0.0


def test_the_command_lists_features(tmp_path: Path, metrocli: Any) -> None:
    """The sample with a feature: the terminal, --json and check."""
    folder = tmp_path / "gear"
    assert metrocli("init", folder, "--sample", "gear-m3d3").code == 0
    job = folder / "jobs" / "tip3.yaml"
    job.write_text(job.read_text() + "\nfeatures: {flank 1L: {shape: plane, fit: both}}\n")
    assert metrocli("check", job).code == 0
    done = metrocli("multilaterate", job)
    assert done.code == 0 and "flank 1L" in done.out and "minimum-zone" in done.out
    shown = metrocli("show", folder / "results" / "tip3.h5", "--table", "features")
    assert shown.out.splitlines()[0].startswith("feature,shape,fit,points,x_mm,sx_mm,y_mm,sy_mm")
    job.write_text(job.read_text().replace("flank 1L: {", "flank 1X: {"))
    done = metrocli("check", job)
    assert done.code == 3 and "did you mean 'flank 1R'" in done.err and "tip3.yaml:" in done.err
