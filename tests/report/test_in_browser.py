"""Pages in a real browser: no error, no request, no text over another, the 3-D view turns, nothing serious by axe-core."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from metrocli.cli.commands import run
from metrocli.errors import UsageError
from metrocli.report import pdf

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium is installed")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--allow-file-access-from-files", "--disable-web-security",
    "--enable-logging=stderr", "--remote-debugging-port=0",
)  # fmt: skip
WIDTHS = (360, 794, 1280)
"""Telephone, A4 at 96 points an inch, and desk"""
SAMPLES = ("gear-m3d3", "gauge-block")
BAD = """<html><body><p style="position:absolute;top:50px">one text</p><p style="position:absolute;top:52px">other text</p>
<img src="http://127.0.0.1:9/absent.png"><div style="width:3000px">wide</div><script>console.log("noise")</script></body></html>"""
"""A page with what the checks must see: texts over one another, a request, no text for a picture, a line on the console"""


@dataclass(frozen=True)
class Seen:
    """What the browser reports of all pages of some sample projects, or of the bad page."""

    pages: list[dict[str, Any]]
    """One for each page and width"""
    plain: list[dict[str, Any]]
    """One for each page with scripts off"""
    console: list[str]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Seen, Seen]:
    """The samples and the bad page, by one browser."""
    folder = tmp_path_factory.mktemp("browser")
    for sample in SAMPLES:
        assert run(["init", str(folder / sample), "--sample", sample]) == 0
        assert run(["run", str(folder / sample), "--quiet"]) == 0
        assert run(["report", str(folder / sample), "--quiet"]) == 0
    paths = [str(path) for sample in SAMPLES for path in sorted((folder / sample / "report").glob("*.html"))]
    bad = folder / "bad.html"
    bad.write_text(BAD)
    paths.append(str(bad))
    axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    checks = (Path(__file__).parent / "browser_checks.js").read_text(encoding="utf-8")
    given = ", ".join(json.dumps(one).replace("</", "<\\/") for one in (paths, WIDTHS, axe))
    wrapper = folder / "wrapper.html"
    wrapper.write_text(f"<body><script>{checks}\nreported({given});</script></body>")
    console, found = _console(wrapper, folder / "profile")
    return _of(found, console, str(bad), False), _of(found, console, str(bad), True)


def _of(found: dict[str, Any], console: list[str], path: str, wanted: bool) -> Seen:
    pages, plain = ([one for one in found[key] if (one["path"] == path) is wanted] for key in ("pages", "plain"))
    return Seen(pages, plain, [line for line in console if (path in line) is wanted])


@pytest.fixture
def seen(both: tuple[Seen, Seen]) -> Seen:
    return both[0]


def _console(wrapper: Path, profile: Path) -> tuple[list[str], dict[str, Any]]:
    """Return what pages write to the console, and the report of the checks; the browser lives until it comes."""
    command = [str(BROWSER), *QUIET, f"--user-data-dir={profile}", wrapper.as_uri()]
    lines = list[str]()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as browser:
        assert browser.stderr is not None
        try:
            for line in browser.stderr:
                if (found := re.search(r"REPORT(.*)END", line)) is not None:
                    return lines, json.loads(found[1])
                assert "Uncaught (in promise)" not in line, line
                # scripts are blocked where they are switched off, and srcdoc is the copy that axe judges
                if "CONSOLE" in line and not re.search("Blocked script execution|about:srcdoc", line):
                    lines.append(line)
        finally:
            browser.kill()
    raise AssertionError(f"the browser ended: {lines}")


def test_no_page_writes_errors_or_fetches_anything(seen: Seen) -> None:
    assert not seen.console
    assert len(seen.pages) == len(WIDTHS) * len(seen.plain) >= len(WIDTHS) * 4
    assert not [one["fetched"] for one in seen.pages if one["fetched"]]


def test_no_text_lies_over_another_and_none_leaves_the_page(seen: Seen) -> None:
    assert not {(one["path"], one["width"]): one["overlaps"] for one in seen.pages if one["overlaps"]}
    assert not {(one["path"], one["width"]): one["beyond"] for one in seen.pages if one["beyond"] > 0}


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
    assert len(bad.pages) == len(WIDTHS)
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
