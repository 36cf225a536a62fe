"""Networks written as LGC2 reads them become the same network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from simulated.network import marks

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """\
metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, points: points.csv}
instruments: {TS1: {type: total-station}}
output: result.h5
"""
GON = 200 / np.pi
HEAD = """\
*TITR
a network
*OLOC
*FAUT .01 .10
*INSTR
% a comment
*POLAR TS prism 0 0 0 0
prism 5 6 0.1 2 0 0 0 0 0 0
# another comment
"""


def adjusted(folder: Path, lines: list[str], metrocli: Metrocli) -> tuple[int, Any]:
    (folder / "net.lgc").write_text(HEAD + "\n".join([*lines, "*END"]))
    ran = metrocli("import", folder / "net.lgc", "--from", "lgc2", "--out", folder)
    assert ran.code == 0, ran.err
    (folder / "job.yaml").write_text(JOB)
    ran = metrocli("adjust-network", folder / "job.yaml")
    assert ran.code in (0, 6), ran.err
    return ran.code, hdf5.read(folder / "result.h5")[0]


def test_a_network_is_the_same(tmp_path: Path, metrocli: Metrocli) -> None:
    x, height, target, seen = marks(np.random.default_rng(44), 9)
    written = [f"P{i} {' '.join(f'{v / 1000:.12g}' for v in x[i])}" for i in range(9)]
    lines = ["*CALA", *written[:2], "*VXY", written[2], "*POIN", *written[3:]]
    for s in range(4):
        lines += [f"*TSTN P{4 + s} TS IHFIX IH {height[s] / 1000:.12g}", "*V0"]
        for key, column in (("*ANGL", 0), ("*ZEND", 1), ("*DIST", 2)):
            lines.append(key)
            for k in np.flatnonzero(np.isfinite(seen[s, :, 0])):
                a, e, d = seen[s, k]
                value = (np.remainder(-a * GON, 400), 100 - e * GON, d / 1000)[column]
                lines.append(f"P{k} {value:.11f} TH {target[k] / 1000:.12g} TRGT prism % noted")
    code, result = adjusted(tmp_path, lines, metrocli)
    assert code == 0
    points = result.tables["points"]
    order = [int(name[1:]) for name in points.texts("point")]
    assert np.abs(points.stacked("xyz") - x[order]).max() < 1e-3
    head, *rows = (line.split(",") for line in (tmp_path / "readings.csv").read_text().splitlines()[1:])
    whole = [dict(zip(head, row, strict=True)) for row in rows]
    assert float(whole[0]["sigma_d_mm"]) == pytest.approx(0.1 + 2e-3 * float(whole[0]["d_m"]), rel=1e-6)
    assert (float(whole[0]["sigma_hz_mgon"]), float(whole[0]["sigma_zd_mgon"])) == pytest.approx((0.5, 0.6))


def test_exact_points_hold_where_the_place_of_the_instrument_is_rough(tmp_path: Path, metrocli: Metrocli) -> None:
    """A free station whose listed place is a metre off: the exact points once moved to where its readings put them."""
    marks_m = np.array([[0.0, 1.8, 1.0], [1.2, 1.9, 0.5], [1.6, -1.1, 0.6], [-1.8, -1.1, 1.0]])
    truth, turn = np.array([0.03, -0.03, -0.06]), 0.7
    rng = np.random.default_rng(3)
    away = marks_m - truth
    flat = np.hypot(*away.T[:2])
    true = np.stack(
        [np.arctan2(away[:, 0], away[:, 1]) - turn, np.arctan2(flat, away[:, 2]), np.linalg.norm(away, axis=1)]
    )
    read = true + rng.normal(size=true.shape) * [[5e-4 / GON], [6e-4 / GON], [1e-4]]
    lines = ["*CALA", *(f"M{i} {' '.join(map(str, at))}" for i, at in enumerate(marks_m.tolist()))]
    lines += ["*POIN", "S 1.163 1.279 1.692", "*TSTN S TS IHFIX IH 0 IHSE 0", "*V0", "*PLR3D"]
    lines += [f"M{i} {h * GON % 400:.9f} {z * GON:.9f} {d:.9f}" for i, (h, z, d) in enumerate(read.T.tolist())]
    code, result = adjusted(tmp_path, lines, metrocli)
    assert code == 0

    def misfit(p: Any) -> Any:
        away = marks_m - p[:3]
        flat = np.hypot(*away.T[:2])
        off = np.arctan2(away[:, 0], away[:, 1]) - p[3] - read[0]
        angles = np.stack([(off + np.pi) % (2 * np.pi) - np.pi, np.arctan2(flat, away[:, 2]) - read[1]])
        distance = np.linalg.norm(away, axis=1)
        ppm = 1e-4 + 2e-6 * read[2]
        return np.concatenate([*(angles * GON / [[5e-4], [6e-4]]), (distance - read[2]) / ppm])

    wanted = least_squares(misfit, [*truth, turn], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    points = result.tables["points"]
    at = dict(zip(points.texts("point"), points.stacked("xyz"), strict=True))
    assert at["S"] == pytest.approx(wanted.x[:3] * 1000, abs=1e-6)
    assert at["M1"] == pytest.approx(marks_m[1] * 1000, abs=0)
    assert result.statistics["chi2"] == pytest.approx(2 * wanted.cost, rel=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("*INSTR\n", "", "without *INSTR this is the older layout of LGC1"),
        ("*PLR3D", "*ECHO", "*ECHO is not read"),
        ("IHFIX IH 0 IHSE 0", "IH 0", "the height of the instrument is an unknown of LGC2"),
        ("*V0", "*V0\n*FRAME F 0 0 0 0 0 0 1", "*FRAME F 0 is not read"),
        ("M0 45 100 2", "M0 45 100", "this is not a line of *PLR3D"),
        ("M0 45 100 2", "M0 45 100 2 TRGT ccr", "'ccr' is not a target of the instrument"),
        ("IHFIX", "ROT3D IHFIX", "not levelled"),
        ("S TS IHFIX", "S TS2 IHFIX", "'TS2' is not an instrument of this file"),
        ("IH 0 IHSE", "IH high IHSE", "IH has the value 'high'"),
        ("M0 45 100 2", "M0 45 100 2 TH x", "TH has the value 'x'"),
        ("S 1 1 1", "S 1 1 1 SX 0.0 SY 0.5", "sigmas of a point other than 0 are not read"),
        ("S 1 1 1", "S 1 1 1 APRICOV DIAG(1,2,3)", "sigmas of a point other than 0 are not read"),
        ("prism 5 6 0.1", "prism 5 0 0.1", "a standard deviation of the target is not above zero"),
    ],
)
def test_what_is_not_read_is_named(old: str, new: str, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    rows = ["*CALA", "M0 0 1 0", "*POIN", "S 1 1 1", "*TSTN S TS IHFIX IH 0 IHSE 0", "*V0", "*PLR3D", "M0 45 100 2"]
    text = (HEAD + "\n".join([*rows, "*END"])).replace(old, new, 1)
    (tmp_path / "net.lgc").write_text(text)
    ran = metrocli("import", tmp_path / "net.lgc", "--from", "lgc2", "--out", tmp_path / "out")
    assert ran.code == 3 and words in ran.err, ran.err
    assert not (tmp_path / "out").exists()
