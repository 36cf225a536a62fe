"""Run one function of this folder once, and print its CPU seconds, peak memory [MB] and values as JSON.

python -m benchmarks.beside.work MODULE FUNCTION SIZE
"""

from __future__ import annotations

import importlib
import json
import resource
import sys
import time
from collections.abc import Callable

Values = list[tuple[float, float]]
Work = Callable[[], Values]


def spent() -> float:
    """Return the CPU seconds of this process and of those that it has begun and seen end."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def main() -> None:
    """Prepare, run and print."""
    module, name, size = sys.argv[1:]
    work: Work = getattr(importlib.import_module(f"benchmarks.beside.{module}"), name)(int(size))
    before = spent()
    values = work()
    peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(json.dumps({"seconds": spent() - before, "megabytes": peak / 1024, "values": values}))


if __name__ == "__main__":
    main()
