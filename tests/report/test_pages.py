"""Pages of results and projects: what they hold, that files cannot inject anything, that nothing is fetched."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plots import results

from metrocli.cli.console import Console
from metrocli.record import CriterionVerdict, InputFile, Record
from metrocli.report.findings import worst
from metrocli.report.html import Content, PrintedDiagnosis
from metrocli.report.html import listed as list_of
from metrocli.report.project_page import JobEntry, project_page, ranks
from metrocli.report.result_page import result_page
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.words import listed

Metrocli = Callable[..., Any]
EVIL = "<script>alert('x')</script>&\"quoted\""
RECORD = Record(
    "metrocli: 1\njob: x\n", (InputFile("a.csv", "ab" * 32, 123),), "0.1.0", "2026-11-20T10:00:00Z",
    (CriterionVerdict("sigma0", "< 1.5", 1.0, "", True),),
)  # fmt: skip
VOID = {"meta", "img", "br", "hr", "link", "input", "source"}


class Page(HTMLParser):
    """Elements with their attributes, the text that is shown, and faults of nesting."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    def named(self, tag: str) -> list[dict[str, str | None]]:
        return [held for name, held in self.elements if name == tag]


pytestmark = pytest.mark.usefixtures("each_figure_once")


def page_of(result: Result, **more: Any) -> Page:
    return Page(result_page(Content(result, more.pop("record", RECORD), "r.h5", **more)))


def lens() -> Result:
    rng = np.random.default_rng(891)
    return results.camera(rng.random((400, 2)) * [640, 480], rng.normal(size=(400, 2)) * 0.1)


def without_figures() -> Result:
    return replace(lens(), tables={})


@pytest.mark.parametrize(
    "result",
    [
        results.network(),
        results.budget(),
        *(pytest.param(r, marks=pytest.mark.slow) for r in (lens(), results.machine())),
    ],
    ids=lambda r: r.kind,
)
def test_a_page_fetches_nothing_and_is_well_formed(result: Result) -> None:
    text = result_page(Content(result, RECORD, "r.h5"))
    page = Page(text)
    for name, held in page.elements:
        for key in ("src", "href", "xlink:href", "data", "action", "poster", "srcset"):
            link = held.get(key) or "#"
            assert link.startswith(("#", "data:image/png;base64,")), (name, link)
        assert not any(key.startswith("on") for key in held), held
    policy = next(held["content"] or "" for held in page.named("meta") if held.get("http-equiv"))
    assert policy.startswith("default-src 'none'; img-src data:;") and "http" not in policy
    assert "@import" not in text and "url(http" not in text
    ids = Counter(held["id"] for _, held in page.elements if held.get("id"))
    assert not [name for name, count in ids.items() if count > 1]
    used = set(re.findall(r"url\(#([^)]*)\)", text)) | {held["xlink:href"][1:] for held in page.named("use")}
    assert used <= set(ids)
    assert len(text) < 1_500_000 and "\u2028" not in text


@pytest.mark.slow
def test_the_script_is_the_one_that_the_policy_allows() -> None:
    import base64
    import hashlib

    text = result_page(Content(results.network(), RECORD, "r.h5"))
    code = text.rpartition("<script>")[2].partition("</script>")[0]
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text and "data-scene" in code
    without = result_page(Content(results.budget(), RECORD, "r.h5"))
    assert "<script" not in without and "script-src 'none'" in without


def test_first_comes_what_decides() -> None:
    """Without any script: verdict, next step, estimates with U, the worst reading, diagnosis, acceptance; then figures."""
    text = page_of(results.network()).text
    order = [
        text.index(one)
        for one in (
            "Net",
            "Done.",
            "Next:",
            "L1.x",
            "Worst",
            "Diagnosis",
            "Acceptance",
            "Figures",
            "Traceability",
            "Provenance",
        )
    ]
    assert order == sorted(order)
    assert "L1.x -100.000 0.020 mm" in text  # U = 2 x 0.010, two digits
    assert "Reading C/L2: |w| = 4" in text
    assert "required sigma0 < 1.5: met (1)" in text
    assert "ab" * 32 in text


