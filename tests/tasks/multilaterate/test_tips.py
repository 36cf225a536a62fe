"""Several probe tips in one job: each is corrected by replays of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.lengths import Array, Network, network, settings

from metrocli.errors import InputError
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate

OFFSETS = np.array([[0.0, 0.0, -120.0], [90.0, 0.0, -60.0]])
TURN = np.array([4e-5, -6e-5, 8e-5])


def errors(nominal: Array, tip: Array) -> Array:
    """Error of the mover at its tips: a smooth one of the carriage, and its turn about its lever."""
    turn = np.sin(nominal[:, :1] / 300) * TURN
    return np.asarray(0.01 * np.cos(nominal / 250) + np.cross(turn, OFFSETS[tip]))


def replayed(rng: np.random.Generator) -> tuple[Network, Array]:
    """30 places, each replayed with the reflector at both tips, 0.2 mm apart."""
    places = rng.uniform(0, 1, (30, 3)) * [900, 600, 500]
    nominal = np.concatenate([places, places + 0.2])
    tip = np.repeat([0, 1], 30)
    net = replace(network(60, 6, seed=4), nominal=nominal, points=nominal - errors(nominal, tip))
    return net.read(rng, 0.1), tip


def tips(**more: Array) -> Table:
    columns = {"tip": np.array(["T1", "T2"]), **dict(zip("xyz", OFFSETS.T, strict=True)), **more}
    return Table(columns, dict.fromkeys("xyz", "mm"), "tips.csv", (2, 3))


def probing(at: Array, tip: Array, names: list[str]) -> Table:
    columns = {
        "feature": np.repeat("f", len(at)),
        "point": np.array(names),
        "tip": np.array(["T1", "T2", "T9"])[tip],
        **dict(zip("xyz", at.T, strict=True)),
    }
    return Table(columns, dict.fromkeys("xyz", "mm"), "probing.csv", tuple(range(2, len(at) + 2)))


def run(net: Network, points: Table, probed: Table, listed: Table | None) -> Result:
    files = (net.lengths(), points, net.tracer_table())
    return multilaterate.run(multilaterate.TASK.job(settings(), *files, probing=probed, tips=listed))


def off(result: Result, net: Network, at: Array, tip: Array) -> Array:
    """Corrected minus true places, in the frame of the result."""
    found, true = result.tables["corrected"].stacked("xyz"), at - errors(at, tip)
    points = result.tables["points"].stacked("xyz")
    u, _, vt = np.linalg.svd((points - points.mean(axis=0)).T @ (net.points - net.points.mean(axis=0)))
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return np.asarray(found - ((true - net.points.mean(axis=0)) @ turn.T + points.mean(axis=0)))


@pytest.mark.parametrize("named", [True, False])
def test_each_tip_has_its_own_correction(named: bool) -> None:
    """The tips differ by up to 5 um at one place: by the tip of a replay, by name and by place."""
    net, tip = replayed(np.random.default_rng(3))
    points = net.point_table() if named else net.point_table(tip=np.array(["T1", "T2"])[tip])
    # without names, every probing point lies as near to the replay of the other tip
    at = net.nominal if named else net.nominal + np.where(tip == 0, 0.1, -0.1)[:, None]
    names = net.names if named else [""] * 60
    result = run(net, points, probing(at, tip, names), tips())
    assert np.abs(off(result, net, at, tip)).max() < 1e-3
    corrected = result.tables["corrected"]
    assert list(corrected)[:3] == ["feature", "point", "tip"]
    other = np.abs(errors(net.nominal, tip) - errors(net.nominal, 1 - tip)).max()
    assert other > 4e-3


def test_how_well_the_reflector_stands_at_a_tip_counts_for_all_its_points() -> None:
    net, tip = replayed(np.random.default_rng(3))
    probed = probing(net.nominal, tip, net.names)
    exact, loose = (run(net, net.point_table(), probed, tips(sigma=np.array([0.0, s]))) for s in (0.0, 0.004))
    before, after = (one.arrays["corrected_covariance"] for one in (exact, loose))
    assert after[:30] == pytest.approx(before[:30])
    assert after[30:] - before[30:] == pytest.approx(np.broadcast_to(0.004**2 * np.eye(3), (30, 3, 3)))


def test_faults_of_tips() -> None:
    net, tip = replayed(np.random.default_rng(3))
    wrong = tip.copy()
    wrong[5] = 2
    for listed, rows, match in (
        (tips(), wrong, "tips.csv has no tip 'T9'"),
        (None, tip, "the column 'tip' needs a list of tips"),
    ):
        with pytest.raises(InputError, match=match):
            run(net, net.point_table(), probing(net.nominal, rows, net.names), listed)
    two = probing(net.nominal[[0, 0]], np.array([0, 1]), ["P0", "P0"])
    with pytest.raises(InputError, match="point 'P0' is probed with two tips") as found:
        run(net, net.point_table(), two, tips())
    assert [fault.line for fault in found.value.faults] == [3]
    elsewhere = net.point_table(tip=np.repeat("T1", 60))
    with pytest.raises(InputError, match="no replayed point of its name or within 1 mm that replays tip 'T2'") as found:
        run(net, elsewhere, probing(net.nominal, tip, net.names), tips())
    assert len(found.value.faults) == 30
    nameless = probing(net.nominal, tip, net.names)
    nameless = replace(nameless, columns={k: v for k, v in nameless.columns.items() if k != "tip"})
    for listed, points in ((tips(), net.point_table()), (None, elsewhere)):
        with pytest.raises(InputError, match="there is no column 'tip'"):
            run(net, points, nameless, listed)
    unknown = tips(sigma=np.array([0.0, np.nan]))
    with pytest.raises(InputError, match="tip 'T2' has no sigma"):
        run(net, net.point_table(), probing(net.nominal, tip, net.names), unknown)
