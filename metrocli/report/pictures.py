"""Figures inside a page: SVG whose colours follow the page, an image where that is smaller, 3-D views that turn."""

from __future__ import annotations

import base64
import json
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from metrocli import plots
from metrocli.plots import control_chart, panel_columns, style
from metrocli.plots.context import ALONE, ResultContext
from metrocli.plots.scene import TILT, TURN, Scene, named
from metrocli.report.html import EMPTY, Html, code, joined, scrolling, tag
from metrocli.report.pdf import roles, variable
from metrocli.result import Result
from metrocli.table import Table
from metrocli.words import shortened

LARGEST = 150_000
"""Characters of an SVG beyond which the figure is an image of pixels"""
MOST = 1_200_000
"""Characters of all figures of a page; those beyond it are named only"""
_PLAIN = re.compile(r"[^A-Za-z0-9]+")
_ID = re.compile(r'(\bid="|url\(#|href="#)')


def figures(result: Result, path: str, context: ResultContext) -> Iterator[tuple[str, Html]]:
    """Yield name and content of each figure of a result, as long as the page has room; then how to draw it."""
    room = MOST
    for name in plots.FIGURES:
        data = plots.data_of(name, result, context)
        if data is None:
            continue
        if room <= 0:
            command = code(f"metrocli plot {path} {name}")
            yield name, tag("p", f"{plots.title_of(name)}: this page has no room; ", command, id=f"figure-{name}")
            continue
        drawn = _figure(name, data)
        room -= len(drawn)
        yield name, drawn


def _figure(name: str, data: Any) -> Html:
    turning = _turning(data) if isinstance(data, Scene) else {}
    with plots.drawn(name, data) as (canvas, caption):
        style.arrange(canvas)
        text = style.svg(canvas)
        label = f"{plots.title_of(name)}. {caption}"
        picture = (
            _stacked(inline(text, name, label), name, panel_columns.ends(canvas))
            if len(text) <= LARGEST
            else _image(style.png(canvas), caption, b"" if turning else _dark(name, data))
        )
    help_text = tag("p", "Drag, or use the arrow keys, to turn; + and - zoom.", class_="turning hidden muted")
    held = tag("script", _as_json(turning), type="application/json") if turning else EMPTY
    under = tag("figcaption", caption)
    parts = [tag("h3", plots.title_of(name)), held, scrolling(picture), help_text if turning else EMPTY, under]
    return tag("figure", *parts, id=f"figure-{name}", data_scene=bool(turning))


def control_charts(name: str, table: Table) -> Html:
    """Return the control charts of a job with many parts from their gathered table; nothing for few parts."""
    series = control_chart.series_of(table)
    if not series:
        return EMPTY
    with style.canvas(name, control_chart.height(series), style.LIGHT) as canvas:
        caption = control_chart.draw(canvas, series)
        style.arrange(canvas)
        text = style.svg(canvas)
        title = f"Control charts of {name}"
        picture = (
            inline(text, name, f"{title}. {caption}") if len(text) <= LARGEST else _image(style.png(canvas), caption)
        )
    return tag("figure", tag("h3", title), scrolling(picture), tag("figcaption", caption))


def inline(text: str, name: str, label: str) -> Html:
    """Return an SVG for the inside of a page: names made distinct, colours by their role, as wide as there is room."""
    svg = text[text.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = _ID.sub(rf"\g<1>{_PLAIN.sub('-', name)}-", svg)
    for role, colour in roles(style.LIGHT).items():
        svg = svg.replace(colour, variable(role))
    size = re.search(r'viewBox="[^"]*"', svg)
    title = tag("title", label)
    opened = f'<svg {size[0] if size else ""} role="img" xmlns:xlink="http://www.w3.org/1999/xlink">{title}'
    return Html(re.sub(r"<svg.*?>", lambda _: opened, svg, count=1, flags=re.DOTALL))


def _stacked(svg: Html, name: str, columns: Sequence[tuple[float, float, float]]) -> Html:
    """Return an SVG as one for each of its columns; those without room stand below the others."""
    if len(columns) == 1:
        return svg
    boxes = [
        f'viewBox="{left:.1f} 0 {right - left:.1f} {height:.1f}" style="flex-grow:{right - left:.0f}"'
        for left, right, height in columns
    ]
    # the first holds the drawing, of which the others show their part
    again = f'<use xlink:href="#{_PLAIN.sub("-", name)}-figure_1"/>'
    others = (Html(f'<svg {box} aria-hidden="true">{again}</svg>') for box in boxes[1:])
    return tag("div", Html(re.sub('viewBox="[^"]*"', boxes[0], svg, count=1)), *others, class_="columns")


def _dark(name: str, data: Any) -> bytes:
    """Return a figure as an image for a dark screen."""
    with plots.drawn(name, data, dark=True) as (canvas, _):
        style.arrange(canvas)
        return style.png(canvas)


def _image(content: bytes, caption: str, dark: bytes = b"") -> Html:
    """Return an image; on a dark screen, but not on paper, it is another one where that is given."""
    light = tag("img", src=_as_link(content), alt=caption)
    if not dark:
        return light
    return tag("picture", tag("source", srcset=_as_link(dark), media="screen and (prefers-color-scheme:dark)"), light)


def _as_link(content: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(content).decode()}"


def _turning(scene: Scene) -> dict[str, Any]:
    """Return the data of a view that turns: places from their middle, vectors and ellipsoids in true size."""
    at = scene.all_at
    middle = (at.min(axis=0) + at.max(axis=0)) / 2
    tips = [place.at + scene.vectors * place.vectors for place in scene.places if place.vectors is not None]
    reach = float(np.linalg.norm(np.concatenate([at, *tips]) - middle, axis=1).max())
    kinds = []
    for place in scene.places:
        kind: dict[str, Any] = {"kind": place.kind, "at": _rounded(place.at - middle)}
        if place.faint:
            kind["faint"] = True
        if place.vectors is not None:
            kind["vectors"] = _rounded(place.vectors)
        if place.lines is not None:
            ends = (place.lines - middle).reshape(-1, 2, 3)
            kind["lines"] = _rounded(ends[(ends[:, 0] != ends[:, 1]).any(axis=1)])
        if place.covariance is not None and np.isfinite(place.covariance).all():
            kind["covariance"] = _rounded(4 * place.covariance)
        kinds.append(kind)
    return {
        "turn": float(TURN), "tilt": float(TILT), "size": 2 * reach or 1.0, "kinds": kinds,
        "vectors": scene.vectors, "ellipsoids": scene.ellipsoids,
        "names": [[k, row, shortened(scene.places[k].names[row], style.LETTERS)] for k, row in named(scene.places)],
    }  # fmt: skip


def _rounded(values: Any) -> Any:
    """Return numbers to four digits of the largest: more than a picture shows."""
    largest = float(np.abs(values).max(initial=0.0))
    return np.round(values, 3 - math.floor(math.log10(largest))).tolist() if largest > 0 else values.tolist()


def _as_json(value: Any) -> Html:
    """Return JSON that no text in it can end: the sign < is written as an escape."""
    return Html(json.dumps(value, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c"))


def shown(result: Result, path: str, context: ResultContext = ALONE) -> tuple[Html, bool]:
    """Return all figures of a result in the file `path`, and whether one of them turns."""
    drawn = list(figures(result, path, context))
    return joined(content for _, content in drawn), any(name == "scene" for name, _ in drawn)
