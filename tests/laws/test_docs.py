"""The documents name everything that the tables have."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from places import DOCS, SAMPLES

from metrocli import errors, settings, units
from metrocli.tasks import KINDS

CHANGELOG = DOCS.parent / "CHANGELOG.md"
PAGES = [*DOCS.rglob("*.md"), *SAMPLES.rglob("README.md"), DOCS.parent / "README.md", CHANGELOG]
README = (DOCS.parent / "README.md").read_text(encoding="utf-8")
LONGEST_VERSION = 2500
"""Words that a user still reads about one version"""


@pytest.mark.parametrize(
    "dimension", ["length", "angle", "slope", "ratio", "time", "temperature", "pressure", "humidity", "pixel", "speed"]
)
def test_the_endings_of_columns_are_listed(dimension: str) -> None:
    text = (DOCS / "files.md").read_text(encoding="utf-8")
    assert all(f"_{suffix}" in text for suffix in units.suffixes(dimension))


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_in_the_readme(kind: str) -> None:
    assert f"metrocli {kind}" in README


def test_each_exit_code_is_in_the_readme() -> None:
    kinds = (errors.UsageError, errors.InputError, errors.UndeterminedError, errors.NotConvergedError)
    assert all(f"| {kind.exit_code} |" in README for kind in kinds)


@pytest.mark.parametrize(
    "spec",
    [
        name
        for name, value in vars(settings).items()
        if isinstance(value, type) and hasattr(value, "read") and name[0] != "_" and name != "Spec"
    ],
)
def test_each_specification_of_settings_is_explained(spec: str) -> None:
    assert f"{spec}(" in (DOCS / "adding.md").read_text(encoding="utf-8")


CAMERA = """\
metrocli: 1
job: calibrate-camera
rig: board
inputs: {images: "img/*.jpg"}
pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}
camera:
  image_size: [640, 480]
  pixel_size: 2.2 um
  estimate: [f, cx, cy, k1, k2, p1, p2]
title: Camera 12, wide lens
noise: 0,1 px
"""
"""With a decimal comma in line 11"""


def test_the_fault_of_the_readme_is_reported_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from metrocli.errors import InputError
    from metrocli.project.job import load

    monkeypatch.chdir(tmp_path)
    Path("camera.yaml").write_text(CAMERA, encoding="utf-8")
    Path("img").mkdir()
    Path("img/a.jpg").write_bytes(b"x")
    with pytest.raises(InputError) as caught:
        load(Path("camera.yaml"))
    assert all(line.strip() in README for line in str(caught.value).splitlines())


def test_the_job_of_the_readme_is_that_of_the_sample() -> None:
    block = README.split("$ cat jobs/tip4.yaml\n")[1].split("...")[0]
    assert block in (SAMPLES / "gear-m3d3" / "jobs" / "tip4.yaml").read_text(encoding="utf-8")


def headings(page: Path) -> set[str]:
    """The anchors of a page."""
    plain = re.findall(r"^#+ (.*)$", re.sub(r"[`*]", "", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", heading.lower())) for heading in plain}


def dead_links(page: Path) -> list[str]:
    dead = []
    for link, _, anchor in re.findall(r"\]\(([^)\s#:]*)(#?)([^)\s:]*)\)", page.read_text(encoding="utf-8")):
        to = page.parent / link if link else page
        if not to.exists() or (anchor and to.suffix == ".md" and anchor not in headings(to)):
            dead.append(f"{link}#{anchor}")
    return dead


def test_links_of_all_pages_lead_to_a_page_and_a_heading() -> None:
    assert not [(str(page), dead) for page in PAGES if (dead := dead_links(page))]


def test_a_dead_link_is_found(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text("# One `two`\n[a](#one-two) [b](#three) [c](none.md) [d](a.md#one-two) [e](https://x.y/z)")
    assert dead_links(page) == ["#three", "none.md#"]


def test_the_changelog_is_short() -> None:
    _, *versions = re.split(r"^## ", CHANGELOG.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert versions
    assert not [version.split("\n")[0] for version in versions if len(version.split()) > LONGEST_VERSION]


def test_each_decision_is_named_where_it_holds() -> None:
    pages = [*(DOCS / "decisions").glob("[0-9]*.md")]
    texts = {path: path.read_text(encoding="utf-8") for path in [*PAGES, *(DOCS.parent / "metrocli").rglob("*.py")]}
    named = {page.stem for page in pages for path, text in texts.items() if path != page and page.stem in text}
    assert pages and not [page.stem for page in pages if page.stem not in named]
