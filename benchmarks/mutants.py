"""python -m benchmarks mutants [SEED [LINES]]: change random lines of the program one at a time; its tests should fail.

Of each area, LINES random lines that hold something to change: an operator, a comparison, a number, a choice, a
transposition, a named argument, or a whole statement. Texts, annotations, decorators and docstrings stay.
Each changed line stands in a copy of the project, whose tests run until the first one fails: first those of the area.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from benchmarks.projects.code_changes import Change, changes_of

ROOT = Path(__file__).parents[1]
AREAS = {"engine": "adjust", "diagnosis": "diagnosis", "formats": "formats"}
SEED, LINES, SHARE = 20, 10, 0.9
AT_ONCE = 2
NOT_COPIED = shutil.ignore_patterns(".*", "__pycache__", "demo", "build")
LONGEST = 300
"""Seconds after which a test counts as one that does not end"""


def drawn(area: str, lines: int, chance: random.Random) -> list[Change]:
    """Draw lines of an area among those that hold something to change, and one change of each."""
    by_line: dict[tuple[Path, int], list[Change]] = {}
    for path in sorted((ROOT / "metrocli" / AREAS[area]).rglob("*.py")):
        for change in changes_of(path):
            by_line.setdefault((path, change.line), []).append(change)
    return [chance.choice(by_line[line]) for line in chance.sample(sorted(by_line), lines)]


def tested(copy: Path, tests: Sequence[str]) -> str:
    """Run tests in a copy until one fails; return its name, empty if none does."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "--tb=no", "-rfE"]
    command += [f"--basetemp={copy.parent / 'temporary'}", "-o", f"faulthandler_timeout={LONGEST}", *tests]
    env = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=copy, env=env, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    failed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR "))]
    return failed[0] if failed else "a test that does not end"


def found_by(area: str, change: Change | None) -> str:
    """Return the first test that fails with a change, empty if all pass."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        shutil.copytree(ROOT, copy, ignore=NOT_COPIED)
        if change:
            (copy / change.path.relative_to(ROOT)).write_text(change.applied(), encoding="utf-8")
        own = f"tests/{AREAS[area]}"
        return tested(copy, [own]) or tested(copy, ["tests", f"--ignore={own}"])


def main(seed: int = SEED, lines: int = LINES) -> int:
    """Print a table of the changes and what found them; return 1 if too few are found or the project itself fails."""
    chance = random.Random(seed)
    wanted = [(area, change) for area in AREAS for change in drawn(area, lines, chance)]
    print(f"seed {seed}: {lines} lines of each of {', '.join(AREAS)}")
    with ThreadPoolExecutor(AT_ONCE) as pool:
        unchanged = pool.submit(found_by, "engine", None)
        tests = [pool.submit(found_by, *one) for one in wanted]
        for (area, change), test in zip(wanted, tests, strict=True):
            place = f"{change.path.relative_to(ROOT)}:{change.line}"
            print(f"{area}  {place}  {change.words}\n    {test.result() or 'NOT FOUND'}", flush=True)
    count = sum(bool(test.result()) for test in tests)
    print(f"found {count} of {len(wanted)}, wanted {SHARE:.0%}; unchanged: {unchanged.result() or 'all tests pass'}")
    return int(count < SHARE * len(wanted) or bool(unchanged.result()))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
