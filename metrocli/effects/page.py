"""The page of an effect, made from its entries in the tables of the kinds: `metrocli effects NAME`, and the site."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from metrocli.effects.effect import COLUMN, READ_BY, Effect

_BY = {"t": "time", "T": "temperature"}
Tables = Mapping[str, Sequence[Effect]]
"""The effects of each kind of job"""


def page(name: str, tables: Tables) -> str:
    """Return the page of an effect as Markdown; kinds whose entries have the same words share a section."""
    sections: dict[str, list[str]] = {}
    for kind, effects in tables.items():
        for effect in effects:
            if effect.name == name:
                acts = sections.setdefault(_words(effect), [])
                acts += [text for text in [f"{kind}: {_acts(effect)}"] if text not in acts]
    parts = [words.replace(_ACTS, "\n".join(f"- For {text}" for text in acts)) for words, acts in sections.items()]
    return f"# {name}\n\n" + "\n\n".join(parts) + "\n"


_ACTS = "{acts}"


def _words(effect: Effect) -> str:
    formula = "\n".join(f"    {line}" for line in effect.formula.splitlines())
    cause = f"{effect.cause[:1].upper()}{effect.cause[1:]}."
    return "\n\n".join([cause, *([formula] if formula else []), "\n".join([_ACTS, *_facts(effect)])])


def _facts(effect: Effect) -> Iterator[str]:
    sizes = f", usually {effect.usual}" if effect.usual else ""
    yield f"- Parameters: {_quoted(p.name for p in effect.parameters)}{sizes}"
    if effect.scanned:
        yield f"- A job gives {_quoted(p.name for p in effect.scanned)}; `metrocli diagnose` searches for it"
    if effect.reveal:
        yield f"- To tell it apart, measure: {effect.reveal}"
    if effect.common and effect.of_all:
        yield f"- {effect.everywhere.capitalize()}, with `std`: {effect.of_all}"
    if effect.note:
        yield f"- {effect.note}"
    if effect.source:
        yield f"- Source: {effect.source}"


def _acts(effect: Effect) -> str:
    """Return where an effect acts, what it needs and what looks like it: "acts on one `tracer`; needs t_s"."""
    if effect.columns_of:
        text = f"frees {_quoted(p.name for p in effect.parameters)}"
    else:
        text = (
            f"acts on one {', one '.join(f'`{key}`' for key in effect.keys)}" if effect.keys else "acts on all readings"
        )
    first = f", not the first {effect.not_first[0]}" if effect.not_first else ""
    form = f" by {_BY[effect.by]}" if effect.by else ""
    needs = [
        READ_BY.get(name, COLUMN.get(name.replace("{axis}", "x"), name.replace("{", "").replace("}", "")))
        for name in effect.needs
    ]
    parts = [f"{text}{first}{form}"]
    parts += [f"needs {', '.join(needs)}"] if needs else []
    parts += [f"similar: {_quoted(effect.confused_with)}"] if effect.confused_with else []
    return "; ".join(parts)


def _quoted(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)
