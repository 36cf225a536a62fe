"""What the program states, held against what is true: the rates of the campaigns in one table, each with its bar.

    python -m benchmarks truth [COUNT]        # cases of each campaign, 120 unless given (make bench-truth)

Each campaign is a benchmark of its own, with a truth of its own: simulations by plain formulas that share
nothing with the solver, effects planted into real measurements, halves of real sets, published values. It writes the
second table of docs/benchmarks.md.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from datetime import UTC, datetime

from benchmarks.hidden_effects import KINDS
from benchmarks.peers import PAGE, ROOT, TRUTH

FIRST = 820_000
"""First number of the simulated cases, which no price was set on"""
_RATE = re.compile(r"^(\S.*?)\s{2,}(\d+/\d+)\s+([\d.]+% \[.*?\])\s+(\S.*?)\s+(met|NOT MET)$")
"""What, count, rate with its interval, bar, and whether it is met"""


def campaigns(count: int) -> Iterator[tuple[str, list[str]]]:
    """Yield each campaign, in words, with its benchmark and arguments."""
    for kind in KINDS:
        yield f"simulated, {kind}", ["hidden_effects", kind, f"{FIRST}-{FIRST + count - 1}"]
    yield "beside realistic rest", ["smooth_rest", str(max(count // 5, 4))]
    yield "planted in real measurements", ["real_causes"]
    yield "detectable and hidden sizes", ["stated_sizes", f"{FIRST}-{FIRST + max(count // 12, 4)}"]


def rows(title: str, arguments: list[str]) -> Iterator[str]:
    """Run a campaign and yield the rows of the table."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", *arguments], check=False, capture_output=True, text=True, cwd=ROOT
    )
    found = [match for line in done.stdout.splitlines() if (match := _RATE.match(line))]
    if done.returncode and not found:
        yield f"| {title} | `{' '.join(arguments)}` | failed | | |"
    for match in found:
        yield f"| {title}: {' | '.join(match.groups())} |"


def main(arguments: list[str]) -> int:
    """Print the table and write it into the page; return 1 where a bar is not met."""
    lines = ["| campaign | cases | rate [95 %] | bar | |", "|---|---|---|---|---|"]
    print("\n".join(lines), flush=True)
    for title, call in campaigns(int(arguments[0]) if arguments else 120):
        for row in rows(title, call):
            lines.append(row)
            print(row, flush=True)
    head = PAGE.read_text(encoding="utf-8").partition(TRUTH)[0] + TRUTH
    about = f"Measured {datetime.now(UTC):%Y-%m-%d} by `make bench-truth`."
    PAGE.write_text("\n".join([head, about, "", *lines, ""]), encoding="utf-8")
    return int(any("NOT MET" in line or "failed" in line for line in lines))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