def test_what_the_diagnosis_added_stands_first() -> None:
    """Not behind the coordinates of all stations, of which the first screen has a part."""
    stations = [Estimate(f"LT{n}.x", float(n), 0.1, "mm") for n in range(20)]
    found = Estimate("dead-path-jump.LT2.step", 1.5e-3, 1e-4, "mm", "length")
    result = Result("multilaterate", "", (*stations, found), np.eye(21), {}, {})
    parameters = Table({"parameter": np.array(["step"]), "value": np.array([1.5e-3])})
    first = [page_of(one).text.index(found.name) < page_of(one).text.index("LT0.x") for one in (
        replace(result, tables={"effects/dead-path-jump.LT2/parameters": parameters}), result
    )]  # fmt: skip
    assert first == [True, False]


def test_u_is_that_of_the_result_where_it_states_one() -> None:
    text = page_of(results.budget()).text
    assert "U (k = 2)" in text and "50.00050 0.00020 mm" in text


def test_each_estimate_has_its_k_where_they_differ() -> None:
    held = results.budget()
    text = page_of(replace(held, details={"l": {"U": 2.9e-4, "k": 2.9}}, estimates=(*held.estimates, Estimate("b", 1.0, 0.1, "mm")),
                           covariance=np.diag([1e-8, 0.01]))).text  # fmt: skip
    assert "U unit k l 50.00050 0.00029 mm 2.9 b 1.00 0.20 mm 2" in text


def test_what_was_measured_stands_below_the_title() -> None:
    record = replace(RECORD, certificate={"item": {"name": "Step gauge", "serial": "S 17"}})
    held = replace(results.network(), statistics={"observations": 6, "unknowns": 3})
    text = page_of(held, record=record).text
    assert "Net Step gauge · S 17 · 6 observations, 3 unknowns · r.h5 · 2026-11-20 Done." in text


def test_numbers_of_figures_keep_their_digits() -> None:
    """A scale of 0.002 px is not shortened as the coordinates of lines are."""
    uv = np.random.default_rng(892).random((40, 2)) * [640, 480]
    text = page_of(results.camera(uv, np.full((40, 2), 0.0018), 0.001)).text
    assert "0.002 px (vectors" in text and "0.00 px" not in text


def test_figures_without_room_are_named_with_their_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metrocli.report.pictures.MOST", 1)
    text = page_of(results.machine()).text
    assert (
        "Errors of a machine over its axes (actual minus commanded): this page has no room; metrocli plot r.h5" in text
    )


def test_marks_of_one_look_state_it_once() -> None:
    text = result_page(Content(lens(), RECORD, "r.h5"))
    drawn = re.search("<svg.*?</svg>", text.partition('id="figure-residuals"')[2], re.DOTALL)
    assert drawn is not None
    marks = [one for one in ET.fromstring(drawn[0]).iter() if one.tag == "use"]
    assert len(marks) > 700 and sum("style" in one.attrib for one in marks) < 20, "ticks are marks, too"


def test_points_that_are_given_are_not_the_worst_known() -> None:
    net = results.network()
    points = net.tables["points"]
    exact = {name: np.zeros(3) for name in ("sx", "sy", "sz", "error_x", "error_y", "error_z")}
    text = page_of(
        replace(net, tables={**net.tables, "points": replace(points, columns={**points.columns, **exact})})
    ).text
    assert "Least known" not in text and "Largest error" not in text and "Vectors:" not in text


def test_the_least_overstock_is_named() -> None:
    assert (
        "Least overstock: (0.600 ± 0.040) mm (k = 2) at P9 of top; the minimum is 0.5 mm."
        in page_of(results.raw_part()).text
    )


@pytest.mark.slow
def test_notes_are_broken_into_lines_and_their_tables_are_not() -> None:
    text = result_page(Content(replace(lens(), notes=("a sentence", "x  y\n1  2")), RECORD, "r.h5"))
    assert '<div class="notes"><p>a sentence</p><pre tabindex="0">x  y\n1  2</pre></div>' in text


def test_a_doubtful_result_cannot_be_overlooked() -> None:
    page = page_of(without_figures(), record=replace(RECORD, doubts=("sigma0 = 7",)))
    assert "Doubtful: do not use this result. sigma0 = 7" in page.text
    assert {"class": "verdict bad"} in page.named("div")
    assert {"class": "verdict good"} in page_of(without_figures()).named("div")
    warned = page_of(replace(without_figures(), warnings=("correlations",)))
    assert {"class": "verdict warned"} in warned.named("div") and "Done, with 1 warning." in warned.text
    unmet = replace(RECORD, verdicts=(CriterionVerdict("sigma0", "< 0.5", 1.0, "", False),))
    assert "does not meet its requirements" in page_of(without_figures(), record=unmet).text


