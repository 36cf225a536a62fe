"""Projects that never lie: changes, damages, kills, hard edges, a cluster, and the cost of having nothing to do.

python -m benchmarks pipeline [seed N | changes N | damages N | kills N | edges 1 | cluster N | overhead N |
    trials MILLIONS | shared MILLIONS | diagnosis 1 | idle N | campaign N ...]

The seed is that of the changes, damages and kills that follow it; without, 0.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks.projects.hard_ends import NOT_TRIED, edges, kills
from benchmarks.projects.many_jobs import NO_MEMO, ONE_TO_DO, OTHERS, bound, idle, idle_campaign
from benchmarks.projects.on_cluster import cluster_runs, diagnosis_on_cluster, overhead, shared_trials, trials_overhead
from benchmarks.projects.six_jobs import changes, damages

FULL = (
    ("changes", 1000), ("damages", 2000), ("kills", 200), ("edges", 1), ("cluster", 200), ("overhead", 200),
    ("trials", 200), ("shared", 200), ("diagnosis", 1),
    ("idle", 50), ("idle", 1000), ("idle", 10_000), ("campaign", 10_000),
)  # fmt: skip
Line = tuple[str, bool]
"""What to print, and whether anything lied"""


def of_changes(count: int, seed: int) -> Iterator[Line]:
    """Yield the line of the random changes."""
    wrong, needless, other = changes(count, seed)
    text = f"{count} changes: {wrong} wrongly up to date, {needless} needless, {other} dry runs unlike the run"
    yield text, bool(wrong or needless or other)


def of_damages(count: int, seed: int) -> Iterator[Line]:
    """Yield the line of the damaged bits."""
    believed, not_healed, longest = damages(count, seed)
    text = f"{count} damaged bits: {believed} believed, {not_healed} not healed, {longest:.2f} s CPU at most"
    yield text, bool(believed or not_healed)


def of_kills(count: int, seed: int) -> Iterator[Line]:
    """Yield a line after every twentieth kill and after the last."""
    for found in kills(count, seed):
        if found.tried % 20 and found.tried != count:
            continue
        text = f"{found.tried} kills, {found.within} between the first result and the last:"
        yield (
            f"{text} {found.unreadable} with unreadable results, {found.lost} with finished results lost or made "
            f"again, {found.left} with leftovers, work by hand or other results",
            bool(found.unreadable or found.lost or found.left),
        )


def of_edges(_: int) -> Iterator[Line]:
    """Yield a line for each hard edge."""
    for name, wrong in edges():
        yield f"{name}: {wrong or 'as it should be'}", bool(wrong) and not wrong.startswith(NOT_TRIED)


def of_cluster(count: int) -> Iterator[Line]:
    """Yield a line for each run on the cluster."""
    for name, wrong in cluster_runs(count):
        yield f"cluster, {name}: {wrong or 'the same results as here'}", bool(wrong) and not wrong.startswith(NOT_TRIED)


def of_overhead(count: int) -> Iterator[Line]:
    """Yield the line of what a cluster costs beside the jobs."""
    here, there, begun_here, begun_there = overhead(count)
    text = f"{count} jobs, CPU of all processes: {here:.1f} ms each here, {there:.1f} ms each on two workers"
    text += f" ({there / here - 1:+.1%}); {begun_here:.0f} and {begun_there:.0f} ms beside the jobs"
    yield text, there > 1.05 * here


def of_trials(millions: int) -> Iterator[Line]:
    """Yield the line of one large Monte Carlo job on a cluster of one worker."""
    here, there, wrong = trials_overhead(millions)
    text = f"{millions} million trials of one job, CPU of all processes: {here:.2f} s here, {there:.2f} s on one worker"
    yield f"{text} ({there / here - 1:+.1%}), {wrong or 'the same result'}", bool(wrong) or there > 1.05 * here


def of_shared(millions: int) -> Iterator[Line]:
    """Yield the line of a project of one large Monte Carlo job on a cluster of two workers."""
    workers, wrong = shared_trials(millions)
    share = min(workers) / sum(workers)
    spent = " and ".join(f"{one:.1f} s" for one in workers)
    text = (
        f"{millions} million trials of one job of a project, CPU of two workers: {spent}, {wrong or 'the same result'}"
    )
    yield text, bool(wrong) or share < 0.3


def of_diagnosis(_: int) -> Iterator[Line]:
    """Yield a line for each diagnosis whose folds go to a cluster."""
    for name, wrong in diagnosis_on_cluster():
        yield f"cluster, {name}: {wrong or 'the same diagnosis'}", bool(wrong)


def of_idle(count: int) -> Iterator[Line]:
    """Yield the line of the runs with nothing to do."""
    found = idle(count)
    yield f"{count} jobs, CPU: {_times(found)}", _too_long(found, count)


def of_campaign(count: int) -> Iterator[Line]:
    """Yield the line of the runs of a campaign with nothing to do."""
    found = idle_campaign(count)
    yield f"{count} parts of one job, CPU: {_times(found)}", _too_long(found, count)


def _too_long(found: dict[str, float | str], count: int) -> bool:
    held = (one for name, one in found.items() if name not in (ONE_TO_DO, NO_MEMO, *OTHERS))
    return any(not isinstance(one, str) and one > bound(count) for one in held)


def _times(found: dict[str, float | str]) -> str:
    return ", ".join(f"{name} {one if isinstance(one, str) else f'{one:.0f} ms'}" for name, one in found.items())


SEEDED: dict[str, Callable[[int, int], Iterator[Line]]] = {
    "changes": of_changes,
    "damages": of_damages,
    "kills": of_kills,
}
CAMPAIGNS: dict[str, Callable[[int], Iterator[Line]]] = {
    "edges": of_edges,
    "cluster": of_cluster,
    "overhead": of_overhead,
    "trials": of_trials,
    "shared": of_shared,
    "diagnosis": of_diagnosis,
    "idle": of_idle,
    "campaign": of_campaign,
}


def main(wanted: list[str]) -> int:
    """Print the lines of each campaign, each in a new working folder; return 1 if anything lied."""
    pairs = list(zip(wanted[::2], map(int, wanted[1::2]), strict=True)) or FULL
    here, failed, seed = Path.cwd(), False, 0
    for name, count in pairs:
        if name == "seed":
            seed = count
            continue
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            try:
                for text, wrong in SEEDED[name](count, seed) if name in SEEDED else CAMPAIGNS[name](count):
                    print(text, flush=True)
                    failed |= wrong
            finally:
                os.chdir(here)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
