"""What the site has beside the pages of docs/: its order, the README, the effects, and a gallery of samples."""

from __future__ import annotations

import re
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from metrocli.cli.commands import run
from metrocli.effects.page import page
from metrocli.tasks import KINDS

ROOT = Path(__file__).parents[2]
FIRST = (
    "README",
    "tour",
    "diagnosis",
    "conventions",
    "targets",
    "files",
    "figures",
    "exports",
    "imports",
    "automation",
    "papers",
    "benchmarks",
    "adding",
)
"""Pages of the first section, in the order in which a newcomer needs them"""
SECTIONS = {
    "Jobs": "tasks", "Instruments": "instruments", "Effects": "effects", "Algorithms": "algorithms",
    "Decisions": "decisions",
}  # fmt: skip
PROJECT = "project.md"
"""Page that holds the project's README"""
GALLERY = "gallery.md"
DIAGNOSED = {"gear-m3d3": ("multilaterate", "tip4")}
"""Kind and name of the job of a sample that the gallery diagnoses and extends"""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the order of the pages; a page that has no place fails the strict build."""
    docs = Path(config.docs_dir)
    first = [f"{name}.md" for name in FIRST]
    sections = [{title: _pages(docs, folder)} for title, folder in SECTIONS.items()]
    sections[list(SECTIONS).index("Effects")]["Effects"] += [f"effects/{name}.md" for name in _shown_effects(config)]
    config.nav = [{"Guide": [*first[:1], PROJECT, *first[1:], GALLERY]}, *sections]
    return config


def _pages(docs: Path, folder: str) -> list[str]:
    names = sorted(path.name for path in (docs / folder).glob("*.md"))
    return [f"{folder}/{name}" for name in sorted(names, key=lambda name: name != "README.md")]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README, the effects and the gallery; `extra: {samples: [...], effects: [...]}` limits them."""
    for name, text in _shown_effects(config).items():
        files.append(File.generated(config, f"effects/{name}.md", content=text))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, PROJECT, content=readme.replace("](docs/", "](")))
    samples = config.extra.get("samples", sorted(path.name for path in (ROOT / "sample_projects").glob("*/")))
    shown: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        parts = [_shown(name, Path(folder) / name, shown, files, config) for name in samples]
    head = "# Gallery\n\nThe samples, run while these pages were built; each figure by the first sample that has it.\n"
    files.append(File.generated(config, GALLERY, content="\n".join([head, *parts])))
    return files


def _shown_effects(config: MkDocsConfig) -> dict[str, str]:
    return _effects(tuple(config.extra.get("effects", ())))


@cache
def _effects(only: tuple[str, ...]) -> dict[str, str]:
    """Return the page of each effect, whose names in code lead to each other; of all if none is named."""
    tables = {kind: one.task().effects for kind, one in KINDS.items()}
    names = sorted(only or {effect.name for effects in tables.values() for effect in effects})
    linked = re.compile(f"`({'|'.join(names)})`")
    return {name: linked.sub(r"[\1](\1.md)", page(name, tables)) for name in names}


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to the project's README lead to its page here."""
    up = "../" * page.file.src_uri.count("/")
    return markdown.replace(f"](../{up}README.md", f"]({up}{PROJECT}")


def _shown(sample: str, place: Path, shown: set[str], files: Files, config: MkDocsConfig) -> str:
    """Run a sample, add its page and the figures not yet shown to the site, and return its part of the gallery."""
    pages = f"gallery/{sample}"
    _metrocli("init", place, "--sample", sample)
    _metrocli("run", place, "--quiet", codes=(0, 6))
    if sample in DIAGNOSED:
        _diagnose(place, *DIAGNOSED[sample])
    _metrocli("report", place, "--quiet")
    for path in sorted((place / "report").glob("*.html")):
        files.append(File.generated(config, f"{pages}/{path.name}", content=path.read_text(encoding="utf-8")))
    text = [f"## {sample}\n", f"    metrocli init {sample} --sample {sample}\n    metrocli run {sample}"]
    text += [f"    metrocli report {sample}\n", f"[The page of the project]({pages}/index.html)\n"]
    for result in sorted((place / "results").glob("*.h5")):
        for name in _figures(result):
            if name in shown:
                continue
            shown.add(name)
            text.append(f"    metrocli plot {sample}/results/{result.name} {name}\n")
            for theme, option in (("light", ()), ("dark", ("--dark",))):
                figure = place / f"{name}.{theme}.svg"
                _metrocli("plot", result, name, "--save", figure, *option, "--quiet")
                drawn = figure.read_text(encoding="utf-8")
                files.append(File.generated(config, f"{pages}/{figure.name}", content=drawn))
                text.append(f"![{name} of {result.stem}]({pages}/{figure.name}#only-{theme})")
            text.append("")
    return "\n".join(text)


def _diagnose(place: Path, kind: str, name: str) -> None:
    """Diagnose a job of a sample and run the extended job, for the figures that need both."""
    _metrocli("diagnose", place / "jobs" / f"{name}.yaml", "--quiet")
    _metrocli(kind, place / "jobs" / f"{name}.extended.yaml", "--quiet")


def _figures(result: Path) -> list[str]:
    return [line.split()[0] for line in _metrocli("plot", result).splitlines() if line.strip()]


def _metrocli(*words: str | Path, codes: tuple[int, ...] = (0,)) -> str:
    """Return what a command prints; all run in this process, which loads its libraries once."""
    command, printed, failed = [*map(str, words)], StringIO(), StringIO()
    with redirect_stdout(printed), redirect_stderr(failed):
        code = run(command)
    if code not in codes:
        raise RuntimeError(f"metrocli {' '.join(command)}: exit code {code}\n{failed.getvalue()}")
    return printed.getvalue()
