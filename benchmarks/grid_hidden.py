"""Hidden effects in views of a ball grid: how often `diagnose` names what is in the readings, and what is not.

Cases are seeded and simulated by plain formulas (benchmarks/hidden/grids.py), N = 5, with four and six views. Sizes are
multiples of the least size that is found with 80 % power.

    python -m benchmarks grid_hidden [COUNT]
"""

from __future__ import annotations

import sys

from benchmarks.hidden import grids, rates

COUNT = 200


def main(arguments: list[str]) -> int:
    """Print the rates; return 1 where a bar is not met."""
    count = int(arguments[0]) if arguments else COUNT
    print(f"-- selfcal-grid, {count} cases", flush=True)
    return 0 if rates.print_rates([rates.found(case) for case in grids.cases(count)]) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
