"""HTML from values: everything is escaped unless it is HTML already."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


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
        return joined(tag(kind, one, class_="n" if k in numbers else "") for k, one in enumerate(row))

    headings = joined(tag("th", one, scope="col", class_="n" if k in numbers else "") for k, one in enumerate(head))
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
    found = joined(tag("li", marked(one)) for one in items)
    return tag("ul", found) if found else EMPTY
