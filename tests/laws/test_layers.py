"""Who may import whom: downwards only, and each library in its own place."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import metrocli

ROOT = Path(metrocli.__file__).parent
LAYERS = [
    {"cli", "__main__"},
    {"project"},
    {"exports", "imports", "report"},
    {"plots"},
    {"tasks"},
    {"diagnosis", "uncertainty"},
    {"effects"},
    {"instruments", "targets"},
    {"formats"},
    {"adjust"},
    {"geometry", "expressions"},
    {"doubt"},
    {"imageset", "result", "record", "simulation", "plan", "nc_program"},
    {"settings"},
    {"copies"},
    {"table"},
    {"units", "nodes", "words", "progress"},
    {"errors"},
    {"frozen"},
    {"__init__"},
]
"""From the top down; parts in one layer do not import each other."""
LEVEL = {part: n for n, layer in enumerate(LAYERS) for part in layer}
ALLOWED_WITHIN = {("__main__", "cli"), ("simulation", "imageset"), ("result", "record"), ("plan", "result")}
NOT_FORMATS = {"exports", "plots", "report", "tasks", "diagnosis", "uncertainty", "instruments", "effects", "targets"}
NOT_KINDS = {"__init__", "job", "kind", "shared"}
"""In `tasks`: what is no kind of job"""
INSIDE = {
    "report": [{"result_page", "project_page"}, {"*"}, {"content", "html"}],
    "plots": [{"beside"}, {"*"}, {"readings", "places", "style"}, {"noise_bands", "thinning", "magnify"}],
    "adjust": [{"coupled_fields", "rounds"}, {"robust", "dense_jacobian"}, {"adjustment"}, {"*"}, {"model"}],
    "effects": [{"own"}, {"links"}, {"*"}],
    "diagnosis": [
        {"verdict", "job_entries", "next_readings"},
        {"diagnose"},
        {"findings"},
        {"laws"},
        {"*"},
        {"selection"},
        {"linear"},
        {"adjusted_job"},
    ],
}
"""Layers inside packages, from the top down; * is all that is not named"""
MOST_MODULES, MOST_LINES = 20, 300
ONLY_IN = {
    "h5py": {"formats"},
    "yaml": {"project"},
    "click": {"cli"},
    "cv2": {"targets", "formats/images"},
    "distributed": {"uncertainty"},
    "matplotlib": {"plots"},
    "trimesh": {"formats"},
}
FORBIDDEN = {"scipy.stats": "slow to import; scipy.special has the distributions"}
VAGUE = {"utils", "util", "helpers", "helper", "common", "core", "base", "manager", "misc", "tools"}
MODULES = sorted(ROOT.rglob("*.py"))


def module_of(path: Path) -> str:
    """The full name of a module."""
    name = ".".join(path.relative_to(ROOT.parent).with_suffix("").parts)
    return name.removesuffix(".__init__")


NAMES = {module_of(path): path for path in MODULES}


def imported_modules(path: Path) -> set[str]:
    """The modules of the program that a module imports."""
    names = (name for name in imports(path) if name.startswith("metrocli"))
    return {name if name in NAMES else name.rpartition(".")[0] for name in names} & set(NAMES)


def part_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imports(path: Path) -> Iterator[str]:
    """Yield the full names of what a module imports, wherever in it the import stands."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{name.name}" for name in node.names)


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("path", MODULES, ids=named)
def test_imports_go_downwards(path: Path) -> None:
    here = part_of(path)
    assert here in LEVEL, f"{here} has no layer"
    for name in imports(path):
        if not name.startswith("metrocli."):
            continue
        there = name.split(".")[1]
        if there not in LEVEL:
            there = "__init__"
        inside = there == here or (here, there) in ALLOWED_WITHIN
        assert inside or LEVEL[there] > LEVEL[here], f"{here} imports {name}"
        assert there != "formats" or here not in NOT_FORMATS, f"{here} imports {name}: tasks are pure"


def test_no_module_imports_itself_in_a_circle() -> None:
    """Also inside functions, and also over several modules."""
    graph = {name: imported_modules(path) for name, path in NAMES.items()}
    open_names, done = set(graph), set[str]()
    while ready := {name for name in open_names if graph[name] - {name} <= done}:
        done |= ready
        open_names -= ready
    assert not open_names, f"circles among {sorted(open_names)}"


@pytest.mark.parametrize("path", sorted((ROOT / "tasks").rglob("*.py")), ids=named)
def test_no_kind_imports_another(path: Path) -> None:
    own = path.relative_to(ROOT / "tasks").parts[0].removesuffix(".py")
    for name in imported_modules(path):
        parts = name.split(".")
        if parts[:2] == ["metrocli", "tasks"] and len(parts) > 2:
            assert parts[2] == own or parts[2] in NOT_KINDS - {"__init__"}, f"{named(path)} imports {name}"


@pytest.mark.parametrize("package", INSIDE)
def test_imports_inside_a_package_go_downwards(package: str) -> None:
    level = {part: n for n, layer in enumerate(INSIDE[package]) for part in layer}
    for name, path in NAMES.items():
        if not name.startswith(f"metrocli.{package}."):
            continue
        here = name.split(".")[2]
        for other in imported_modules(path):
            there = other.split(".")[2:3]
            if other.startswith(f"metrocli.{package}.") and there != [here]:
                below = level.get(there[0], level["*"]) - level.get(here, level["*"])
                assert below >= 0, f"{name} imports {other}"


@pytest.mark.parametrize("folder", sorted({path.parent for path in MODULES}), ids=named)
def test_no_folder_is_crowded(folder: Path) -> None:
    assert len(list(folder.glob("*.py"))) <= MOST_MODULES


@pytest.mark.parametrize("path", MODULES, ids=named)
def test_no_module_is_long(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= MOST_LINES


@pytest.mark.parametrize("path", MODULES, ids=named)
def test_each_library_has_its_place(path: Path) -> None:
    places = {part_of(path), named(path).removesuffix(".py")}
    for name in imports(path):
        library = name.split(".")[0]
        assert library not in ONLY_IN or places & ONLY_IN[library], f"{named(path)} imports {library}"
        assert not any(name.startswith(module) for module in FORBIDDEN), f"{named(path)} imports {name}"


@pytest.mark.parametrize("path", MODULES, ids=named)
def test_names_say_something(path: Path) -> None:
    assert path.stem not in VAGUE


def test_a_wrong_import_is_found(tmp_path: Path) -> None:
    file = tmp_path / "x.py"
    file.write_text("def f():\n    from metrocli.cli import main\n    import scipy.stats\n")
    assert list(imports(file)) == ["metrocli.cli.main", "scipy.stats"]
