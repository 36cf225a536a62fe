"""Pages in a real browser: no error, no request, no text over another, the 3-D view turns, nothing serious by axe-core."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.browser_pages import BROWSER, WIDTHS, Seen, reported
from benchmarks.browser_pages import seen as opened
from metrocli.errors import UsageError
from metrocli.report import pdf

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
ENDS = (WIDTHS[0], WIDTHS[-1])
"""Widths that are opened: `python -m benchmarks browser_pages` opens the pages of all samples at all widths"""
BAD = """<html><body><p style="position:absolute;top:50px">one text</p><p style="position:absolute;top:52px">other text</p>
<img src="http://127.0.0.1:9/absent.png"><div style="width:3000px">wide</div><script>console.log("noise")</script></body></html>"""
"""A page with what the checks must see: texts over one another, a request, no text for a picture, a line on the console"""


def shortened(gear: Path) -> None:
    """Leave the first of the gear's jobs and every eighth of its places: their marks are most of the browser's work."""
    (gear / "metrocli.yaml").write_text("project: Large gear\njobs: [jobs/tip3.yaml]\n")
    for name in ("lengths", "points", "probing"):
        rows = (file := gear / f"data/{name}.csv").read_text().splitlines(keepends=True)
        file.write_text(
            "".join(row for row in rows if not (place := re.search(r"G(\d+),", row)) or int(place[1]) % 8 == 1)
        )


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Seen, Seen]:
    """The samples and the bad page, by one browser."""
    folder = tmp_path_factory.mktemp("browser")
    bad = folder / "bad.html"
    bad.write_text(BAD)
    pages = [*reported("gear-m3d3", folder, shortened), *reported("gauge-block", folder)]
    found = opened([*pages, bad], folder, ENDS)
    return found.of(str(bad), False), found.of(str(bad))


@pytest.fixture
def seen(both: tuple[Seen, Seen]) -> Seen:
    return both[0]


def test_no_page_writes_errors_or_fetches_anything(seen: Seen) -> None:
    assert not seen.console
    assert len(seen.pages) == len(ENDS) * len(seen.plain) >= len(ENDS) * 4
    assert not [one["fetched"] for one in seen.pages if one["fetched"]]


def test_no_text_lies_over_another_and_none_leaves_the_page(seen: Seen) -> None:
    assert not {(one["path"], one["width"]): one["overlaps"] for one in seen.pages if one["overlaps"]}
    assert not {(one["path"], one["width"]): one["beyond"] for one in seen.pages if one["beyond"] > 0}


def test_pages_are_not_wider_than_paper(seen: Seen) -> None:
    assert not [one for one in seen.plain if one["paper"] > 0]


def test_the_view_turns_by_the_arrow_keys(seen: Seen) -> None:
    turned = {Path(one["path"]).name: one["turns"] for one in seen.pages}
    assert turned["tip3.html"] is True


def test_axe_finds_nothing_serious(seen: Seen) -> None:
    assert all(one["rules"] > 10 for one in seen.pages)
    assert not {(one["path"], one["width"]): one["serious"] for one in seen.pages if one["serious"]}


def test_with_scripts_off_the_numbers_are_there(seen: Seen) -> None:
    (tip3,) = (one for one in seen.plain if one["path"].endswith("tip3.html"))
    assert tip3["canvases"] == 0
    assert {"LT1.x", "Least known of the points"} <= {text.partition(":")[0] for text in tip3["texts"]}
    assert any(re.fullmatch(r"-?\d+\.\d{4}", text) for text in tip3["texts"])


def test_the_checks_see_what_is_bad(both: tuple[Seen, Seen]) -> None:
    bad = both[1]
    words = "\n".join(bad.faults())
    assert all(one in words for one in ("fetches", "texts over one another", "px wider", "image-alt", "noise")), words
    assert len(bad.pages) == len(ENDS)
    for one in bad.pages:
        assert one["overlaps"] and one["beyond"] > 0 and one["fetched"] and one["serious"]
    assert any("noise" in line for line in bad.console)


def test_a_page_is_printed_as_pdf(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    printed = pdf.printed("<!DOCTYPE html><style>@page{size:A4}</style><p>" + "one line<br>" * 200)
    assert printed.startswith(b"%PDF-")
    assert re.search(rb"/MediaBox ?\[0 0 59[45][^\]]* 84[12]", printed), "A4 is 595 by 842 points"
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError, match="--pdf needs one of these browsers"):
        pdf.printed("<p>one")
