"""The data of each figure by values, and each figure as a file: title, unit and magnification are in it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plots import results

from metrocli import plots
from metrocli.errors import UsageError
from metrocli.plots import scene
from metrocli.plots.images.projection_error import ProjectionError
from metrocli.plots.places import places_of
from metrocli.plots.readings import residuals_of
from metrocli.plots.style import DARK, LIGHT
from metrocli.report.findings import worst
from metrocli.result import Estimate, Result
from metrocli.table import Table

RNG = np.random.default_rng(881)
UV = RNG.random((300, 2)) * [640, 480]


def lens(**columns: np.ndarray) -> Result:
    return results.camera(UV, RNG.normal(size=(300, 2)) * 0.1, **columns)


def test_a_result_lists_only_what_it_can_show() -> None:
    assert plots.names_of(lens()) == [
        "residuals",
        "residuals-radius",
        "residuals-image",
        "normal-plot",
        "coverage",
        "correlation",
    ]
    assert "residuals-time" in plots.names_of(lens(t=np.arange(300.0)))
    assert plots.names_of(results.network()) == [
        "scene",
        "residuals",
        "residuals-time",
        "residuals-length",
        "residuals-part",
        "normal-plot",
    ]
    assert plots.names_of(results.machine()) == ["scene", "error-curves", "volumetric-error", "uncertainty-map"]
    assert plots.names_of(results.budget()) == ["budget", "conformity"]
    assert plots.names_of(Result("x", "", (), np.zeros((0, 0)), {})) == []


def test_a_radial_error_shows_along_the_radius_only() -> None:
    """Every reading is 0.5 px further out: w along the radius is 5, across it 0."""
    away = UV - [320.0, 240.0]
    out = 0.5 * away / np.linalg.norm(away, axis=1)[:, None]
    along, across = plots.data_of("residuals-radius", results.camera(UV, out)).panels
    assert along.w == pytest.approx(5.0) and across.w == pytest.approx(0.0, abs=1e-12)
    assert along.covariate == pytest.approx(np.hypot(*away.T))
    assert len(along.trend.beyond) == 20 and not len(across.trend.beyond)


def test_the_worst_reading_is_named() -> None:
    residuals = np.zeros((300, 2))
    residuals[123] = [0.0, 0.9]
    found = plots.data_of("residuals", results.camera(UV, residuals)).panels[0]
    assert found.label == "i12/t3/v" and found.beyond.tolist() == [247]
    (shown,) = plots.data_of("residuals-image", results.camera(UV, residuals))
    assert shown.worst_name == "i12/t3" and shown.beyond.tolist().count(True) == 1
    assert shown.vectors[shown.worst].tolist() == [0.0, 0.9]


def test_panels_share_the_bound_of_all_readings() -> None:
    """A figure and the first lines of its page judge a reading alike: 4 of 40 readings are in a panel of their own."""
    found = {"residual": np.zeros(36), "normalised": np.zeros(36)}, {"residual": np.zeros(4), "normalised": np.zeros(4)}
    found[1]["normalised"][2] = 2.7  # beyond the bound of 4 readings, 2.49, not beyond that of 40, 3.22
    tables = {name: Table(columns) for name, columns in zip(("angles", "distances"), found, strict=True)}
    result = Result("locate-launch-unit", "", (), np.zeros((0, 0)), {}, tables)
    panels = plots.data_of("residuals", result).panels
    assert [len(one.beyond) for one in panels] == [0, 0] and panels[0].most == panels[1].most == pytest.approx(
        3.22, abs=0.01
    )
    assert next(worst(result)).endswith("|w| = 2.70 standard deviations; as noise may be (bound 3.22).")


def test_instruments_and_faces_have_a_row_each() -> None:
    shown = plots.data_of("residuals-instrument", results.instruments())
    rows = {row.name: row.values.tolist() for row in shown.panels[0][1]}
    assert rows == {"A az": [-1.0, 1.0, 3.0], "B d": [2.0, 2.0]}
    assert shown.bound == pytest.approx(2.57, abs=0.01)  # of five values
    faces = {
        name: [(row.name, row.values.tolist()) for row in rows]
        for name, rows in plots.data_of("two-face", results.instruments()).panels
    }
    assert faces == {"azimuth": [("S1", [2.0, 4.0])], "elevation": [("S1", [0.0, 0.0]), ("S2", [0.0])]}


def test_vectors_over_the_image_fit_into_it() -> None:
    (shown,) = plots.data_of("residuals-image", results.camera(UV, np.full((300, 2), 0.03)))
    assert shown.magnification == 1000.0  # 0.0424 px become 42 px, at most 640 / 14
    assert shown.readings == 300
    many = np.random.default_rng(882).random((3000, 2)) * [640, 480]
    (shown,) = plots.data_of("residuals-image", results.camera(many, np.full((3000, 2), 0.03)))
    assert shown.magnification == 500.0  # of many vectors each stays in its cell: at most 640 / sqrt(500)


def test_coverage_counts_every_reading_once() -> None:
    uv = np.array([[0.0, 0.0], [1.0, 1.0], [639.0, 479.0], [320.0, 0.0]])
    (found,) = plots.data_of("coverage", results.camera(uv, np.zeros((4, 2))))
    assert found.counts.sum() == 4 and found.counts[0, 0] == 2 and found.counts[9, 9] == 1 and found.counts[0, 5] == 1
    assert found.filled == 0.03


def test_residuals_along_beams_by_hand() -> None:
    """A: beams along x and y with 1 and 2 um; B: 3 um towards L1, along -x; C: 4 um along y."""
    found = plots.data_of("residuals-part", results.network())
    vectors = dict(zip(found.names, found.vectors.tolist(), strict=True))
    assert vectors["A"] == pytest.approx([0.001, 0.002, 0.0])
    assert vectors["B"] == pytest.approx([-0.003, 0.0, 0.0])
    assert vectors["C"] == pytest.approx([0.0, 0.004, 0.0])
    assert dict(zip(found.names, found.rms, strict=True)) == pytest.approx(
        {"A": np.sqrt(2.5), "B": np.sqrt(4.5), "C": np.sqrt(8.0)}
    )
    assert found.plane == (0, 1) and found.magnification == 5000.0


def test_the_scene_magnifies_vectors_and_ellipsoids() -> None:
    found = plots.data_of("scene", results.network())
    assert [one.kind for one in found.places] == ["points", "tracers"]
    # the diagonal of all places is sqrt(200² + 300²) = 361 mm; the longest vector is 5 um, 36 mm at most
    assert found.vectors == 5000.0
    assert found.places[0].covariance[1] == pytest.approx(np.diag([1e-6, 4e-6, 9e-6]))


@pytest.mark.parametrize("turn", [0.3, 2.0, -1.1])
def test_outlines_are_the_shadows_of_ellipsoids(turn: float) -> None:
    """The extent of many points of an ellipsoid along any direction of the picture is that of the drawn ellipse."""
    rng = np.random.default_rng(882)
    root = rng.normal(size=(3, 3))
    rows = scene.view(turn, 0.4)
    assert rows @ rows.T == pytest.approx(np.eye(3))
    a, b, angle = (float(one[0]) for one in scene.outline((root @ root.T)[None], rows))
    sphere = rng.normal(size=(200_000, 3))
    flat = (sphere / np.linalg.norm(sphere, axis=1)[:, None]) @ root.T @ rows[:2].T
    for direction, half in ((angle, a), (angle + np.pi / 2, b)):
        assert (flat @ [np.cos(direction), np.sin(direction)]).max() == pytest.approx(half, rel=2e-3)


def test_error_curves_are_in_micrometres_with_k_2() -> None:
    found = plots.data_of("error-curves", results.machine())
    straight, yaw = found.curves
    assert (straight.name, straight.determined, yaw.name, yaw.determined) == ("EXX", True, "ECX", False)
    assert straight.value.tolist() == [0.0, 20.0] and straight.spread.tolist() == [0.0, 2.0]
    assert found.squareness == (("C0Y", pytest.approx(10.0), pytest.approx(4.0)),)


def test_maps_over_the_volume() -> None:
    error = plots.data_of("volumetric-error", results.machine())
    assert error.largest == pytest.approx(np.hypot(0.02, 0.015)) and error.largest_at == (100.0, 0.0, 50.0)
    assert [layer.z for layer in error.layers] == [0.0, 50.0]
    assert error.layers[0].size == pytest.approx([0.0, 20.0, 0.0, 20.0])
    spread = plots.data_of("uncertainty-map", results.machine())
    assert spread.layers[1].size == pytest.approx(7.0) and spread.layers[1].vectors is None


def test_the_surface_with_the_least_overstock_is_first() -> None:
    found = plots.data_of("overstock", results.raw_part())
    assert found.surfaces == ("top", "side") and found.least_at == ("P9", "P3")
    assert found.least.tolist() == [0.6, 1.5] and found.spread.tolist() == [0.04, 0.02] and found.minimum == 0.5
    assert found.left_out == (("side", -3.0),)


def test_the_scale_of_colours_is_as_high_as_the_map() -> None:
    from metrocli.plots import style

    with plots.drawn("correlation", plots.data_of("correlation", lens())) as (canvas, _):
        style.arrange(canvas)
        canvas.figure.draw_without_rendering()
        matrix, bar = (axes.get_window_extent() for axes in canvas.figure.axes)
    assert (bar.y0, bar.y1) == pytest.approx((matrix.y0, matrix.y1), abs=0.5)
    assert 0 < bar.x0 - matrix.x1 < bar.width * 4


@pytest.mark.parametrize(("name", "result"), [("correlation", lens()), ("volumetric-error", results.machine())])
def test_axes_with_equal_units_leave_no_empty_room(name: str, result: Result) -> None:
    """They begin at the left, the scale of colours stands beside them, and rows are as high as what is drawn."""
    from metrocli.plots import style

    with plots.drawn(name, plots.data_of(name, result)) as (canvas, _):
        style.arrange(canvas)
        *panels, bar = canvas.figure.axes
        places = [axes.get_tightbbox(canvas.figure.canvas.get_renderer()) for axes in (*panels, bar)]  # type: ignore[attr-defined]
        dpi, (_, height) = canvas.figure.dpi, canvas.figure.get_size_inches()
    assert min(place.x0 for place in places) < 0.3 * dpi
    assert max(place.y1 for place in places) > (height - 0.3) * dpi and min(place.y0 for place in places) < 0.3 * dpi
    right = max(axes.get_position().x1 for axes in panels)
    assert 0 < places[-1].x0 / dpi / style.WIDTH - right < 0.05


def test_readings_are_named_so_that_they_can_be_found() -> None:
    """Balls by their place in the artefact, readings of a path by the commanded place; their coordinates are not lengths."""
    three = {"residual": np.ones(2), "normalised": np.ones(2)}
    grid = {
        "view": np.array(["1", "1"]),
        "i": np.array(["2", "2"]),
        "j": np.array(["-1", "-1"]),
        "k": np.array(["0", "0"]),
    }
    balls = Table(
        {**grid, "component": np.array(["x", "y"]), "reading": np.array([1.0, 2.0]), **three}, {"reading": "mm"}
    )
    (one,) = residuals_of(Result("selfcal-grid", "", (), np.zeros((0, 0)), {}, {"residuals": balls}))
    assert one.name(1) == "1/ball (2, -1, 0)/y" and "length" not in one.covariates
    along = {"leg": np.array(["28", "28"]), "x": np.array([0.0, 12.5]), "y": np.zeros(2), "z": np.array([-50.0, -50.0])}
    path = Table({**along, "residual_a": np.ones(2), "normalised_a": np.ones(2)})
    (one,) = residuals_of(Result("calibrate-machine", "", (), np.zeros((0, 0)), {}, {"residuals": path}))
    assert one.name(1) == "28 at (12.5, 0, -50) mm a"


def test_a_launch_unit_has_a_view_with_its_beams() -> None:
    beams = Table(
        {
            "pose": np.array(["1", "2"]), "length": np.array([50.0, 200.0]),
            "wx": np.array([0.6, 0.0]), "wy": np.array([0.8, 0.0]), "wz": np.array([0.0, -1.0]),
        },
        {"length": "mm"},
    )  # fmt: skip
    estimates = tuple(Estimate(name, value, 1.0, "mm") for name, value in zip("xyz", (1.0, 2.0, 3.0), strict=True))
    covariance = np.diag([1.0, 4.0, 9.0])
    unit, receivers = places_of(Result("locate-launch-unit", "", estimates, covariance, {}, {"beams": beams}))
    assert unit.at.tolist() == [[1.0, 2.0, 3.0]] and np.array_equal(unit.covariance, covariance[None])
    assert receivers.names == ("1", "2") and np.allclose(receivers.at, [[31.0, 42.0, 3.0], [1.0, 2.0, -197.0]])


def test_the_worst_may_be_a_calibrated_length() -> None:
    ends = {f"{axis}{end}": np.array([float(end), 0.0]) for end in (1, 2) for axis in "ijk"}
    residual = np.array([0.001, 0.009])
    columns = {**ends, "component": np.repeat("length", 2), "reading": np.full(2, 100.0)}
    columns |= {"residual": residual, "normalised": residual / 1e-3}
    readings = {"component": np.repeat("x", 3), "residual": np.full(3, 1e-3), "normalised": np.ones(3)}
    tables = {"residuals": Table(readings), "lengths": Table(columns, {"reading": "mm"})}
    result = Result("selfcal-grid", "", (), np.zeros((0, 0)), {}, tables)
    assert [one.kind for one in residuals_of(result)] == ["residuals", "lengths"]
    assert next(worst(result)).startswith("Reading ball (0, 0, 0)/ball (0, 0, 0)/length: |w| = 9.00")


def test_correlations() -> None:
    found = plots.data_of("correlation", lens())
    assert found.matrix[0, 1] == pytest.approx(0.5) and found.largest == ("cx", "cy", pytest.approx(-0.9))
    alone = replace(lens(), covariance=np.diag(np.diag(lens().covariance)))
    assert plots.data_of("correlation", alone) is None


def test_a_budget_is_sorted_and_adds_up() -> None:
    (chart,) = plots.data_of("budget", results.budget())
    assert chart.names == ("large", "middle", "small") and chart.together.tolist() == [60.0, 90.0, 100.0]


def test_many_small_contributors_share_a_bar() -> None:
    shares = np.append(np.full(20, 2.0), 60.0)
    names = np.array([f"c{k}" for k in range(21)])
    table = Table({"measurand": np.full(21, "l"), "contributor": names, "share": shares})
    (chart,) = plots.data_of("budget", replace(results.budget(), tables={"budget": table}))
    assert chart.names[0] == "c20" and chart.names[-1] == "11 others" and chart.together[-1] == 100.0


def test_conformity() -> None:
    (one,) = plots.data_of("conformity", results.budget())
    assert (one.value, one.U, one.low, one.high, one.accepted) == (50.0005, 2e-4, 49.999, 50.001, (49.9992, 50.0008))


ALL = [
    (name, result)
    for result in (
        lens(t=np.arange(300.0), temp=np.linspace(19, 22, 300)),
        results.network(),
        results.machine(),
        results.budget(),
        results.raw_part(),
    )
    for name in plots.names_of(result)
]
AGAIN = {number for number, (name, _) in enumerate(ALL) if name in [before for before, _ in ALL[:number]]}
"""Figures of a name that a result before them has, too: one drawing makes them all"""


@pytest.mark.parametrize(
    ("name", "result"),
    [pytest.param(*one, marks=pytest.mark.slow if number in AGAIN else ()) for number, one in enumerate(ALL)],
    ids=lambda one: one if isinstance(one, str) else one.kind,
)
def test_each_figure_names_what_it_shows(name: str, result: Result, tmp_path: Path) -> None:
    plots.save(result, name, tmp_path / "x.svg", ".svg")
    text = (tmp_path / "x.svg").read_text(encoding="utf-8")
    words = " ".join("".join(node.itertext()) for node in ET.fromstring(text).iter() if node.tag.endswith("text"))
    assert plots.title_of(name) in words
    assert re.search(
        r"\((µm|mm|px|s|°C|%|µrad|standard deviations)\)|coefficient|root mean square of w|\d mm", words
    ), words
    if name in ("residuals-image", "residuals-part", "scene", "volumetric-error"):
        assert "magnified ×" in words


def test_the_same_result_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("x.svg", "y.svg"):
        plots.save(results.network(), "residuals-part", tmp_path / name, ".svg")
    assert (tmp_path / "y.svg").read_bytes() == (tmp_path / "x.svg").read_bytes()


def test_other_formats_and_the_dark_ground(tmp_path: Path) -> None:
    result = results.budget()
    for ending, magic in ((".pdf", b"%PDF"), (".png", b"\x89PNG")):
        plots.save(result, "conformity", tmp_path / f"x{ending}", ending)
        assert (tmp_path / f"x{ending}").read_bytes().startswith(magic)
    plots.save(result, "conformity", tmp_path / "dark.svg", ".svg", dark=True)
    text = (tmp_path / "dark.svg").read_text(encoding="utf-8")
    assert DARK.surface in text and LIGHT.surface not in text


def luminance(colour: str) -> float:
    """Relative luminance of a colour (WCAG 2.1)."""
    parts = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
def test_text_and_marks_stand_out_from_the_ground(theme: object) -> None:
    """WCAG 2.1: 4.5 for text, 3 for marks; the two most used colours differ in lightness too, for any eye."""

    def contrast(one: str, other: str) -> float:
        low, high = sorted((luminance(one), luminance(other)))
        return (high + 0.05) / (low + 0.05)

    ground = theme.surface  # type: ignore[attr-defined]
    assert all(contrast(getattr(theme, name), ground) >= 4.5 for name in ("ink", "muted"))
    assert all(contrast(getattr(theme, name), ground) >= 3.0 for name in ("first", "second", "third", "fourth"))
    roles = [
        getattr(theme, name)
        for name in ("surface", "ink", "muted", "grid", "band", "first", "second", "third", "fourth")
    ]
    assert len(set(roles)) == len(roles)


def test_faults_of_the_command_line() -> None:
    with pytest.raises(UsageError, match=r"no figure 'corelation'; did you mean 'correlation'\?"):
        plots.check(lens(), "corelation", Path("x.svg"))
    with pytest.raises(UsageError, match="no figure 'scene'; allowed: residuals"):
        plots.check(lens(), "scene", Path("x.svg"))
    with pytest.raises(UsageError, match=r"x.jpg: the name of a figure ends in .svg, .pdf or .png"):
        plots.check(lens(), "residuals", Path("x.jpg"))


def test_the_name_of_the_worst_point_gives_way_to_its_neighbours() -> None:
    """C is the worst of the network; points are put to its right and above, then the other way round."""
    for side in (1.0, -1.0):
        net = results.network()
        points = net.tables["points"]
        columns = dict(points.columns) | {
            "x": side * np.array([150.0, 80.0, 0.0]),
            "y": side * np.array([40.0, 150.0, 0.0]),
        }
        moved = replace(net, tables={**net.tables, "points": Table(columns, points.units)})
        with plots.drawn("residuals-part", plots.data_of("residuals-part", moved)) as (canvas, _):
            (name,) = (text for axes in canvas.figure.axes for text in axes.texts if text.get_text() == "C")
            assert np.sign(name.get_position()).tolist() == [-side, -side]


def test_ellipsoids_of_many_points_have_room() -> None:
    """1000 points of a lattice with the same spread: two standard deviations are less than half their distance."""
    at = np.stack(np.meshgrid(*[np.arange(10) * 100.0] * 3), axis=-1).reshape(-1, 3)
    columns = {"point": np.array([f"P{k}" for k in range(1000)]), **dict(zip("xyz", at.T, strict=True))}
    columns |= {name: np.full(1000, 2e-3) for name in ("sx", "sy", "sz")}
    table = Table(columns, dict.fromkeys(("x", "y", "z", "sx", "sy", "sz"), "mm"))
    found = plots.data_of("scene", Result("x", "", (), np.zeros((0, 0)), {}, {"points": table}))
    assert 10.0 < 2 * 2e-3 * found.ellipsoids < 50.0


def test_cameras_stand_about_the_board() -> None:
    """One camera looks along z from 400 mm; the other sees the board turned by a right angle about y, from the side."""
    columns = {"image": np.array(["a", "b"]), "x": np.zeros(2), "y": np.array([0.0, 5.0]), "z": np.full(2, 400.0)}
    columns |= {"alpha": np.zeros(2), "beta": np.array([0.0, np.pi / 2]), "gamma": np.zeros(2)}
    table = Table(columns, dict.fromkeys("xyz", "mm") | dict.fromkeys(("alpha", "beta", "gamma"), "rad"))
    result = replace(lens(), statistics={"rig": "board"}, tables={"views": table})
    board, cameras = places_of(result)
    assert board.at.tolist() == [[0, 0, 0]] and cameras.names == ("a", "b")
    np.testing.assert_allclose(cameras.at, [[0, 0, -400], [400, -5, 0]], atol=1e-9)
    assert "scene" in plots.names_of(result)


@pytest.mark.parametrize("count", [5, 200])
def test_cameras_have_names_and_beams_to_what_they_see(count: int, tmp_path: Path) -> None:
    """Images in a row at 400 mm from a board of 2 x 3 targets; image 3 is the worst, and image 0 sees one target."""
    images, targets = [f"i{k:03d}" for k in range(count)], ["r0c0", "r0c1", "r0c2", "r1c0", "r1c1", "r1c2"]
    at = np.array([[10.0 * c, 10.0 * r, 0.0] for r in range(2) for c in range(3)])
    pairs = [(image, target) for image in images for target in targets if image != "i000" or target == "r0c1"]
    place = {"x": -np.arange(count) * 5.0, "y": 0.0, "z": 400.0, "alpha": 0.0, "beta": 0.0, "gamma": 0.0}
    columns = {
        "image": images,
        **{key: np.broadcast_to(value, count) for key, value in place.items()},
        "rms": np.where(np.arange(count) == 3, 0.4, 0.1),
    }
    tables = {
        "views": Table.of(columns),
        "targets": Table.of({"target": targets, **dict(zip("xyz", at.T, strict=True))}),
        "residuals": Table.of({name: np.repeat(texts, 2) for name, texts in zip(("image", "target"), zip(*pairs, strict=True), strict=True)}),
        "camera": Table.of({"parameter": ["f", "cx", "cy"], "value": np.array([500.0, 319.5, 239.5])}),
    }  # fmt: skip
    statistics = {"rig": "board", "convention": "forward", "image_width": 640, "image_height": 480}
    result = replace(lens(), statistics=statistics, tables=tables)
    _, cameras, beams = places_of(result)
    order = [3, 0, count - 1]
    assert list(cameras.named) == (order if count > 48 else [3, 0, 4, 1, 2])
    assert beams.faint and (beams.lines[:, :, 0] == cameras.at[:, None]).all()
    true = [beams.lines[k][(beams.lines[k, :, 0] != beams.lines[k, :, 1]).any(axis=1), 1] for k in range(count)]
    assert true[0].tolist() == [at[1].tolist()]
    assert len(true[1]) == (5 if count == 200 else 6) and {*map(tuple, true[1])} <= {*map(tuple, at)}
    plots.save(result, "scene", tmp_path / "x.svg", ".svg")
    text = (tmp_path / "x.svg").read_text(encoding="utf-8")
    assert all(f">{images[k]}<" in text for k in order) and ">beams<" in text


def test_many_points_in_space_keep_the_extent_of_the_part() -> None:
    """Of 20 000 points the vectors grow with x: the longest are all at one end, those that stay are everywhere."""
    at = RNG.random((20_000, 3)) * [1000, 500, 200]
    columns = {"point": np.array([f"P{k}" for k in range(len(at))]), **dict(zip("xyz", at.T, strict=True))}
    columns |= {"error_x": at[:, 0] * 1e-6, "error_y": np.zeros(len(at)), "error_z": np.zeros(len(at))}
    table = Table(columns, dict.fromkeys(("x", "y", "z", "error_x", "error_y", "error_z"), "mm"))
    found = plots.data_of("scene", Result("x", "", (), np.zeros((0, 0)), {}, {"points": table}))
    (kept,) = found.places
    assert len(kept.at) <= 1500 and found.left_out == 20_000 - len(kept.at)
    assert np.linalg.norm(kept.vectors, axis=1).max() == columns["error_x"].max()
    assert (np.histogramdd(kept.at, bins=(4, 4, 4))[0] > 5).all()


def test_each_of_several_cameras_has_its_own_image() -> None:
    """Cameras with images of 640 x 480 and 320 x 480 px, principal points (300, 200) and (100, 200)."""
    result = results.camera(UV % [320, 480], np.full((300, 2), 0.03))
    named = np.char.add(np.where(np.arange(600) < 200, "a", "b"), result.tables["residuals"].columns["image"])
    lens = {"camera": ["a"] * 3 + ["b"] * 3, "parameter": ["f", "cx", "cy"] * 2}
    poses = {key: [0.0, 0.0] for key in ("x", "y", "z", "alpha", "beta", "gamma")}
    tables = {
        "residuals": Table({**result.tables["residuals"].columns, "image": named}, result.tables["residuals"].units),
        "camera": Table.of({**lens, "value": np.array([500.0, 300, 200, 500, 100, 200])}),
        "cameras": Table.of(
            {
                "camera": ["a", "b"],
                "images": ["a*", "b*"],
                "image_width": [640, 320],
                "image_height": [480, 480],
                **poses,
            }
        ),
    }
    several = replace(result, tables=tables, statistics={"convention": "forward"})
    assert [(one.camera, one.counts.sum()) for one in plots.data_of("coverage", several)] == [("a", 100), ("b", 200)]
    assert [(one.readings, one.size[0]) for one in plots.data_of("residuals-image", several)] == [
        (100, 640),
        (200, 320),
    ]
    along = plots.data_of("residuals-radius", several).panels[0].covariate
    away = UV % [320, 480] - np.where(np.arange(300) < 100, 300, 100)[:, None] * [1, 0] - [0, 200]
    assert along == pytest.approx(np.hypot(*away.T))


def test_images_of_each_size_are_shown_whole() -> None:
    def grid(wide: int, high: int) -> tuple[np.ndarray, ...]:
        return np.linspace(0, wide, 5), np.linspace(0, high, 4), np.full((4, 5), 0.1)

    shown = ProjectionError((("a", *grid(1600, 1200)), ("b", *grid(1280, 960))))
    with plots.drawn("projection-error", shown) as (canvas, _):
        assert [axes.get_ylim() for axes in canvas.figure.axes[:2]] == [(1200, 0), (960, 0)]
