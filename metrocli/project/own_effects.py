"""User-defined effects: those of a job, of the files that it and its project name, and of installed packages."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import field
from enum import IntEnum
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

from metrocli import tasks
from metrocli.effects.acting import Acting
from metrocli.effects.effect import Effect
from metrocli.effects.own.define import read
from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import read_bytes
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.project import PROJECT_FILE
from metrocli.project.heading import Heading
from metrocli.project.yaml_text import YamlFile, YamlFiles
from metrocli.settings import path_beside
from metrocli.words import listed, suggestion

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

ENTRY_POINTS = "metrocli.effects"
"""Group of the entry points of packages: each is a function that returns effects for the name of a kind"""
_KEY = "define"


@dataclass(frozen=True)
class Package:
    """A package that offers effects, as it is installed."""

    name: str
    """With its version"""
    digest: str
    """Of the module that offers them, where it is a file"""
    file: Path | None
    """That module"""

    @property
    def state(self) -> str:
        """What changes whenever its effects may."""
        return f"{self.name} {self.digest}"


@dataclass(frozen=True)
class UserEffects:
    """User-defined effects, and the files and packages that define them."""

    effects: tuple[Effect, ...] = ()
    files: Mapping[Path, YamlFile] = field(default_factory=dict)
    """By their paths, as they were read"""
    project: Path | None = None
    """The project file, if it names one of the files"""
    packages: Mapping[str, Package] = field(default_factory=dict)
    """By the name of the effect, for those of packages"""
    sought: tuple[Path, ...] = ()
    """Where a project file was sought that may name one of the files: the nearest first, up to the one that was read"""


@dataclass(frozen=True)
class Defining:
    """What definitions need to be read: the places where effects can act, and the files that were read before."""

    kind: str
    job: Path
    places: Callable[[], tuple[Acting, ...]]
    """With the further columns of the data as variables; files are looked at only if something is defined"""
    files: YamlFiles
    named: Collection[str] = ()
    """Effects that the job or the command line names: the data must have their columns"""


def own_effects(heading: Heading, given: Defining, faults: list[Fault]) -> UserEffects:
    """Return the effects for a job: its definitions, those of its file and its project, and of packages.

    Appends a fault for each mistake, with its place.
    """
    kind = given.kind
    taken = {effect.name for effect in tasks.KINDS[kind].task().effects}
    defined: list[Effect] = []
    files: dict[Path, YamlFile] = {}
    packages: dict[str, Package] = {}
    for effect, package in with_packages(kind):
        packages[effect.name] = package
        if effect.name in taken:
            faults.append(Fault(f"a package offers an effect '{effect.name}', which exists already"))
        taken.add(effect.name)
        defined.append(effect)
    sought = tuple(_project_files_above(given.job.parent))
    by_project = _of_project(sought[-1], given.files)
    for node in filter(None, (heading.effects_from, by_project)):
        path = path_beside(node)
        if path.resolve() in {file.resolve() for file in files}:
            continue
        effects = of_file(path, given, taken, faults, node)
        with suppress(InputError):  # which is among the faults by now
            files[path] = given.files.read(path)
        taken |= {effect.name for effect in effects}
        defined += effects
    if heading.define:
        defined += read(heading.define, given.places(), taken, faults)
    project = None if by_project is None else by_project.source.folder / PROJECT_FILE
    return UserEffects(tuple(defined), files, project, packages, sought)


def of_project(folder: Path, read_before: YamlFiles) -> Node | None:
    """Return the node of `effects_from` in the nearest metrocli.yaml above a folder, or None."""
    *_, place = _project_files_above(folder)
    return _of_project(place, read_before)


def _of_project(place: Path, read_before: YamlFiles) -> Node | None:
    if not place.is_file():
        return None
    try:
        root = read_before.root(place)
    except InputError:
        # the faults of a project are reported where it is used
        return None
    node = root.get("effects_from") if root.get("jobs") is not None else None
    return None if node is None or node.empty or node.kind != "scalar" else node


def _project_files_above(folder: Path) -> Iterator[Path]:
    """Yield where a project file of a folder may be, the nearest first, up to the first that there is."""
    here = folder.absolute()
    for parent in (here, *here.parents):
        yield parent / PROJECT_FILE
        if (parent / PROJECT_FILE).is_file():
            return


def of_file(
    path: Path, given: Defining, taken: Iterable[str], faults: list[Fault], named: Node | None = None
) -> list[Effect]:
    """Return the effects that a file defines for a kind; those that only fit other kinds are left out.

    `named` names the file. An effect that needs columns which the data lack is there with what it lacks, unless the job
    names it: then it is a fault.
    """
    if not path.is_file():
        message, hint = f"effects_from: no such file: {path}", "a file with effects under `define:`"
        faults.append(named.fault(message, hint) if named is not None else Fault(message, str(path), hint=hint))
        return []
    try:
        root = given.files.root(path)
    except InputError as error:
        faults.extend(error.faults)
        return []
    define = root.get(_KEY)
    for key, _ in root.entries:
        if key.text != _KEY:
            faults.append(key.fault(f"unknown key '{key.text}'", suggestion(key.text, [_KEY])))
    if define is None or define.kind != "list":
        faults.append((define or root).fault("there is no list `define:`", "write define: [{name: ...}, ...]"))
        return []
    names, defined = set(taken), list[Effect]()
    for node in define.items:
        effects = _of_node(node, given, names, faults)
        names |= {effect.name for effect in effects}
        defined += effects
    return defined


def _of_node(node: Node, given: Defining, taken: Iterable[str], faults: list[Fault]) -> list[Effect]:
    """Return the effect of a definition in a file for many jobs, none if it only fits other kinds."""
    wrong: list[Fault] = []
    effects = read([node], given.places(), taken, wrong, given.named.__contains__)
    if not wrong and not any(effect.lacks for effect in effects):
        return effects
    here = _fit(given.kind, node)
    if here is not DefinitionFit.WHOLE and max(_fit(kind, node) for kind in tasks.KINDS if kind != given.kind) > here:
        return []
    faults.extend(wrong)
    return effects


class DefinitionFit(IntEnum):
    """How a definition fits a kind of job."""

    NONE = 0
    WITH_COLUMNS = 1
    """In jobs whose data have further columns"""
    WHOLE = 2


def _fit(kind: str, node: Node) -> DefinitionFit:
    """Return how a definition fits a kind of job, where its name exists already or not."""
    wrong: list[Fault] = []
    effects = read([node], tasks.KINDS[kind].task().places, (), wrong, lambda name: False)
    if wrong or not effects:
        return DefinitionFit.NONE
    return DefinitionFit.WITH_COLUMNS if any(effect.lacks for effect in effects) else DefinitionFit.WHOLE


@cache
def _offered() -> tuple[tuple[str, EntryPoint], ...]:
    if not any(map(_may_offer, sys.path)):
        return ()
    from importlib.metadata import entry_points  # takes longer to load than to look whether it is needed

    return tuple((point.name, point) for point in entry_points(group=ENTRY_POINTS))


def _may_offer(place: str) -> bool:
    """Whether a package in a folder of the module search path may offer effects; always for an archive."""
    folder = Path(place)
    stated = folder.glob("*-info/entry_points.txt")
    return folder.is_file() or any(ENTRY_POINTS in path.read_text(errors="replace") for path in stated)


def of_packages(kind: str) -> Iterator[Effect]:
    """Yield the effects that installed packages offer for a kind; raises InputError if one cannot be loaded."""
    return (effect for effect, _ in with_packages(kind))


def with_packages(kind: str) -> Iterator[tuple[Effect, Package]]:
    """Yield the effects of packages as `of_packages`, each with its package."""
    for name, point in _offered():
        try:
            offered = point.load()
            package = _package(point)
            yield from ((effect, package) for effect in offered(kind))
        except Exception as error:
            text = f"the effects of the package entry '{name}' cannot be loaded: {error}"
            raise InputError([Fault(text, ENTRY_POINTS, hint="uninstall the package, or correct it")]) from error


@cache
def _package(point: EntryPoint) -> Package:
    """Return the package of an entry point that is loaded."""
    # a package that is installed to be edited keeps its version, hence the text of the module, too
    place = getattr(sys.modules[point.module], "__file__", None)
    version = f"{point.dist.name} {point.dist.version}" if point.dist is not None else point.value
    file = Path(place) if place is not None and Path(place).is_file() else None
    return Package(version, read_bytes(file).sha256 if file is not None else "", file)


def alike_for(used: Iterable[tuple[str, Collection[str]]]) -> Callable[[], str] | None:
    """Return what states the packages behind effects in words wherever it is called, None if there are none.

    `used` has a kind of job with names of effects. Other computers that compute such jobs need the same packages.
    """
    effects = sorted({(kind, name) for kind, names in used for name in names})
    return partial(_in_words, effects) if effects else None


def _in_words(effects: Iterable[tuple[str, str]]) -> str:
    words = []
    for kind, name in effects:
        package = {effect.name: package for effect, package in with_packages(kind)}.get(name)
        module = f" (module {package.digest[:8]})" if package is not None and package.digest else ""
        words.append(f"no package with the effect '{name}'" if package is None else f"{package.name}{module}")
    return listed(list(dict.fromkeys(words)))
