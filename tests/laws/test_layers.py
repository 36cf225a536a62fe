"""Who may import whom: downwards only, and each library in its own place."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
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
    {"arrays"},
    {"__init__"},
]
"""From the top down; parts in one layer do not import each other."""
LEVEL = {part: n for n, layer in enumerate(LAYERS) for part in layer}
ALLOWED_WITHIN = {("__main__", "cli"), ("simulation", "imageset"), ("result", "record"), ("plan", "result")}
NOT_FORMATS = {"exports", "plots", "report", "tasks", "diagnosis", "uncertainty", "instruments", "effects", "targets"}
NOT_KINDS = {"__init__", "job", "kind", "shared"}
"""In `tasks`: what is not a kind of job"""
INSIDE = {
    "report": [{"result_page", "project_page"}, {"*"}, {"content", "html"}],
    "plots": [{"context"}, {"*"}, {"plotted_points", "readings", "style"}, {"noise_bands", "thinning", "magnify"}],
    "adjust": [{"coupled_fields", "rounds"}, {"robust", "dense_jacobian"}, {"adjustment"}, {"*"}, {"model"}],
    "effects": [{"own"}, {"links"}, {"*"}],
    "diagnosis": [
        {"verdict", "job_entries", "next_readings"},
        {"diagnose"},
        {"confirmation"},
        {"explanations"},
        {"findings"},
        {"laws"},
        {"*"},
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


IMPORT = re.compile(r"^ *((?:from +[\w.]+ +import +(?:\([^)]*\)|[^(\n]+))|import +[\w.]+[^\n]*)$", re.MULTILINE)


@cache
def imports(path: Path) -> list[str]:
    """Return the full names of what a module imports, wherever in it the import stands."""
    found = []
    # to parse whole modules takes seconds
    statements = "\n".join(one[1] for one in IMPORT.finditer(path.read_text(encoding="utf-8")))
    for node in ast.parse(statements).body:
        if isinstance(node, ast.Import):
            found += [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [f"{node.module}.{name.name}" for name in node.names]
    return found


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def wrong_imports(path: Path) -> Iterator[str]:
    """What a module imports from its own layer or from above, or files where tasks are pure."""
    here = part_of(path)
    for name in imports(path):
        if not name.startswith("metrocli."):
            continue
        there = name.split(".")[1]
        there = there if there in LEVEL else "__init__"
        inside = there == here or (here, there) in ALLOWED_WITHIN
        if not (inside or LEVEL[there] > LEVEL[here]) or (there == "formats" and here in NOT_FORMATS):
            yield f"{named(path)} imports {name}"


def test_each_part_has_a_layer() -> None:
    assert {part_of(path) for path in MODULES} <= set(LEVEL)


def test_imports_go_downwards() -> None:
    assert not [wrong for path in MODULES for wrong in wrong_imports(path)]


def test_no_module_imports_itself_in_a_circle() -> None:
    """Also inside functions, and also over several modules."""
    graph = {name: imported_modules(path) for name, path in NAMES.items()}
    open_names, done = set(graph), set[str]()
    while ready := {name for name in open_names if graph[name] - {name} <= done}:
        done |= ready
        open_names -= ready
    assert not open_names, f"circles among {sorted(open_names)}"


def other_kinds(path: Path) -> Iterator[str]:
    """What a module of a kind imports from other kinds."""
    own = path.relative_to(ROOT / "tasks").parts[0].removesuffix(".py")
    for name in imported_modules(path):
        parts = name.split(".")
        if parts[:2] == ["metrocli", "tasks"] and len(parts) > 2 and parts[2] not in {own, *NOT_KINDS} - {"__init__"}:
            yield f"{named(path)} imports {name}"


def test_no_kind_imports_another() -> None:
    assert not [wrong for path in sorted((ROOT / "tasks").rglob("*.py")) for wrong in other_kinds(path)]


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


def test_no_folder_is_crowded() -> None:
    folders = Counter(path.parent for path in MODULES)
    assert not {named(folder): modules for folder, modules in folders.items() if modules > MOST_MODULES}


def test_no_module_is_long() -> None:
    lines = {named(path): len(path.read_text(encoding="utf-8").splitlines()) for path in MODULES}
    assert not {name: length for name, length in lines.items() if length > MOST_LINES}


def misplaced_libraries(path: Path) -> Iterator[str]:
    places = {part_of(path), named(path).removesuffix(".py")}
    for name in imports(path):
        library = name.split(".")[0]
        if library in ONLY_IN and not places & ONLY_IN[library]:
            yield f"{named(path)} imports {library}"
        if any(name.startswith(module) for module in FORBIDDEN):
            yield f"{named(path)} imports {name}"


def test_each_library_has_its_place() -> None:
    assert not [wrong for path in MODULES for wrong in misplaced_libraries(path)]


def test_names_say_something() -> None:
    assert not [named(path) for path in MODULES if path.stem in VAGUE]


def test_offenders_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    (tmp_path / "table.py").write_text("def f():\n    from metrocli.cli import main\n    import scipy.stats, h5py\n")
    assert imports(tmp_path / "table.py") == ["metrocli.cli.main", "scipy.stats", "h5py"]
    assert list(wrong_imports(tmp_path / "table.py")) == ["table.py imports metrocli.cli.main"]
    assert list(misplaced_libraries(tmp_path / "table.py")) == ["table.py imports scipy.stats", "table.py imports h5py"]
    kind = tmp_path / "tasks/align_part"
    kind.mkdir(parents=True)
    (kind / "task.py").write_text("from metrocli.tasks.selfcal_grid import task\nfrom metrocli.tasks import kind\n")
    assert list(other_kinds(kind / "task.py")) == ["tasks/align_part/task.py imports metrocli.tasks.selfcal_grid.task"]
