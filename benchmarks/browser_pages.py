"""Pages of all sample projects in headless Chromium: what a reader would stumble over, at three widths.

No line on the console, no request, no text over another, beyond the page or too small to read, 3-D views that turn,
numbers with scripts off, nothing serious by axe-core. With folders, their pages are opened instead:

    python -m benchmarks browser_pages
    python -m benchmarks browser_pages build/site
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from metrocli.cli.commands import run

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
SAMPLES = Path(__file__).parents[1] / "sample_projects"
WIDTHS = (360, 794, 1280)
"""Telephone, A4 at 96 points an inch, and desk"""
_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--allow-file-access-from-files", "--disable-web-security",
    "--enable-logging=stderr", "--remote-debugging-port=0",
)  # fmt: skip


@dataclass(frozen=True)
class Seen:
    """What the browser reports of some pages."""

    pages: list[dict[str, Any]]
    """One for each page and width"""
    plain: list[dict[str, Any]]
    """One for each page: with scripts off, and on paper"""
    console: list[str]

    def of(self, path: str, wanted: bool = True) -> Seen:
        """Return what is reported of one page, or of all but that."""
        pages, plain = ([one for one in some if (one["path"] == path) is wanted] for some in (self.pages, self.plain))
        return Seen(pages, plain, [line for line in self.console if (path in line) is wanted])

    def faults(self) -> Iterator[str]:
        """Yield each fault of a page, with the page and its width."""
        yield from self.console
        for one in self.pages:
            at = f"{one['path']} at {one['width']} px"
            yield from (f"{at}: fetches {name}" for name in one["fetched"])
            yield from (f"{at}: texts over one another: {texts}" for texts in one["overlaps"])
            yield from (f"{at}: letters too small to read: {text}" for text in one["small"])
            yield from (f"{at}: {words}" for words in one["serious"])
            if one["beyond"] > 0:
                yield f"{at}: {one['beyond']} px wider than the window"
            if one["turns"] is False:
                yield f"{at}: the view does not turn"
        yield from (f"{one['path']}: {one['paper']} px wider than A4" for one in self.plain if one["paper"] > 0)


def reported(sample: str, folder: Path, change: Callable[[Path], None] = lambda place: None) -> list[Path]:
    """Run a sample project in a folder, changed before if wanted, and return its pages."""
    place = folder / sample
    assert run(["init", str(place), "--sample", sample]) == 0
    change(place)
    assert run(["run", str(place), "--quiet"]) == 0
    assert run(["report", str(place), "--quiet"]) == 0
    return sorted((place / "report").glob("*.html"))


def seen(paths: Sequence[Path], folder: Path, widths: Sequence[int] = WIDTHS) -> Seen:
    """Open pages at some widths and with scripts off, by one browser whose profile is in a folder."""
    axe = (files("axe_core_python") / "axe.min.js").read_text(encoding="utf-8")
    checks = Path(__file__).with_name("browser_checks.js").read_text(encoding="utf-8")
    wanted = ([str(path) for path in paths], widths, axe)
    given = ", ".join(json.dumps(one).replace("</", "<\\/") for one in wanted)
    wrapper = folder / "wrapper.html"
    wrapper.write_text(f"<body><script>{checks}\nreported({given});</script></body>", encoding="utf-8")
    command = [str(BROWSER), *_OPTIONS, f"--user-data-dir={folder}/profile", wrapper.as_uri()]
    lines = list[str]()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as browser:
        assert browser.stderr is not None
        try:
            for line in browser.stderr:
                if (found := re.search(r"REPORT(.*)END", line)) is not None:
                    report = json.loads(found[1])
                    return Seen(report["pages"], report["plain"], lines)
                assert "Uncaught (in promise)" not in line, line
                # scripts are blocked where they are switched off, and srcdoc is the copy that axe judges
                if "CONSOLE" in line and not re.search("Blocked script execution|about:srcdoc", line):
                    lines.append(line)
        finally:
            browser.kill()
    raise AssertionError(f"the browser ended: {lines}")


def main(folders: list[str]) -> None:
    """Print the faults of each sample project, or of the pages in each folder; raise SystemExit if there are any."""
    if BROWSER is None:
        raise SystemExit("no chromium is installed")
    total = 0
    with tempfile.TemporaryDirectory() as name:
        for one in folders or sorted(path.name for path in SAMPLES.glob("*/")):
            own = Path(tempfile.mkdtemp(dir=name))  # folders may have the same name
            paths = sorted(Path(one).resolve().rglob("*.html")) if folders else reported(one, own)
            found = seen(paths, own)
            faults = list(found.faults())
            silent = [page["path"] for page in found.plain if not page["texts"] or page["canvases"]]
            faults += [f"{path}: no text with scripts off" for path in silent]
            turning = sum(page["turns"] is True for page in found.pages) // len(WIDTHS)
            print(f"{one}: {len(paths)} pages, {turning} views that turn, {len(faults)} faults", flush=True)
            print("".join(f"  {fault}\n" for fault in faults), end="", flush=True)
            total += len(faults)
    if total:
        raise SystemExit(f"{total} faults")


if __name__ == "__main__":
    main(sys.argv[1:])