def test_what_comes_from_files_is_escaped() -> None:
    result = replace(
        results.network(), title=EVIL, warnings=(EVIL,), notes=(EVIL,),
        estimates=(Estimate(EVIL, 1.0, 0.1, "mm"), Estimate("b", 1.0, 0.1, "mm")), covariance=np.diag([0.01, 0.01]),
    )  # fmt: skip
    table = result.tables["points"]
    names = np.array(["A</script><script>alert(1)</script>", "B", "C"])
    result = replace(
        result, tables={**result.tables, "points": replace(table, columns={**table.columns, "point": names})}
    )
    record = replace(RECORD, job_text=EVIL, inputs=(InputFile(EVIL, EVIL, 1),), doubts=(EVIL,), created=EVIL)
    diagnosis = PrintedDiagnosis(
        {"verdict": EVIL, "effects": [{"name": EVIL, "where": {"a": EVIL}, "parameters": {}}]}, EVIL, True
    )
    held = Content(result, record, EVIL, {"views": EVIL}, diagnosis, EVIL)
    text = result_page(held)
    page = Page(text)
    assert len(page.named("script")) == 2 and "<script>alert" not in text
    assert page.text.count("alert('x')") >= 10
    data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    assert data["names"][0][2] == "A</script><…(1)</script>"


def test_the_view_that_turns_has_true_sizes() -> None:
    text = result_page(Content(results.network(), RECORD, "r.h5"))
    data = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    points = data["kinds"][0]
    assert points["vectors"][1] == [0.003, 0.004, 0.0] and data["vectors"] == 5000.0
    # half axes of two standard deviations: 2, 4 and 6 um
    assert np.sqrt(np.diag(points["covariance"][0])) == pytest.approx([0.002, 0.004, 0.006])
    assert np.subtract(points["at"][1], points["at"][0]).tolist() == [100.0, 0.0, 0.0]


def test_figures_follow_the_theme_of_the_page() -> None:
    from metrocli.plots.style import LIGHT

    text = result_page(Content(results.machine(), RECORD, "r.h5"))
    head, _, body = text.partition("</head>")
    assert "prefers-color-scheme:dark" in head and "@media print" in head and "size:A4" in head
    assert "var(--ink)" in body and LIGHT.ink not in body and LIGHT.first not in body


def test_traceability() -> None:
    text = page_of(without_figures()).text
    assert "The result rests on a.csv, whose digest is below." in text
    assert "Certificate numbers of references are not recorded" in text
    stated = replace(RECORD, certificate={"references": {"a.csv": "PTB-1"}})
    text = Page(result_page(Content(without_figures(), stated, "r.h5"))).text
    assert "a.csv: certificate PTB-1" in text and "not recorded" not in text


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"verdict": "explained", "effects": [{"name": "jump", "where": {"t": "LT2"}, "parameters": {"step": {"value": 0.0016, "std": 0.0001, "unit": "mm"}}}], "extended_job": "x.extended.yaml"}, ["model is not complete: the diagnosis names what is missing", "jump LT2: step = 1.60 ± 0.10 µm", "Run the job with what was found", "metrocli calibrate-camera x.extended.yaml"]),
        ({"verdict": "clean", "outliers": [{"observation": {"p": "P1", "t": "LT1"}, "w": 6.5, "or": [{"p": "P1", "t": "LT2"}]}] * 7}, ["the diagnosis lists 7 wrong readings", "Wrong reading: P1/LT1 (w = 6.5; or instead P1/LT2)", "and 2 more wrong readings", "Check the wrong readings"]),
        ({"verdict": "unexplained", "unexplained": {"depends_on": ["t", "angle"], "where": ["LT2"], "size": {"value": 0.55, "unit": "um"}}, "processes": [{"depends_on": "time", "of_each": "tracer", "std": {"value": 0.21, "unit": "um"}}]}, ["finds structure, or noise, without a known cause", "Verdict: unexplained: structure, or noise, is left", "varies with t and angle in the readings of LT2, 0.55 µm", "smoothly with time of each tracer by itself: 0.21 µm"]),
        ({"verdict": "mistaken", "mistake": {"file": "points", "what": "is in inches", "write": "unit: mm"}, "extended_job": "x.extended.yaml"}, ["one of its files is wrong", "Mistake in points: is in inches; write: unit: mm", "Correct the mistake"]),
        ({"verdict": "clean"}, ["Verdict: clean: the residuals are what noise produces.", "Use or export the result."]),
        ({"verdict": "clean", "noise": {"as_declared": False, "ratio": 5.4}}, ["the noise is 5.4 times what was declared.", "Noise: 5.4 times", "Declare the noise"]),
        ({"verdict": "clean", "interrupted": True}, ["the diagnosis was interrupted.", "The search was interrupted; it may have missed causes.", "--limit 600s"]),
        ({"verdict": "not-decided", "quick": True}, ["Done, but its diagnosis is a quick one", "The search was a quick one; it may have missed causes.", "Diagnose with more time"]),
        ({"verdict": "clean", "limited": 2.0}, ["the diagnosis ended at its limit of 2 s.", "The search ended at its limit of 2 s; it may", "--limit 600s"]),
        ({"verdict": "indistinct", "effects": [{"name": "a", "where": {}, "parameters": {}, "alternatives": [{"name": "b", "where": {"t": "L1"}}]}], "separate_by": ["again"]}, ["several causes that fit alike", "a: or instead b L1", "To tell the causes apart, measure: again"]),
    ],
)  # fmt: skip
def test_the_diagnosis_decides_what_is_next(data: dict[str, Any], words: list[str]) -> None:
    text = page_of(without_figures(), diagnosis=PrintedDiagnosis(data, "d.json", True)).text
    assert all(one in text for one in words), text[:900]
    other = page_of(without_figures(), diagnosis=PrintedDiagnosis(data, "d.json", False)).text
    assert "d.json is the diagnosis of another job, or of other inputs" in other and words[0] not in other


