"""metrocli lineage: files and jobs that a result was made from, back to the measurements."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli.console import echo, echo_json

if TYPE_CHECKING:
    from metrocli.project.provenance.lineage import Origin


@click.command("lineage", help="Show the jobs and files that a result was made from, back to the measurements.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@click.option("--to", "form", type=click.Choice(["text", "mermaid", "dot", "json"]), default="text", help="Format.")
def command(result: Path, form: str) -> int:
    """Print the lineage; each file with its digest and whether it still has the content that was read."""
    from metrocli.project.provenance.lineage import shortened, trace

    origin = trace(result)
    if form == "json":
        echo_json(_as_data(origin))
    else:
        lines = {"text": _text, "mermaid": _mermaid, "dot": _dot}[form](shortened(origin))
        echo("\n".join(lines))
    return 0


def _name(path: Path | None) -> str:
    return "" if path is None else Path(os.path.relpath(path)).as_posix()


def _text(origin: Origin, indent: int = 0) -> Iterator[str]:
    pad = "  " * indent
    state = "" if origin.state == "as read" else f"  {origin.state.upper()}"
    if origin.label is None:
        yield f"{pad}{_name(origin.path)}  {_content(origin)}{state}"
        return
    label = origin.label
    yield f"{pad}{_name(origin.path)}  {label.kind}, {label.status}, metrocli {label.metrocli_version}{state}"
    yield f"{pad}  job {_name(origin.job)}"
    for below in origin.origins:
        yield from _text(below, indent + 1)


def _nodes(origin: Origin) -> dict[Path, tuple[str, Origin]]:
    """Return a short name for each file."""
    from metrocli.project.provenance.lineage import files_of

    return {source.path: (f"f{number}", source) for number, source in enumerate(files_of(origin))}


def _content(origin: Origin) -> str:
    return f"sha256 {origin.digest[:12]}" if origin.files == 1 else f"{origin.files} files"


def _caption(origin: Origin) -> str:
    more = origin.label.kind if origin.label else _content(origin)
    return f"{_name(origin.path)} ({more}{'' if origin.state == 'as read' else ', ' + origin.state})".replace('"', "'")


def _mermaid(origin: Origin) -> Iterator[str]:
    from metrocli.project.provenance.lineage import links_of

    nodes = _nodes(origin)
    yield "graph LR"
    yield from (f'  {short}["{_plain(_caption(node))}"]' for short, node in nodes.values())
    for below, result in links_of(origin):
        yield f'  {nodes[below.path][0]} -->|"{_plain(_name(result.job))}"| {nodes[result.path][0]}'


def _plain(text: str) -> str:
    """Return a label of mermaid, which is set as HTML, without tags."""
    return text.replace("<", "#lt;").replace(">", "#gt;").replace('"', "'")


def _dot(origin: Origin) -> Iterator[str]:
    from metrocli.project.provenance.lineage import links_of

    nodes = _nodes(origin)
    yield "digraph lineage {"
    yield "  rankdir=LR"
    yield from (f'  {short} [label="{_caption(node)}"]' for short, node in nodes.values())
    for below, result in links_of(origin):
        yield f'  {nodes[below.path][0]} -> {nodes[result.path][0]} [label="{_name(result.job)}"]'
    yield "}"


def _as_data(origin: Origin) -> dict[str, Any]:
    data: dict[str, Any] = {"path": _name(origin.path), "digest": origin.digest, "state": origin.state}
    if origin.label is not None:
        label = origin.label
        data |= {"kind": label.kind, "status": label.status, "metrocli_version": label.metrocli_version}
        data |= {"job": _name(origin.job), "inputs": [_as_data(below) for below in origin.origins]}
    return data
