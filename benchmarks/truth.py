"""What the program states, compared with what is true: each campaign in one table, each row with its bar.

    python -m benchmarks truth [COUNT] [CAMPAIGN ...]     # 120 cases of each campaign unless given (make bench-truth)
    python -m benchmarks truth 60 "simulated, six-dof"    # one campaign; the other rows of the table stay

Each campaign is a benchmark of its own, with a truth of its own: simulations by plain formulas that share nothing with
the solver, effects planted into real measurements, halves of real sets, one board seen by four cameras, published
values. Its table enters docs/benchmarks.md as soon as it ends. Data of ../shared that are absent
leave their rows out.
"""

from __future__ import annotations

import fnmatch
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime

from benchmarks.bars import Rate
from benchmarks.hidden_effects import KINDS
from benchmarks.peers import PAGE, ROOT, TRUTH

FIRST = 1_000_000
"""First number of the simulated cases, which no price was set on"""
PUBLISHED = {
    "uncertainty: JCGM 100, 101, 102, 106, NIST and others": "tests/tasks/report_uncertainty/test_references.py",
    "files of people, with what is right": "tests/people",
}
"""Published values, and the tests that compare with them"""
PUBLISHED_VALUES = "published values"
"""Title of their campaign"""
HEAD = ["| | cases | result [95 %] | bar | |", "|---|---|---|---|---|"]
ABOUT = (
    "Each table is of one campaign of `make bench-truth`, measured on the day in its heading. A share is `too few` "
    "where it is beyond its bar and its interval reaches it."
)
SECTION = re.compile(r"^### (.+) \((\d{4}-\d\d-\d\d)\)$", re.MULTILINE)
"""Heading of a campaign: its title, and the day on which it was measured"""


def campaigns(count: int) -> dict[str, list[str]]:
    """Return the arguments of the benchmark for each campaign of so many cases."""
    few = max(count // 5, 4)
    return {
        **{f"simulated, {kind}": ["hidden_effects", kind, f"{FIRST}-{FIRST + count - 1}"] for kind in KINDS},
        "simulated networks": ["hidden_in_networks", str(count)],
        "simulated rotary axes": ["hidden_in_rotary_axes", f"{FIRST}-{FIRST + count - 1}"],
        "lens shapes": ["lens_shapes", f"{FIRST}-{FIRST + few - 1}"],
        "splined lenses beside mrcal": ["splines"],
        "laws of no catalogue": ["random_laws", f"{FIRST}-{FIRST + few - 1}"],
        "beside realistic rest": ["smooth_rest", str(few)],
        "planted in real measurements": ["real_causes"],
        "planted in parts of real boards": ["real_causes", "parts", "4"],
        "series, drifts and shapes planted in real images": ["real_states"],
        "detectable and hidden sizes": ["stated_sizes", f"{FIRST}-{FIRST + max(count // 12, 4)}"],
        "mistakes in files of networks": ["network_mistakes", str(max(count // 10, 4))],
        "honesty of networks": ["networks", "100"],
        "honesty of rotary axes": ["rotary_axes", "honesty", "100"],
        "honesty of several cameras": ["rigs", "simulated", "100"],
        "several cameras beside OpenCV": ["rigs", "opencv"],
        "halves of several cameras": ["rigs", "halves", "20"],
        "halves of real sets": ["halves", "20", "100"],
        "one camera beside OpenCV, published network": ["references"],
        "one board": ["one_board"],
    }


def rows(title: str, arguments: list[str]) -> Iterator[str]:
    """Run a campaign and yield the rows of the table: lines that end with the verdict on a bar."""
    call = [sys.executable, "-m", f"benchmarks.{arguments[0]}", *arguments[1:]]
    done = subprocess.run(call, check=False, capture_output=True, text=True, cwd=ROOT)
    count, section = 0, ""
    for line in done.stdout.splitlines():
        fields = re.split(r"\s{2,}", line.strip())
        if line.startswith("-- "):
            section = line.removeprefix("-- ").rpartition(",")[0].removeprefix(title.rpartition(", ")[2])
        elif len(fields) == 5 and fields[-1] in ("met", "NOT MET", "too few"):
            yield " | ".join([f"{section}: {fields[0]}" if section else fields[0], *fields[1:]])
            count += 1
    if done.returncode and not count:
        yield f"failed: {(done.stderr.strip().splitlines() or ['no message'])[-1]} | | | |"


def published() -> Iterator[str]:
    """Yield how many published values come out, by the tests that compare with them."""
    for what, tests in PUBLISHED.items():
        call = [sys.executable, "-m", "pytest", "--no-header", "-p", "no:cacheprovider", tests]
        last = subprocess.run(call, check=False, capture_output=True, text=True, cwd=ROOT).stdout.splitlines()[-1]
        counts = {word: int(number) for number, word in re.findall(r"(\d+) (passed|failed|error)", last)}
        if counts:
            yield " | ".join(re.split(r"\s{2,}", str(Rate(what, counts.get("passed", 0), sum(counts.values()), 1.0))))


def written(title: str, lines: list[str], day: str) -> None:
    """Put the table of a campaign in place of the one that the page has of it, or at the end."""
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(TRUTH)
    _, *parts = SECTION.split(rest)
    sections = {old: (then, body.strip()) for old, then, body in zip(*[iter(parts)] * 3, strict=True)}
    sections[title] = day, "\n".join([*HEAD, *lines])
    order = [*campaigns(0), PUBLISHED_VALUES]
    tables = ["### {} ({})\n\n{}\n".format(one, *sections[one]) for one in order if one in sections]
    PAGE.write_text("\n".join([head + TRUTH, "", ABOUT, "", *tables]), encoding="utf-8")


def main(arguments: list[str]) -> int:
    """Print the table and write it into the page; return 1 where a bar is not met, 2 for an unknown campaign."""
    numbers = [word for word in arguments if word.isdecimal()]
    asked = [word for word in arguments if not word.isdecimal()] or ["*"]
    calls = {**campaigns(int(numbers[0]) if numbers else 120), PUBLISHED_VALUES: []}
    chosen = [title for title in calls if any(fnmatch.fnmatch(title, word) for word in asked)]
    if not chosen:
        print(f"no campaign {' or '.join(asked)}; there are: {'; '.join(calls)}")
        return 2
    met = True
    for title in chosen:
        begin = time.monotonic()
        day = f"{datetime.now(UTC):%Y-%m-%d}"
        found = rows(title, calls[title]) if calls[title] else published()
        lines = [f"| {row} |" for row in found]
        written(title, lines, day)
        print("\n".join([f"### {title}", "", *HEAD, *lines, ""]), flush=True)
        print(f"{title}: {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)
        met &= not any("NOT MET" in line or "| failed" in line for line in lines)
    return int(not met)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
