"""Figures that show a result in its context: values by hand, and files on the command line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli import plots
from metrocli.errors import UsageError
from metrocli.plots.context import LineageFile, ResultContext
from metrocli.result import Result
from metrocli.table import Table

RNG = np.random.default_rng(31)
GAIN = {"folds": [4.0, -1.0, 3.0], "log_score": 6.0, "log_score_std": 4.6}


def lengths(jump: float) -> Result:
    """200 residuals of two tracers over time, of standard deviation 1; those of T2 after 500 s are larger by `jump`."""
    rng = np.random.default_rng(32)
    w, t = rng.normal(size=200), np.repeat(np.arange(100.0) * 10, 2)
    tracer = np.tile(["T1", "T2"], 100)
    w = w + jump * ((tracer == "T2") & (t > 500))
    table = Table(
        {
            "point": np.repeat([f"P{k}" for k in range(100)], 2), "tracer": tracer, "reading": 100 + t, "t": t,
            "residual": w, "sigma": np.ones(200), "normalised": w,
        },
        {"reading": "mm", "residual": "mm", "sigma": "mm", "t": "s"},
    )  # fmt: skip
    return Result("multilaterate", "Net", (), np.zeros((0, 0)), {}, {"residuals": table})


def test_before_and_after_are_shown_where_the_change_is() -> None:
    found = plots.data_of("before-after", lengths(0.0), ResultContext(before=lengths(3.0)))
    assert (found.about, found.place) == ("time", "tracer T2")
    # 49 times after 500 s, 100 readings of T2: the others are the same before and after
    assert found.before.w - found.after.w == pytest.approx(np.where(found.after.covariate > 500, 3.0, 0.0))
    assert found.after.covariate.tolist() == (np.arange(100.0) * 10).tolist()
    w = lengths(0.0).tables["residuals"].numbers("normalised")
    assert found.rms[1] == pytest.approx(np.sqrt((w**2).mean())) and found.rms[0] > 1.4 and found.readings == 200
    assert len(found.before.trend.beyond) >= 9 and not len(found.after.trend.beyond)


def test_results_of_other_readings_are_not_set_side_by_side() -> None:
    table = lengths(0.0).tables["residuals"]
    other = table.numbers("reading") + np.eye(1, 200, 7)[0] * 1e-4
    changed = replace(table, columns={**table.columns, "reading": other})
    fewer = replace(table, columns={name: values[:-1] for name, values in table.columns.items()})
    for one in (changed, fewer):
        held = replace(lengths(0.0), tables={"residuals": one})
        assert plots.data_of("before-after", held, ResultContext(before=lengths(3.0))) is None
    with pytest.raises(UsageError, match="needs the result of the job without the extension, with the same readings"):
        plots.check(lengths(0.0), "before-after", Path("x.svg"))


def diagnosis(**more: Any) -> Mapping[str, Any]:
    effect = {"name": "jump", "where": {"tracer": "T2"}, "gain": GAIN}
    law = {
        "acts_on": "length", "where": {"tracer": "T1"}, "adds": "a1*t", "chosen": True, "gain": {**GAIN, "folds": [9.0]},
        "data": {
            "variable": "t", "variable_unit": "s", "unit": "um",
            "x": [2.0, 0.0, 1.0], "law": [4.0, 0.0, 2.0], "residual": [4.5, -0.5, 2.5],
        },
    }  # fmt: skip
    return {"effects": [effect], "laws": [{**law, "chosen": False}, law], "together": None, **more}


def test_gains_by_part_are_largest_first_and_add_up() -> None:
    found = plots.data_of("held-out", lengths(0.0), ResultContext(diagnosis=diagnosis()))
    assert [(one.name, one.total) for one in found.gains] == [("law a1*t T1", 9.0), ("jump T2", 6.0)]
    assert found.gains[1].folds.tolist() == GAIN["folds"] and found.findings == 2
    many = [{"name": f"e{k}", "where": {}, "gain": {**GAIN, "folds": [float(k)]}} for k in range(7)]
    found = plots.data_of(
        "held-out", lengths(0.0), ResultContext(diagnosis={"effects": many, "together": {**GAIN, "folds": [21.0]}})
    )
    assert [one.name for one in found.gains] == ["all of them together", "e6", "e5", "e4"] and found.findings == 8
    assert plots.data_of("held-out", lengths(0.0), ResultContext(diagnosis={"effects": []})) is None


def test_a_law_is_drawn_in_the_order_of_its_variable() -> None:
    found = plots.data_of("law", lengths(0.0), ResultContext(diagnosis=diagnosis()))
    assert found.text == "a1*t, added to length T1" and found.variable == "t (s)"
    assert [one.tolist() for one in (found.x, found.law, found.residual)] == [[0, 1, 2], [0, 2, 4], [-0.5, 2.5, 4.5]]
    assert found.scatter == pytest.approx((np.sqrt((0.25 + 6.25 + 20.25) / 3), 0.5))
    assert plots.data_of("law", lengths(0.0), ResultContext(diagnosis=diagnosis(laws=[]))) is None


NODES = (
    LineageFile("results/part.h5", "align-part", True, ("results/camera.h5", "points.csv", "img/*.png (9 files)")),
    LineageFile("results/camera.h5", "calibrate-camera", True, ("img/*.png (9 files)",)),
    LineageFile("points.csv", "", False, ()),
    LineageFile("img/*.png (9 files)", "", True, ()),
)


def test_the_lineage_leads_from_left_to_right() -> None:
    place = plots.data_of("lineage", lengths(0.0), ResultContext(lineage=NODES)).place
    assert place["results/part.h5"] == (2, 0) and place["img/*.png (9 files)"] == (0, 0)
    assert {place["results/camera.h5"], place["points.csv"]} == {(1, 0), (1, 1)}
    for one in NODES:
        assert all(place[need][0] < place[one.name][0] for need in one.needs)
    assert plots.data_of("lineage", lengths(0.0), ResultContext(lineage=NODES[:1])) is None


@pytest.mark.alike
@pytest.mark.parametrize(
    ("name", "context", "words"),
    [
        ("before-after", ResultContext(before=lengths(3.0)), ["of tracer T2, which changed most", "w (standard deviations)", "time (s)"]),
        ("held-out", ResultContext(diagnosis=diagnosis()), ["jump T2: +6.0 ± 4.6 (standard deviation) in all", "below two standard deviations", "better in 2 of 3 parts"]),
        ("law", ResultContext(diagnosis=diagnosis()), ["t (s)", "law and residual (µm)", "A law is not a cause."]),
        ("lineage", ResultContext(lineage=NODES), ["camera.h5", "calibrate-camera", "not fit for use (orange): points.csv."]),
    ],
)  # fmt: skip
def test_the_figures_state_what_they_show(name: str, context: ResultContext, words: list[str], tmp_path: Path) -> None:
    from xml.etree import ElementTree as ET

    plots.save(lengths(0.0), name, tmp_path / "x.svg", ".svg", context=context)
    root = ET.fromstring((tmp_path / "x.svg").read_text(encoding="utf-8"))
    text = " ".join("".join(node.itertext()) for node in root.iter() if node.tag.endswith("text"))
    assert all(one in " ".join(text.split()) for one in (plots.title_of(name), *words)), text


def test_on_the_command_line(job: Path, metrocli) -> None:  # type: ignore[no-untyped-def]
    """The extended result finds the earlier one by its name; a diagnosis of another job is refused where it is named."""
    metrocli("straight-line", job)
    Path("results/line.extended.h5").write_bytes(Path("results/line.h5").read_bytes())
    assert "before-after" in metrocli("plot", "results/line.extended.h5").out
    assert "before-after" not in metrocli("plot", "results/line.h5").out
    assert "before-after" in metrocli("plot", "results/line.h5", "--before", "results/line.extended.h5").out
    assert metrocli("plot", "results/line.h5", "lineage").out == "results/line.lineage.svg\n"
    Path("d.json").write_text(json.dumps({"verdict": "clean", "of": {}}))
    ran = metrocli("plot", "results/line.h5", "--diagnosis", "d.json")
    assert ran.code == 3 and "d.json" in ran.err and "diagnosis of another job" in ran.err
    assert metrocli("plot", "results/line.h5", "--before", "absent.h5").code == 3
