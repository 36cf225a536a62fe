"""python -m benchmarks [NAME ...]: run the benchmarks of this folder one after the other, each in its own process.

What follows a single name, and is not a name, is given to it: python -m benchmarks hidden_effects multilaterate 200
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main(wanted: list[str]) -> int:
    """Run the named benchmarks, or all; return 1 if one fails."""
    names = [path.stem for path in sorted(HERE.glob("*.py")) if not path.stem.startswith("__")]
    more = [word for word in wanted[1:] if word not in names] if wanted and wanted[0] in names else []
    wanted = [word for word in wanted if word not in more]
    unknown = set(wanted) - set(names)
    if unknown:
        print(f"no benchmark {', '.join(sorted(unknown))}; there are: {', '.join(names)}", file=sys.stderr)
        return 2
    failed = False
    for name in wanted or names:
        print(f"== {name}", flush=True)
        failed |= subprocess.run([sys.executable, "-m", f"benchmarks.{name}", *more], check=False).returncode != 0
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
