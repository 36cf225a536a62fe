"""The page of an effect, made from its entries in the tables of the kinds: `metrocli effects NAME`, and the site."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from metrocli.effects.effect import COLUMN, Effect

_BY = {"t": "time", "T": "temperature"}
Tables = Mapping[str, Sequence[Effect]]
"""The effects of each kind of job"""


def page(name: str, tables: Tables) -> str:
    """Return the page of an effect as Markdown; kinds whose entries have the same words share a section."""
    sections: dict[str, list[str]] = {}
    for kind, effects in tables.items():
        for one in effects:
            if one.name == name:
                acts = sections.setdefault(_words(one), [])
                acts += [text for text in [f"{kind}: {_acts(one)}"] if text not in acts]
    parts = [words.replace(_ACTS, "\n".join(f"- For {text}" for text in acts)) for words, acts in sections.items()]
    return f"# {name}\n\n" + "\n\n".join(parts) + "\n"


_ACTS = "{acts}"


def _words(one: Effect) -> str:
    formula = "\n".join(f"    {line}" for line in one.formula.splitlines())
    cause = f"{one.cause[:1].upper()}{one.cause[1:]}."
    return "\n\n".join([cause, *([formula] if formula else []), "\n".join([_ACTS, *_facts(one)])])


def _facts(one: Effect) -> Iterator[str]:
    sizes = f", usually {one.usual}" if one.usual else ""
    yield f"- Parameters: {_quoted(p.name for p in one.parameters)}{sizes}"
    if one.scanned:
        yield f"- A job gives {_quoted(p.name for p in one.scanned)}; `metrocli diagnose` searches for it"
    if one.reveal:
        yield f"- To tell it apart, measure: {one.reveal}"
    if one.common and one.of_all:
        yield f"- At every {one.keys[0]}, with `std`: {one.of_all}"
    if one.note:
        yield f"- {one.note}"
    if one.source:
        yield f"- Source: {one.source}"


def _acts(one: Effect) -> str:
    """Return where an effect acts, what it needs and what looks like it: "acts on one `tracer`; needs t_s"."""
    if one.columns_of:
        text = f"frees {_quoted(p.name for p in one.parameters)}"
    else:
        text = f"acts on one {', one '.join(f'`{key}`' for key in one.keys)}" if one.keys else "acts on all readings"
    first = f", not the first {one.not_first[0]}" if one.not_first else ""
    form = f" by {_BY[one.by]}" if one.by else ""
    needs = [COLUMN.get(name.replace("{axis}", "x"), name.replace("{", "").replace("}", "")) for name in one.needs]
    parts = [f"{text}{first}{form}"]
    parts += [f"needs {', '.join(needs)}"] if needs else []
    parts += [f"similar: {_quoted(one.confused_with)}"] if one.confused_with else []
    return "; ".join(parts)


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