@pytest.mark.slow
def test_without_a_diagnosis_of_its_own_a_diagnosis_is_next() -> None:
    text = page_of(lens(), diagnosis=PrintedDiagnosis({"verdict": "clean"}, "d.json", False)).text
    assert "Next: Check the model by metrocli diagnose" in text


ENTRIES = (
    JobEntry("jobs/a.yaml", "calibrate-camera", "Lens", "done", "", (), ("obs.csv",), "a.html"),
    JobEntry(
        "jobs/b.yaml",
        "align-part",
        EVIL,
        "done",
        "input obs.csv changed",
        ("jobs/a.yaml",),
        ("obs.csv", "p.csv"),
        "b.html",
    ),
    JobEntry(
        "jobs/c.yaml", "report-uncertainty", "U", "", "there is no result yet", ("jobs/a.yaml", "jobs/b.yaml"), (), ""
    ),
)


def test_the_page_of_a_project() -> None:
    page = Page(project_page("House", ENTRIES))
    assert "2 of 3 results are not up to date. Bring" in page.text and "fit for use" not in page.text
    assert "not up to date: input obs.csv changed" in page.text
    assert [held["href"] for held in page.named("a")] == ["a.html", "b.html"]
    assert "jobs/b.yaml takes jobs/a.yaml, obs.csv, p.csv" in page.text and not page.named("script")
    assert ranks(ENTRIES) == {"jobs/a.yaml": 1, "jobs/b.yaml": 2, "jobs/c.yaml": 3}
    assert len(page.named("rect")) == 5 and len(page.named("path")) == 6
    doubtful = replace(ENTRIES[0], status="doubtful")
    page = Page(project_page("House", [doubtful]))
    assert "1 of 1 results is not fit for use." in page.text and "up to date." not in page.text
    assert "stroke:var(--second)" in (page.named("rect")[-1]["style"] or "")
    page = Page(project_page("House", ENTRIES[:1]))
    assert "All results are up to date and done." in page.text and "needs" not in page.text
    assert "All results" in Page(project_page("House", [replace(ENTRIES[0], verdict="clean")])).text
    page = Page(project_page("House", [replace(ENTRIES[0], verdict="explained")]))
    assert "1 of 1 results is not complete in its model, by its diagnosis." in page.text
    assert "up to date, done; diagnosis: explained" in page.text


