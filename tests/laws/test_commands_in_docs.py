"""Every command in the README and the docs runs as it stands, and what the README quotes of its output is printed."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from places import DOCS, ROOT, SAMPLES

SAMPLE = {
    "calibrate-camera": ("board-camera", "calibrate", "camera"),
    "align-part": ("spindle-camera", "align", "part"),
    "multilaterate": ("gear-m3d3", "tip4", "tip4"),
    "locate-launch-unit": ("xm60-launch-unit", "table", "table"),
    "selfcal-grid": ("ball-cube", "views", "views"),
    "calibrate-machine": ("otf-tracker", "feed-2500", "feed-2500"),
    "rotary-axes": ("five-axis", "after", "after"),
    "adjust-network": ("hall-trackers", "hall", "hall"),
    "fit-part": ("raw-part", "fit", "fit"),
    "fit-points": ("best-fit", "fit", "fit"),
    "report-uncertainty": ("gauge-block", "gum", "gum"),
}
"""The sample, its job and its result that stand for JOB.yaml and RESULT.h5 on the pages of a kind; else the gear's"""
COMPARED: set[tuple[str, ...]] = set()
"""Comparisons that have run: the same on two pages runs once"""
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md")), *sorted(SAMPLES.rglob("README.md"))]
SHORT = {"README.md"}
"""Pages whose commands always run; the others are slow, since their samples run"""
COMMAND = re.compile(r"^ {4}((?:metrocli|cd|cat|make|python -m benchmarks) .*)$")
INLINE = re.compile(r"`((?:metrocli [a-z-]+ |make |python -m benchmarks)[^`]*)`", re.DOTALL)


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


def commands(page: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield each command of a page and the lines that are quoted of its output or follow it."""
    for block in re.split(r"(^```.*?^```$)|\n\n", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE):
        if block is None or not block.strip():
            continue
        if block.startswith("```"):
            yield from _of_console(block) if block.startswith("```console") else ()
        elif block.strip("\n").startswith("    "):
            found = [COMMAND.match(line) for line in block.splitlines()]
            yield from ((re.sub(r"\s+#.*", "", one[1]), []) for one in found if one)
        else:
            yield from ((" ".join(one[1].split()), []) for one in INLINE.finditer(block))


def _of_console(block: str) -> Iterator[tuple[str, list[str]]]:
    for part in block.removesuffix("```").split("\n$ ")[1:]:
        command, *quoted = part.splitlines()
        yield command, [line for line in quoted if line != "..."]


def kind_of(page: Path, wanted: list[tuple[str, list[str]]]) -> str:
    """The kind of job that a page is about: by its name or that of its sample, else by its first job or result."""
    for kind, (sample, *_) in SAMPLE.items():
        if kind == page.stem or sample == page.parent.name:
            return kind
    every = [(kind, command, f"results/{result}.h5") for command, _ in wanted for kind, (*_, result) in SAMPLE.items()]
    by_job = [kind for kind, command, _ in every if f" {kind} " in command]
    by_result = [kind for kind, command, result in every if result in command]
    return next(iter(by_job + by_result), "multilaterate")


def exit_code(page: Path, command: str) -> int:
    """The exit code that a page names after a command, in the same paragraph; else 0."""
    for paragraph in page.read_text(encoding="utf-8").split("\n\n"):
        after = " ".join(paragraph.split()).partition(command)[2]
        if named := re.search(r"\(exit code (\d)\)", after):
            return int(named[1])
    return 0


def meant(command: str, kind: str, number: int) -> list[str]:
    """The words of a command, with the sample's files in place of JOB.yaml, RESULT.h5 and so on."""
    sample, job, result = SAMPLE[kind]
    folder = "new" if command.split()[1:2] in (["init"], ["run"]) else f"out{number}"
    places = {"JOB.yaml": f"jobs/{job}.yaml", "RESULT.h5": f"results/{result}.h5", "DIR": folder, "KIND": kind}
    places |= {"FORMAT": "csv", "PROJECT": ".", "NAME": sample}
    return [places.get(word, word) for word in shlex.split(re.sub(r"\[(--.*)\]", r"\1", command))]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Path], None]:
    """Copy a sample project whose jobs have run; each runs once."""
    from metrocli.cli.commands import run

    home = tmp_path_factory.mktemp("samples")

    def copied(sample: str, to: Path) -> None:
        if not (home / sample).exists():
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                assert run(["init", str(home / sample), "--sample", sample]) == 0
                assert run(["run", str(home / sample)]) == 0
        shutil.copytree(home / sample, to, dirs_exist_ok=True)

    return copied


def is_known(words: list[str]) -> bool:
    """Whether a command exists and takes its options and arguments."""
    first, *rest = words
    if first == "make":
        return bool(re.search(f"^{rest[0]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    if first == "python":
        return (ROOT / "benchmarks" / f"{[*rest, '__main__'][2]}.py").exists()
    return first != "metrocli" or rest[0].startswith("-") or _is_parsed(rest)


def _is_parsed(words: list[str]) -> bool:
    from metrocli.cli.commands import commands as metrocli

    try:
        name, command, rest = metrocli.resolve_command(click.Context(metrocli), words)
        assert command is not None
        command.make_context(name, rest)
    except click.exceptions.Exit:  # --help
        return True
    except click.ClickException:
        return False
    return True


def words_of(page: Path) -> Iterator[list[str]]:
    """Yield the words of each command of a page."""
    wanted = list(commands(page))
    kind = kind_of(page, wanted)
    yield from (meant(command, kind, number) for number, (command, _) in enumerate(wanted))


def test_each_command_of_all_pages_is_known() -> None:
    assert not [(shown(page), words) for page in PAGES for words in words_of(page) if not is_known(words)]
    for words in ("metrocli run --no-such-option", "metrocli no-such", "make no-such", "python -m benchmarks no_such"):
        assert not is_known(words.split()), words


def _page(page: Path) -> Any:
    return pytest.param(page, marks=() if shown(page) in SHORT else pytest.mark.slow, id=shown(page))


WITH_COMMANDS = [page for page in PAGES if any(words[0] == "metrocli" for words in words_of(page))]


@pytest.mark.parametrize("page", [*map(_page, WITH_COMMANDS)])
def test_the_commands_of_a_page_run(
    page: Path,
    metrocli: Callable[..., Any],
    ran: Callable[[str, Path], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wanted = list(commands(page))
    kind = kind_of(page, wanted)
    monkeypatch.chdir(tmp_path)
    if any(one.startswith("metrocli ") for one, _ in wanted) and not any(one.startswith("cd ") for one, _ in wanted):
        own = page.parent.name if (page.parent / "metrocli.yaml").exists() else SAMPLE[kind][0]
        ran(own, tmp_path)
    for number, (command, quoted) in enumerate(wanted):
        first, *rest = meant(command, kind, number)
        if first == "cd":
            monkeypatch.chdir(rest[0])
        elif first == "cat":
            assert "\n".join(quoted) in Path(rest[0]).read_text(encoding="utf-8")
        elif first == "metrocli" and (quoted or "--compare" not in rest or (first, *rest) not in COMPARED):
            COMPARED.add((first, *rest))
            done = metrocli(*rest)
            assert done.code == exit_code(page, command), (command, done.err)
            printed = {" ".join(line.split()) for line in (done.out + done.err).splitlines()}
            assert {" ".join(line.split()) for line in quoted} <= printed, (command, done.out)
