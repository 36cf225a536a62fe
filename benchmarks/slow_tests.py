"""python -m benchmarks slow_tests [WORDS OF PYTEST]: the tests marked `slow`, which `make test` leaves out.

Whole diagnoses, coverage of intervals and walks through many cases. They confirm with many cases, or large ones, what a
short test shows with one.

    python -m benchmarks slow_tests tests/diagnosis -k hidden
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main(words: list[str]) -> int:
    """Run them in two processes, unless the words of pytest state another number."""
    command = [sys.executable, "-m", "pytest", "-m", "slow", "-n", "2", "--durations=10", *words]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