def test_the_command(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    assert metrocli("report", "results/line.h5").out == "results/line.html\n"
    text = Page(Path("results/line.html").read_text(encoding="utf-8")).text
    assert "Not diagnosed yet: metrocli diagnose line.yaml, then" in " ".join(text.split()).replace(" ,", ",")
    assert "slope" in text
    Path("results/line.diagnosis.json").write_text('{"verdict": "clean", "of": {}}')
    assert metrocli("report", "results/line.h5", "--out", "x.html").out == "x.html\n"
    assert "diagnosis of another job" in Page(Path("x.html").read_text(encoding="utf-8")).text
    Path("results/line.diagnosis.json").write_text("verdict: clean")
    ran = metrocli("report", "results/line.h5")
    assert ran.code == 3 and "not the output of metrocli diagnose --json" in ran.err


def test_the_command_for_a_project(job: Path, metrocli: Metrocli) -> None:
    Path("metrocli.yaml").write_text("project: Lines\njobs: [line.yaml]\n")
    assert metrocli("report", ".").out == "report/index.html\n"
    assert "there is no result yet" in Page(Path("report/index.html").read_text(encoding="utf-8")).text
    metrocli("run", ".")
    assert metrocli("report", ".").out == "report/index.html\nreport/line.html\n"
    page = Page(Path("report/index.html").read_text(encoding="utf-8"))
    assert "Lines" in page.text and page.named("a")[0]["href"] == "line.html"
    assert metrocli("report", ".", "--diagnosis", "x.json").code == 2


def test_pages_of_a_project_are_counted_while_they_are_made(
    job: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, int | None]] = []
    monkeypatch.setattr(Console, "count", lambda console, done, of: told.append((done, of)))
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n", encoding="utf-8")
    assert metrocli("run").code == 0 and metrocli("report", ".").code == 0
    assert told[-1] == (0, 1)


def test_results_of_one_name_and_damaged_ones(job: Path, metrocli: Metrocli) -> None:
    """Two results of one name have a page each; a damaged result has none, and the project's page names the reason."""
    for n in "abc":
        Path(f"{n}.yaml").write_text(job.read_text() + f"output: {n}/line.h5\n")
    Path("metrocli.yaml").write_text("jobs: [a.yaml, b.yaml, c.yaml]\n")
    metrocli("run", ".")
    Path("c/line.h5").write_bytes(b"damaged")
    ran = metrocli("report", ".")
    assert (ran.code, ran.out.split()) == (0, ["report/index.html", "report/a-line.html", "report/b-line.html"])
    page = Page(Path("report/index.html").read_text(encoding="utf-8"))
    assert [held["href"] for held in page.named("a")] == ["a-line.html", "b-line.html"]
    assert (
        "1 of 3 results is not up to date" in page.text
        and "the file exists and is not a result of metrocli" in page.text
    )


def test_a_result_without_readings_is_not_diagnosed() -> None:
    text = page_of(results.budget()).text
    assert "Nothing to diagnose: no readings are adjusted." in text and "metrocli diagnose" not in text


def test_readings_that_check_each_other_only_are_all_named() -> None:
    net = results.network()
    table = net.tables["residuals"]
    w = np.where(np.arange(len(table)) % 3 == 0, -5.0, 1.0)
    rows = [f"{p}/{t}" for p, t in zip(table.texts("point"), table.texts("tracer"), strict=True)][::3]
    changed = replace(table, columns={**table.columns, "normalised": w})
    text = page_of(replace(net, tables={**net.tables, "residuals": changed})).text
    assert f"Readings {listed(rows, 4)}: |w| = 5.00 standard deviations each, so none can be singled out" in text


def test_what_is_to_be_typed_is_marked() -> None:
    assert list_of(["write `noise: {a: 1}` & run", "x"]) == (
        "<ul><li>write <code><span>noise:</span> <span>{a:</span> <span>1}</span></code> &amp; run</li><li>x</li></ul>"
    )


def test_the_worst_place_of_a_volume_and_the_largest_contributor_are_named() -> None:
    table = Table(
        {"x": np.array([0.0, 5.0]), "y": np.zeros(2), "z": np.ones(2)}
        | dict.fromkeys(("u_x", "u_y", "u_z"), np.array([0.001, 0.02])),
        {},
    )
    found = list(worst(replace(results.budget(), tables={**results.budget().tables, "map": table})))
    assert "Least known of the volume: (5, 0, 1) mm, 69 µm in space (k = 2)." in found
    assert any(line.startswith("Largest contributor to ") and line.endswith(" % of the variance.") for line in found)


def test_what_is_to_be_typed_is_marked_in_doubts_too() -> None:
    page = page_of(
        without_figures(), record=replace(RECORD, doubts=('sigma0 = 9; `require: {sigma0: "< 10"}` allows it',))
    )
    assert "`" not in page.text


