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
    {"exports", "plots"},
    {"tasks"},
    {"diagnosis", "uncertainty"},
    {"simulate"},
    {"effects"},
    {"instruments", "targets"},
    {"formats"},
    {"adjust"},
    {"geometry"},
    {"imageset", "result", "record", "simulation", "plan", "nc_program"},
    {"settings"},
    {"table"},
    {"units", "nodes", "words"},
    {"errors"},
    {"__init__"},
]
"""From the top down; parts in one layer do not import each other."""
LEVEL = {part: n for n, layer in enumerate(LAYERS) for part in layer}
ALLOWED_WITHIN = {("__main__", "cli"), ("simulation", "imageset"), ("result", "record"), ("plan", "result")}
NOT_FORMATS = {"exports", "plots", "tasks", "diagnosis", "uncertainty", "simulate", "instruments", "effects", "targets"}
ONLY_IN = {
    "h5py": {"formats"},
    "yaml": {"project"},
    "click": {"cli"},
    "cv2": {"targets", "formats/images"},
    "matplotlib": {"plots"},
    "distributed": {"uncertainty"},
}
FORBIDDEN = {"scipy.stats": "slow to import; scipy.special has the distributions"}
VAGUE = {"utils", "util", "helpers", "helper", "common", "core", "base", "manager", "misc", "tools"}
MODULES = sorted(ROOT.rglob("*.py"))


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
