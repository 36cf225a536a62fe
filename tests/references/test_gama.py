"""Networks of GNU Gama's regression tests against the results that it prints (gama-local 2.13 and 2.18.5).

Numbers from tests/gama-local/input of GNU Gama: local_3d (Czech Technical University in Prague), Baumann 23.3.4, and Wolf
1979, p. 87, both after Krumm, Geodetic Network Adjustment Examples, rev. 3.5. Results in m, covariances in mm2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import hdf5
from metrocli.result import Result

Metrocli = Callable[..., Any]
Row = tuple[str, str, str]
TAGS = ("direction", "s-distance", "z-angle")
HALL = {
    "141": "5 0 - 102.9145;2 32.9614 18.2605 96.4396;3 247.5799 41.577 83.5817;4 280.2704 44.566 84.7182;"
    "142 352.0014 12.073 101.0509;1 385.3791 36.9805 99.6349",
    "142": "5 0 - 103.3086;2 43.0365 18.7065 95.8442;141 119.6653 12.0725 98.9495;3 197.0721 44.1125 84.2490;"
    "4 230.1957 41.0733 83.0701;1 367.3006 27.2118 99.0375",
}
"""Target, direction [gon], slope distance [m] and zenith angle [gon], by station"""
HALL_ADJUSTED = {
    "1": (31.0637256471691, 14.9217612196894, 0.3252471431971),
    "2": (4.4013514624330, 15.1002090916190, 1.1339690132223),
    "3": (-6.4870640512011, -41.9729265247292, 10.7170186268747),
    "4": (14.9238129413724, -41.9769411712909, 10.7086191966797),
    "5": (16.1938553288505, 13.3004845000698, -0.9699724888528),
    "141": (-1.7929146146036, -2.0469564541488, 0.1131461978391),
    "142": (10.2649146146036, -2.6210435458512, -0.0861461978391),
}
"""Constrained to the approximate coordinates of 141 and 142"""
HALL_VARIANCES = (1.7422996e-1, 3.0903021e-1, 1.9073787e-2)
"""Of point 1, to the west, to the south and upwards"""
WOLF = {"1": "1200 900", "2": "900 600", "3": "600 900", "4": "900 1200"}


def adjusted(xml: Sequence[str], folder: Path, metrocli: Metrocli, more: str = "", axes: str = "en") -> Result:
    """Return the result of a network of Gama."""
    head = f'<gama-local><network axes-xy="{axes}" angles="left-handed">'
    (folder / "net.gkf").write_text("\n".join([head, *xml, "</network></gama-local>"]))
    ran = metrocli("import", folder / "net.gkf", "--from", "gama-xml", "--out", folder)
    assert ran.code == 0, ran.err
    inputs = ", ".join(f"{path.stem}: {path.name}" for path in sorted(folder.glob("*.csv")))
    (folder / "job.yaml").write_text(
        f"metrocli: 1\njob: adjust-network\ninputs: {{{inputs}}}\n"
        f"instruments: {{TS1: {{type: total-station}}}}\n{more}output: result.h5\n"
    )
    ran = metrocli("adjust-network", folder / "job.yaml")
    assert ran.code == 0, ran.err
    return hdf5.read(folder / "result.h5")[0]


def test_hall_in_inner_constraints_of_two_points(tmp_path: Path, metrocli: Metrocli) -> None:
    spread = 'distance-stdev="1.0" direction-stdev="4.0" zenith-angle-stdev="4.0"'
    lines = [
        f"<points-observations {spread}>",
        '<point id="141" x="-1.792" y="-2.047" z="0.113" adj="XYZ"/>',
        '<point id="142" x="10.264" y="-2.621" z="-0.086" adj="XYZ"/>',
        *(f'<point id="{name}" adj="XYZ"/>' for name in range(1, 6)),
    ]
    for station, shots in HALL.items():
        lines.append(f'<obs from="{station}">')
        for target, *values in (shot.split() for shot in shots.split(";")):
            lines += [f'<{tag} to="{target}" val="{v}"/>' for tag, v in zip(TAGS, values, strict=True) if v != "-"]
        lines.append("</obs>")
    result = adjusted([*lines, "</points-observations>"], tmp_path, metrocli, "datum_points: ['141', '142']\n", "sw")
    points = result.tables["points"]
    names = points.texts("point")
    # Gama's x is to the south and y to the west
    ours = points.stacked("xyz")[:, [1, 0, 2]] * [-1.0, -1.0, 1.0]
    theirs = 1000 * np.array([HALL_ADJUSTED[name] for name in names])
    # Gama does not linearise again below its bound: its squares are those of approximate places 2 mm away
    assert np.abs(ours - theirs).max() < 5e-4
    assert result.statistics["chi2"] == pytest.approx(206.44823 / 16.0, rel=5e-5)
    assert result.statistics["dof"] == 15
    variances = points.stacked(["sx", "sy", "sz"])[names.index("1")] ** 2
    assert variances == pytest.approx(HALL_VARIANCES, rel=2e-4)


def test_distances_and_zenith_angles_from_fixed_points(tmp_path: Path, metrocli: Metrocli) -> None:
    lines = ["<points-observations>", "<point id='P' x='900' y='900' z='1300' adj='xyz'/>"]
    for (name, place), d, z in zip(
        WOLF.items(), ("499.99", "500.00", "500.01", "500.02"), ("728", "698", "667", "636"), strict=True
    ):
        x, y = place.split()
        lines += [
            f"<point id='{name}' x='{x}' y='{y}' z='900' fix='xyz'/>",
            f"<obs><s-distance from='{name}' to='P' val='{d}' stdev='10'/></obs>",
            f"<obs><z-angle from='{name}' to='P' val='40.966{z}' stdev='127.323954'/></obs>",
        ]
    result = adjusted([*lines, "</points-observations>"], tmp_path, metrocli)
    points = result.tables["points"]
    row = points.texts("point").index("P")
    assert points.stacked("xyz")[row] == pytest.approx([900016.3706423, 899983.6297647, 1300006.2050088], abs=1e-4)
    # Gama scales by its variance factor, 1.0814613e-4 / 5 over an a priori 0.01
    assert result.statistics["chi2"] == pytest.approx(1.0814613, rel=1e-6)
    scale = 1.0814613 / 5
    assert points.stacked(["sx", "sy", "sz"])[row] ** 2 * scale == pytest.approx(
        [29.516446, 29.516446, 8.4015657], rel=1e-5
    )


def test_station_with_heights_of_instrument_and_targets(tmp_path: Path, metrocli: Metrocli) -> None:
    known = {"1": "1000.000 1201.171 108.680", "2": "1371.217 1072.895 111.974", "3": "1016.437 952.352 117.312"}
    seen = {
        "1": ("0.0000", "223.6428", "95.9015", "1.572"),
        "2": ("160.1838", "190.2878", "94.0450", "1.650"),
        "3": ("320.7884", "205.1894", "92.8390", "1.588"),
    }
    lines = ["<points-observations>", "<point id='N' x='1181.766' y='1071.674' z='94.258' adj='xyz'/>"]
    for name, place in known.items():
        x, y, z = place.split()
        lines.append(f"<point id='{name}' x='{x}' y='{y}' z='{z}' fix='xyz'/>")
    lines += ['<obs from="N">', *(f'<direction to="{k}" val="{v[0]}" stdev="20"/>' for k, v in seen.items()), "</obs>"]
    for column, tag, stdev in ((1, "s-distance", 5), (2, "z-angle", 25)):
        lines.append("<obs>")
        for k, v in seen.items():
            lines.append(f"<{tag} from='N' to='{k}' val='{v[column]}' stdev='{stdev}' from_dh='1.600' to_dh='{v[3]}'/>")
        lines.append("</obs>")
    result = adjusted([*lines, "</points-observations>"], tmp_path, metrocli)
    points = result.tables["points"]
    place = points.stacked("xyz")[points.texts("point").index("N")]
    # Gama reduces the readings to the marks at approximate places, which moves its result by some um
    assert place == pytest.approx([1181764.52054, 1071679.52259, 94259.82893], abs=0.02)
    assert result.statistics["dof"] == 5
    assert result.statistics["chi2"] == pytest.approx(2597.1969 / 400, rel=2e-3)


def test_distances_and_angles_turned_by_an_azimuth(tmp_path: Path, metrocli: Metrocli) -> None:
    """Ghilani, Adjustment Computations, 5th ed., example 16.2, after Krumm; Gama scales by its variance factor."""
    points = {"R": "1003.06 2640.01", "S": "2323.07 2638.47", "T": "2661.75 1096.07"}
    distances = "QR 1640.016 26;RS 1320.001 24;ST 1579.123 25;TQ 1664.524 26;QS 2105.962 29;RT 2266.035 30"
    angles = (
        "QRS 38-48-50.7 4.0;QST 47-46-12.4 4.0;QTR 273-24-56.5 4.4;RQS 269-57-33.4 4.7;SRT 257-32-56.8 4.7;"
        "TSQ 279-04-31.2 4.5;RST 42-52-51.0 4.3;RSQ 90-02-26.7 4.5;SQR 51-08-45.0 4.3;STQ 51-18-16.2 4.0;"
        "TRS 34-40-05.7 4.0"
    )
    lines = ["<points-observations>", "<point id='Q' x='1000' y='1000' fix='xy'/>"]
    for name, place in points.items():
        x, y = place.split()
        lines.append(f"<point id='{name}' x='{x}' y='{y}' adj='xy'/>")
    lines.append("<obs>")
    for (a, b), value, stdev in (row.split() for row in distances.split(";")):
        lines.append(f"<distance from='{a}' to='{b}' val='{value}' stdev='{stdev}'/>")
    for (a, b, c), value, stdev in (row.split() for row in angles.split(";")):
        lines.append(f"<angle from='{a}' bs='{b}' fs='{c}' val='{value}' stdev='{stdev}'/>")
    lines += ["<azimuth from='Q' to='R' val='0-6-24.5' stdev='0.001'/>", "</obs></points-observations>"]
    result = adjusted(lines, tmp_path, metrocli)
    table = result.tables["points"]
    rows = [table.texts("point").index(name) for name in points]
    theirs = [1003.057151105, 2640.005075988, 2323.062648462, 2638.474203968, 2661.738608923, 1096.086708522]
    assert np.abs(table.stacked("xy")[rows].ravel() / 1000 - theirs).max() < 1e-7
    assert (result.statistics["dof"], result.statistics["chi2"]) == (12, pytest.approx(1.4920546, rel=1e-6))
    variances = [1.3205965e-4, 35.675414, 30.141441, 43.519328, 34.818758, 52.881995]
    ours = (table.stacked(["sx", "sy"])[rows] ** 2).ravel() * result.statistics["chi2"] / 12
    # the azimuth holds x of R across the line to R: Gama's variance of x is that at approximate places
    assert ours == pytest.approx(variances, rel=2e-5, abs=3e-7)