@pytest.mark.slow
def test_figures_of_pixels_have_the_theme_of_the_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metrocli.report.pictures.LARGEST", 0)
    page = page_of(results.network())
    dark, light = page.named("source"), page.named("img")
    assert len(dark) + 1 == len(light) == len(page.named("figure")) > 3  # the view that turns has its own colours
    assert {one["media"] for one in dark} == {"screen and (prefers-color-scheme:dark)"}
    links = [str(one["srcset"]) for one in dark] + [str(one["src"]) for one in light]
    assert len(set(links)) == len(links) and all(link.startswith("data:image/png;base64,") for link in links)


@pytest.mark.slow
def test_the_worst_reading_is_tested_as_on_the_terminal(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    """A declared noise that is too small makes all |w| large: those of a result are relative to the other readings."""
    assert metrocli("init", tmp_path / "p", "--sample", "laboratory-effects").code == 0
    result, page = tmp_path / "hall.h5", tmp_path / "hall.html"
    ran = metrocli("multilaterate", tmp_path / "p/jobs/hall.yaml", "--output", result)
    assert "P15 (w = 4.1: LT1 or LT5)" in ran.err
    assert metrocli("report", result, "--out", page).code == 0
    assert "Reading P15/LT1: |w| = 4.10 standard deviations" in page.read_text()


def test_w_of_the_worst_reading_is_that_of_the_suspects() -> None:
    """The tests of the terminal count the components of a reading, and Student's t of few others; the page takes them."""
    result = results.network()
    suspects = Table.of({"point [text]": ["P1"], "w": [5.62]})
    assert "|w| = 5.62 standard" in page_of(replace(result, tables={**result.tables, "suspects": suspects})).text
    alone = page_of(replace(result, tables={"suspects": suspects})).text
    assert "Worst: P1, |w| = 5.62 standard deviations, beyond the outlier bound." in alone


def test_w_is_relative_to_an_estimated_noise() -> None:
    """sigma0 and chi2 of estimated noise have its unit, which w has not."""
    result, w = lens(), float(np.nanmax(np.abs(lens().tables["residuals"].numbers("normalised"))))
    estimated = {"noise_estimated": True, "noise": 0.1, "sigma0": 0.1, "dof": 700, "chi2": 7.0}
    text = page_of(replace(result, statistics={**result.statistics, **estimated})).text
    assert f"|w| = {w / math.sqrt((700 - w**2) / 699):.2f} standard" in text


def test_panels_side_by_side_can_stand_below_each_other() -> None:
    """Each column of a figure of two cameras is an image of its own, whose parts together are the whole figure."""
    camera = results.camera(np.random.default_rng(4).random((40, 2)) * [640, 480], np.full((40, 2), 0.03))
    table = camera.tables["residuals"]
    images = np.char.add(np.where(np.arange(80) < 40, "a", "b"), table.columns["image"])
    zeros = {key: [0.0, 0.0] for key in ("x", "y", "z", "alpha", "beta", "gamma")}
    size = {"image_width": [640, 640], "image_height": [480, 480]}
    lens = {"camera": ["a"] * 3 + ["b"] * 3, "parameter": ["f", "cx", "cy"] * 2}
    several = replace(
        camera,
        statistics={**camera.statistics, "convention": "forward"},
        tables={
            "residuals": Table({**table.columns, "image": images}, table.units),
            "camera": Table.of({**lens, "value": np.array([500.0, 300, 200, 500, 300, 200])}),
            "cameras": Table.of({"camera": ["a", "b"], "images": ["a*", "b*"], **size, **zeros}),
        },
    )
    shown = result_page(Content(several, RECORD, "r.h5")).partition('id="figure-residuals-image"')[2]
    columns = re.search('<div class="columns">(.*?)</div>', shown, re.DOTALL)
    assert columns is not None
    (left, wide, _), (start, rest, _) = (
        tuple(map(float, box)) for box in re.findall(r'<svg viewBox="(\S+) 0 (\S+) (\S+)"', columns[1])
    )
    assert left == 0 and start == pytest.approx(wide, abs=0.11) and wide + rest == pytest.approx(460.8, abs=0.11)
    texts = {text: "u (px)" in text for text in re.findall("<svg.*?</svg>", columns[1], re.DOTALL)}
    assert list(texts.values()) == [True, False]
