"""Every command in the README and the docs runs as it stands, and what the README quotes of its output is printed."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from places import DOCS, ROOT, SAMPLES

SAMPLE = {
    "calibrate-camera": ("board-camera", "calibrate", "camera"),
    "align-part": ("spindle-camera", "align", "part"),
    "multilaterate": ("gear-m3d3", "tip3", "tip3"),
    "locate-launch-unit": ("xm60-launch-unit", "table", "table"),
    "selfcal-grid": ("ball-cube", "views", "views"),
    "calibrate-machine": ("otf-tracker", "feed-2500", "feed-2500"),
    "report-uncertainty": ("gauge-block", "gum", "gum"),
}
"""The sample, its job and its result that stand for JOB.yaml and RESULT.h5 on the pages of a kind; else the gear's"""
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md")), *sorted(SAMPLES.rglob("README.md"))]
COMMAND = re.compile(r"^\s*(?:\$ )?((?:metrocli|cd|cat|make|python -m benchmarks) .*)$")
INLINE = re.compile(r"`((?:metrocli [a-z-]+ |make |python -m benchmarks)[^`]*)`", re.DOTALL)


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


def commands(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield each command of a page and the lines that are quoted of its output."""
    fenced, quoted = False, []
    for line in page.read_text(encoding="utf-8").splitlines():
        if line.startswith("```"):
            fenced = not fenced and line == "```console"
        elif (fenced and line.startswith("$ ")) or (not fenced and line.startswith("    ")):
            if found := COMMAND.match(line):
                quoted = []
                yield re.sub(r"\s+#.*", "", found[1]), quoted
        elif fenced and line != "...":
            quoted.append(line)
        for found in () if fenced else INLINE.finditer(line):
            yield found[1], []


def kind_of(page: Path) -> str:
    """The kind of job that a page is about."""
    for kind, (sample, *_) in SAMPLE.items():
        if kind == page.stem or sample == page.parent.name:
            return kind
    return "multilaterate"


def meant(command: str, kind: str) -> list[str]:
    """The words of a command, with the sample's files in place of JOB.yaml, RESULT.h5 and so on."""
    _, job, result = SAMPLE[kind]
    places = {"JOB.yaml": f"jobs/{job}.yaml", "RESULT.h5": f"results/{result}.h5", "DIR": "out", "KIND": kind}
    places |= {"FORMAT": "csv", "PROJECT": "."}
    return [places.get(word, word) for word in shlex.split(re.sub(r"[][]", "", command))]


@pytest.mark.parametrize("page", PAGES, ids=shown)
def test_the_commands_of_a_page_run(
    page: Path, metrocli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, wanted = kind_of(page), list(commands(page))
    monkeypatch.chdir(tmp_path)
    if any(command.startswith("metrocli ") for command, _ in wanted) and not wanted[0][0].startswith("metrocli init"):
        metrocli("init", "here", "--sample", SAMPLE[kind][0])
        monkeypatch.chdir("here")
        assert metrocli("run").code == 0
    for command, quoted in wanted:
        first, *rest = meant(command, kind)
        if first == "cd":
            monkeypatch.chdir(rest[0])
        elif first == "cat":
            assert "\n".join(quoted) in Path(rest[0]).read_text(encoding="utf-8")
        elif first == "make":
            assert re.search(f"^{rest[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        elif first == "python":
            assert (ROOT / "benchmarks" / f"{[*rest, '__main__'][2]}.py").exists(), command
        else:
            ran = metrocli(*rest)
            assert ran.code == 0, (command, ran.err)
            printed = {" ".join(line.split()) for line in (ran.out + ran.err).splitlines()}
            assert {" ".join(line.split()) for line in quoted} <= printed, (command, ran.out)
