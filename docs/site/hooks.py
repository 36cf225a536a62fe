"""What the site has beside the pages of docs/: its order, the README, and a gallery made by running the samples."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

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


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the order of the pages; a page that has no place fails the strict build."""
    docs = Path(config.docs_dir)
    first = [f"{name}.md" for name in FIRST]
    sections = [{title: _pages(docs, folder)} for title, folder in SECTIONS.items()]
    config.nav = [{"Guide": [*first[:1], PROJECT, *first[1:], GALLERY]}, *sections]
    return config


def _pages(docs: Path, folder: str) -> list[str]:
    names = sorted(path.name for path in (docs / folder).glob("*.md"))
    return [f"{folder}/{name}" for name in sorted(names, key=lambda name: name != "README.md")]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README and the gallery; `extra: {samples: [...]}` limits the samples that are run."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, PROJECT, content=readme.replace("](docs/", "](")))
    samples = config.extra.get("samples", sorted(path.name for path in (ROOT / "sample_projects").glob("*/")))
    shown: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        parts = [_shown(name, Path(folder) / name, shown, files, config) for name in samples]
    head = "# Gallery\n\nThe samples, run while these pages were built; each figure by the first sample that has it.\n"
    files.append(File.generated(config, GALLERY, content="\n".join([head, *parts])))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links to the project's README lead to its page here."""
    up = "../" * page.file.src_uri.count("/")
    return markdown.replace(f"](../{up}README.md", f"]({up}{PROJECT}")


def _shown(sample: str, place: Path, shown: set[str], files: Files, config: MkDocsConfig) -> str:
    """Run a sample, add its page and the figures not yet shown to the site, and return its part of the gallery."""
    pages = f"gallery/{sample}"
    _metrocli("init", place, "--sample", sample)
    _metrocli("run", place, "--quiet", codes=(0, 6))
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
            figure = place / f"{name}.svg"
            _metrocli("plot", result, name, "--save", figure, "--quiet")
            files.append(File.generated(config, f"{pages}/{figure.name}", content=figure.read_text(encoding="utf-8")))
            text.append(f"    metrocli plot {sample}/results/{result.name} {name}\n")
            text.append(f"![{name} of {result.stem}]({pages}/{figure.name})\n")
    return "\n".join(text)


def _figures(result: Path) -> list[str]:
    return [line.split()[0] for line in _metrocli("plot", result).splitlines() if line.strip()]


def _metrocli(*words: str | Path, codes: tuple[int, ...] = (0,)) -> str:
    command = [sys.executable, "-m", "metrocli", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in codes:
        raise RuntimeError(f"metrocli {' '.join(command)}: exit code {done.returncode}\n{done.stderr}")
    return done.stdout
