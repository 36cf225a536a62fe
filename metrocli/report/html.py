"""Parts of pages as HTML, what a page contains, and the units in which it states them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from html import escape
from typing import Any

from metrocli import units
from metrocli.frozen import dataclass
from metrocli.plots.context import ALONE, ResultContext
from metrocli.record import Record
from metrocli.result import Estimate, Result


class Html(str):
    """Text that is HTML; all other text is escaped."""

    __slots__ = ()


EMPTY = Html("")
_VOID = {"meta", "img", "br", "hr", "link", "source"}


def tag(element: str, /, *content: str, **attributes: str | bool) -> Html:
    """Return an element; `class_` is the attribute class, and a dash in an attribute is written as `_`.

    An attribute that is True has no value; one that is False or "" is left out.
    """
    held = "".join(_attribute(key.rstrip("_").replace("_", "-"), value) for key, value in attributes.items() if value)
    if element in _VOID:
        return Html(f"<{element}{held}>")
    return Html(f"<{element}{held}>{joined(content)}</{element}>")


def _attribute(key: str, value: str | bool) -> str:
    return f" {key}" if value is True else f' {key}="{escape(str(value))}"'


def joined(parts: Iterable[str]) -> Html:
    """Return parts one after the other."""
    return Html("".join(part if isinstance(part, Html) else escape(part, quote=False) for part in parts))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "", numbers: Sequence[int] = ()) -> Html:
    """Return a table that scrolls on its own where it is wide; columns in `numbers` are aligned to the right."""

    def cells(kind: str, row: Sequence[str]) -> Html:
        return joined(tag(kind, cell, class_="n" if k in numbers else "") for k, cell in enumerate(row))

    headings = joined(
        tag("th", heading, scope="col", class_="n" if k in numbers else "") for k, heading in enumerate(head)
    )
    body = joined(tag("tr", cells("td", row)) for row in rows)
    above = tag("caption", caption) if caption else EMPTY
    whole = tag("table", above, tag("thead", tag("tr", headings)), tag("tbody", body))
    return tag("div", whole, class_="wide", tabindex="0", role="region", aria_label=caption or "table")


def scrolling(picture: Html) -> Html:
    """Return a picture that scrolls on its own where its letters would be too small to read."""
    return tag("div", picture, class_="picture", tabindex="0")


def code(text: str) -> Html:
    """Return a text to type, whose lines break between words only, where they fit."""
    return tag("code", Html(" ".join(tag("span", word) for word in text.split(" "))))


def marked(text: str) -> Html:
    """Return a text whose parts between backticks are code; HTML stays as it is."""
    if isinstance(text, Html):
        return text
    return joined(code(part) if k % 2 else part for k, part in enumerate(text.split("`")))


def listed(items: Iterable[str]) -> Html:
    """Return items as a list, nothing without any; what is between backticks in them is code."""
    entries = joined(tag("li", marked(entry)) for entry in items)
    return tag("ul", entries) if entries else EMPTY


@dataclass(frozen=True)
class PrintedDiagnosis:
    """What `metrocli diagnose --json` printed for the job of a result."""

    data: Mapping[str, Any]
    path: str
    is_current: bool
    """Whether it is the diagnosis of this job with these inputs"""


@dataclass(frozen=True)
class Content:
    """A result with what its page shows of it."""

    result: Result
    record: Record
    path: str
    tables: Mapping[str, str] = field(default_factory=dict)
    """Shown tables as text"""
    diagnosis: PrintedDiagnosis | None = None
    job: str = "JOB.yaml"
    """How commands name the job"""
    context: ResultContext = ALONE
    """What figures show with the result"""
    stated: Result | None = None
    """The result in the units of its estimates on the page; the result itself unless given"""


def stated(result: Result, record: Record) -> str:
    """Return the text of the job and the definitions of user-defined effects: where the user states units."""
    defined = (table.texts("define") for name, table in result.tables.items() if name.endswith("/definition"))
    return "\n".join([record.job_text, *(text for texts in defined for text in texts)])


def compound_unit(estimate: Estimate, text: str) -> tuple[float, str]:
    """Return size and symbol of the unit in which a text states an estimate without dimension; else its own unit."""
    known = {units.internal_unit(name) for name in units.DIMENSIONS}
    if estimate.unit in known or "/" in estimate.unit or units.is_inch(estimate.unit):
        return 1.0, estimate.unit
    from metrocli.expressions.dimensions import compound, written

    if compound(estimate.unit).factor != 1:  # no base unit: the job chose it
        return 1.0, estimate.unit
    unit = written(text, estimate.unit, estimate.name.rpartition(".")[2])
    return (1.0, estimate.unit) if unit is None else (unit.factor, unit.text)
