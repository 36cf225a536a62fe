"""The page of a project: its jobs, where they come from, what is stale."""

from __future__ import annotations

from collections.abc import Sequence

from metrocli.frozen import dataclass
from metrocli.record import DONE, FAIL, GUARD_BAND, USABLE
from metrocli.report.findings import BAD, GOOD
from metrocli.report.html import EMPTY, Html, code, joined, scrolling, table, tag
from metrocli.report.pdf import page

_WIDE, _HIGH, _GAP = 190, 46, 60
_LEAST = 0.75
"""Scale below which the lineage scrolls: its letters are then 9 px"""


@dataclass(frozen=True)
class JobEntry:
    """One job of a project."""

    name: str
    kind: str
    title: str
    status: str
    """Status of the result, or empty without one"""
    stale: str
    """Why it is not up to date; empty if it is"""
    needs: tuple[str, ...]
    inputs: tuple[str, ...]
    """Files that no job of the project writes"""
    page: str
    """Link to the page of the result; empty without one"""
    conformity: str = ""
    """Decision on the tolerances of the job: pass, fail, or in the guard band"""
    verdict: str = ""
    """Verdict of the diagnosis beside the result; empty without one of this result"""

    @property
    def fit(self) -> bool:
        """Whether the result is fit for use, also by its diagnosis if there is one."""
        return self.status == DONE and self.conformity != GUARD_BAND and self.verdict in ("", "clean")


def project_page(name: str, entries: Sequence[JobEntry], charts: Sequence[Html] = ()) -> str:
    """Return the page of a project as HTML, with control charts of its jobs that have many parts."""
    stale = [entry for entry in entries if entry.stale]
    bad = [entry for entry in entries if not entry.stale and entry.status not in USABLE]
    out = [entry for entry in entries if not entry.stale and entry.conformity in (FAIL, GUARD_BAND)]
    complete = [entry for entry in entries if not entry.stale and entry.status in USABLE]
    lacking = [entry for entry in complete if entry.verdict not in ("", "clean")]
    words = "All results are up to date and done."
    if stale or bad or lacking or out:
        counts = (stale, _STALE), (bad, _UNFIT), (out, _IN_TOLERANCE), (lacking, _LACKING)
        words = " ".join(_count(some, len(entries), what) for some, what in counts if some)
    head = ["job", "state", "kind", "title", *(["needs"] if any(entry.needs for entry in entries) else [])]
    rows = [
        (_link(entry), _state(entry), entry.kind, entry.title, ", ".join(entry.needs))[: len(head)] for entry in entries
    ]
    parts = [
        tag("p", "metrocli project", class_="muted"),
        tag("h1", name),
        tag("div", tag("p", tag("strong", words)), class_=f"verdict {BAD if stale or bad or lacking or out else GOOD}"),
        tag("p", "Bring it up to date by ", code("metrocli run"), ".") if stale else EMPTY,
        tag("h2", "Jobs"),
        table(head, rows, "Jobs in the order in which they run"),
        joined([tag("h2", "Control charts"), *charts]) if charts else EMPTY,
        tag("h2", "Lineage"),
        _lineage(entries),
    ]
    return page(name, *parts)


_STALE, _UNFIT, _LACKING = "up to date", "fit for use", "complete in its model, by its diagnosis"
_IN_TOLERANCE = "shown to be in tolerance"


def _count(some: Sequence[JobEntry], of: int, what: str) -> str:
    return f"{len(some)} of {of} results {'is' if len(some) == 1 else 'are'} not {what}."


def _link(entry: JobEntry) -> Html:
    return tag("a", entry.name, href=entry.page) if entry.page else joined([entry.name])


def _state(entry: JobEntry) -> Html:
    if entry.stale:
        return tag("span", f"not up to date: {entry.stale}", class_="stale")
    diagnosed = f"; diagnosis: {entry.verdict}" if entry.verdict else ""
    decided = f", {entry.conformity}" if entry.conformity not in ("", entry.status) else ""
    return tag("span", f"up to date, {entry.status}{decided}{diagnosed}", class_="" if entry.fit else "stale")


def ranks(entries: Sequence[JobEntry]) -> dict[str, int]:
    """Return for each job the number of jobs before it on its longest way from the measurements."""
    rank: dict[str, int] = {}
    for entry in entries:  # in the order in which they run
        rank[entry.name] = 1 + max((rank[name] for name in entry.needs), default=0)
    return rank


def _lineage(entries: Sequence[JobEntry]) -> Html:
    """Return the graph of files and jobs, from left to right, and the same as a list."""
    rank = ranks(entries)
    files = list(dict.fromkeys(path for entry in entries for path in entry.inputs))
    columns = [
        files,
        *(
            [entry.name for entry in entries if rank[entry.name] == n]
            for n in range(1, max(rank.values(), default=0) + 1)
        ),
    ]
    place = {name: (column, row) for column, names in enumerate(columns) for row, name in enumerate(names)}
    boxes = [
        _box(name, *place[name], entry)
        for name, entry in [(path, None) for path in files] + [(e.name, e) for e in entries]
    ]
    lines = [_line(place[source], place[entry.name]) for entry in entries for source in (*entry.inputs, *entry.needs)]
    wide = len(columns) * (_WIDE + _GAP) - _GAP + 2
    high = max(map(len, columns), default=1) * _HIGH
    size = f"0 0 {wide} {high}"
    title = tag("title", "Files and jobs; the list below has the same")
    drawn = tag("svg", title, *lines, *boxes, viewBox=size, role="img", style=f"min-width:{_LEAST * wide:.0f}px")
    items = [
        tag("li", f"{entry.name} takes {', '.join((*entry.needs, *entry.inputs)) or 'no file'}") for entry in entries
    ]
    return joined([tag("figure", scrolling(drawn), style=f"max-width:{wide}px"), tag("ul", *items)])


def _box(name: str, column: int, row: int, entry: JobEntry | None) -> Html:
    x, y = column * (_WIDE + _GAP) + 1, row * _HIGH + 6
    sound = entry is not None and not entry.stale and entry.fit
    stroke = "var(--muted)" if entry is None else "var(--third)" if sound else "var(--second)"
    box = tag(
        "rect",
        x=f"{x}",
        y=f"{y}",
        width=f"{_WIDE}",
        height="32",
        rx="4",
        style=f"fill:var(--surface);stroke:{stroke};stroke-width:1.5",
    )
    text = name if len(name) <= 26 else f"…{name[-25:]}"
    label = tag("text", text, x=f"{x + 8}", y=f"{y + 20}", style="fill:var(--ink);font:12px system-ui,sans-serif")
    return tag("g", tag("title", name), box, label)


def _line(source: tuple[int, int], to: tuple[int, int]) -> Html:
    x, y = source[0] * (_WIDE + _GAP) + _WIDE + 1, source[1] * _HIGH + 22
    u, v = to[0] * (_WIDE + _GAP) + 1, to[1] * _HIGH + 22
    bend = (x + u) / 2
    path = f"M{x} {y}C{bend} {y} {bend} {v} {u} {v}"
    return tag("path", d=path, style="fill:none;stroke:var(--muted);stroke-width:1")
