"""The documentation as a site: strict, every page has a place, and the gallery shows a sample that was run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config
from places import DOCS

ONE_OF_EACH = {"samples": ["gauge-block"], "effects": ["backlash", "dead-path-drift"]}
"""`make docs` has all"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    file = str(DOCS / "site" / "mkdocs.yml")
    config = load_config(file, site_dir=str(folder), strict=True, extra=ONE_OF_EACH)
    config.plugins.on_startup(command="build", dirty=False)
    build(config)
    return folder


def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {path.relative_to(DOCS).with_suffix("") for path in DOCS.rglob("*.md")}
    made = {path.relative_to(site).with_suffix("") for path in site.rglob("*.html")}
    assert {path.with_name("index") if path.name == "README" else path for path in pages} <= made


def test_the_gallery_has_the_figures_of_a_sample_that_was_run(site: Path) -> None:
    text = (site / "gallery.html").read_text()
    figures = re.findall(r'src="(gallery/gauge-block/[\w.-]+\.svg)#only-(?:light|dark)"', text)
    wanted = {
        f"gallery/gauge-block/{name}.{theme}.svg" for name in ("budget", "conformity") for theme in ("light", "dark")
    }
    assert wanted <= set(figures)
    assert all("<svg" in (site / name).read_text() for name in figures)
    assert "gauge" in (site / "gallery/gauge-block/index.html").read_text().lower()


def test_the_readme_is_a_page_whose_links_lead_into_the_site(site: Path) -> None:
    text = (site / "project.html").read_text()
    links = re.findall(r'href="([^"]*)"', text)
    assert "tour.html" in links and not [one for one in links if one.startswith(("docs/", "../"))]


def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    for path in site.rglob("*.html"):
        assert not re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(?:https?:)?//', path.read_text()), path
