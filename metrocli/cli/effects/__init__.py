"""metrocli effects: the effects that a kind of job knows, the page of one, and where user-defined effects can act."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json
from metrocli.cli.shell.choices import kinds, offering
from metrocli.errors import Fault, InputError, UsageError
from metrocli.tasks import KINDS
from metrocli.words import suggestion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from metrocli.effects.acting import Acting
    from metrocli.effects.effect import Effect
    from metrocli.tasks.kind import Kind


@click.command("effects", help="List the effects of a kind of job and where user-defined ones can act, or explain one.")
@click.argument("kind", required=False, metavar="[KIND|NAME]", shell_complete=offering(kinds))
@click.option("--from", "source", type=click.Path(path_type=Path), metavar="FILE", help="A file with `define:`.")
@click.option(
    "--check", is_flag=True, help="Test user-defined effects, of files and packages, against the laws of effects."
)
@options.JSON
def command(kind: str | None, source: Path | None, check: bool, as_json: bool) -> int:
    """Print the tables of one kind or of all, or one effect; raise InputError with every fault of user-defined ones."""
    if kind is not None and kind not in KINDS:
        echo(_explained(kind, as_json))
        return 0
    chosen = {kind: KINDS[kind]} if kind else {name: kind for name, kind in KINDS.items() if kind.task().places}
    by_kind = {name: (other, _own(name, source)) for name, other in chosen.items()}
    if check:
        faults, count = _faults(by_kind)
        if faults:
            raise InputError(faults)
    if as_json:
        data = {name: _data(other, own) for name, (other, own) in by_kind.items()}
        echo_json(data[kind] if kind else {"kinds": data})
        return 0
    if check:
        echo("\n".join([f"{count} user-defined effects obey the laws", *_in_data(by_kind)]))
        return 0
    echo("\n\n".join(_text(other, own) for other, own in by_kind.values()))
    return 0


def _explained(name: str, as_json: bool) -> str:
    """Return the page of an effect, or its entry in each kind that has it."""
    from metrocli.cli import summary
    from metrocli.effects.page import page

    tables = {kind: other.task().effects for kind, other in KINDS.items()}
    names = dict.fromkeys(effect.name for effects in tables.values() for effect in effects)
    if name not in names:
        raise UsageError(f"no kind of job and no effect '{name}'; {suggestion(name, [*KINDS, *names])}")
    if not as_json:
        return page(name, tables).rstrip()
    entries = {
        kind: [_effect(effect, False) for effect in effects if effect.name == name] for kind, effects in tables.items()
    }
    return summary.as_json({kind: entry for kind, entry in entries.items() if entry})


def _own(kind: str, source: Path | None) -> list[Effect]:
    """Return the user-defined effects of a kind: of a file, else of the project of this folder, and of packages."""
    from metrocli.project.own_effects import Defining, of_file, of_packages, of_project
    from metrocli.project.yaml_text import YamlFiles
    from metrocli.settings import path_beside

    task = KINDS[kind].task()
    taken = {effect.name for effect in task.effects}
    effects = list(of_packages(kind))
    files = YamlFiles()
    node = None if source is not None else of_project(Path(), files)
    path = source if node is None else path_beside(node)
    faults: list[Fault] = []
    if path is not None:
        given = Defining(kind, path, lambda: task.places, files)
        effects += of_file(path, given, taken | {effect.name for effect in effects}, faults, node)
    if faults:
        raise InputError(faults)
    return effects


def _faults(by_kind: dict[str, tuple[Kind, list[Effect]]]) -> tuple[list[Any], int]:
    """Return a fault for each law that a user-defined effect breaks, and the number of effects."""
    from metrocli.effects.own.trials import broken

    faults = [
        Fault(f"{effect.name}: {message}", hint=f"an effect for {name}")
        for name, (kind, own) in by_kind.items()
        for effect in own
        for message in broken(effect, kind.task().places)
    ]
    return faults, sum(len(own) for _, own in by_kind.values())


def _in_data(by_kind: dict[str, tuple[Kind, list[Effect]]]) -> list[str]:
    """Return a line for each user-defined effect that only data with further columns can test."""
    return [
        f"{effect.name}: {effect.lacks}; the units of its expression are tested with the data of a job ({name})"
        for name, (_, own) in by_kind.items()
        for effect in own
        if effect.lacks
    ]


def _data(kind: Kind, own: Sequence[Effect]) -> dict[str, Any]:
    entries = [_effect(effect, False) for effect in kind.task().effects]
    return {
        # an effect that acts in one of several frames, as the job has it, is one entry
        "effects": [
            *(entry for number, entry in enumerate(entries) if entry not in entries[:number]),
            *(_effect(effect, True) for effect in own),
        ],
        "places": [_place(place) for place in kind.task().places],
    }


def _effect(effect: Effect, own: bool) -> dict[str, Any]:
    return {
        "name": effect.name,
        "cause": effect.cause,
        "where": list(effect.where),
        "among": list(effect.among),
        "by": effect.by or None,
        "parameters": {
            parameter.name: {
                "unit": parameter.unit,
                "plausible": parameter.plausible,
                "scanned": parameter in effect.scanned,
            }
            for parameter in effect.all_parameters
        },
        **{key: getattr(effect, key) for key in ("formula", "usual", "reveal", "note", "source")},
        "own": own,
    }


def _place(acting: Acting) -> dict[str, Any]:
    return {
        "acts_on": acting.name,
        "unit": acting.units[0],
        "units": list(acting.units),
        "components": [name for name in acting.components if name],
        "where": list(acting.where),
        "variables": acting.all_units(),
    }


def _text(kind: Kind, own: Sequence[Effect]) -> str:
    """Return the tables of a kind as text."""
    from metrocli.cli.columns import columns_text

    task = kind.task()
    rows = [["effect", "where", "parameters", ""]]
    rows += [[*effect, ""] for effect in dict.fromkeys(map(_row, task.effects))] + [
        [*_row(effect), "own"] for effect in own
    ]
    places = [["user-defined effects act on", "where", "components", "variables"]]
    places += [_place_row(place) for place in task.places]
    return f"{kind.name}\n\n{columns_text(rows)}\n\n{columns_text(places)}"


def _place_row(acting: Acting) -> list[str]:
    variables = ", ".join(_with_unit(*pair) for pair in acting.all_units().items())
    return [acting.name, " ".join(acting.where), " ".join(acting.components) or acting.units[0], variables]


def _row(effect: Effect) -> tuple[str, str, str]:
    where = " ".join([*effect.keys, *([f"by {effect.by}"] if effect.by else [])])
    return (
        effect.name,
        where,
        ", ".join(_with_unit(parameter.name, parameter.unit) for parameter in effect.all_parameters),
    )


def _with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"
