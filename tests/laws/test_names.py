"""A class name occurs once, so that a search or a signature leads to one class."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2] / "metrocli"
OF_EACH_KIND = {"Settings", "Files"}
"""Names by which each kind of job offers its own"""


def classes() -> dict[str, list[str]]:
    places: dict[str, list[str]] = defaultdict(list)
    for path in sorted(ROOT.rglob("*.py")):
        for name in re.findall(r"^ *class (\w+)[(:]", path.read_text(encoding="utf-8"), re.MULTILINE):
            places[name].append(str(path.relative_to(ROOT)))
    return places


def test_a_class_name_occurs_once() -> None:
    twice = {name: where for name, where in classes().items() if len(where) > 1 and name not in OF_EACH_KIND}
    assert not twice, twice
