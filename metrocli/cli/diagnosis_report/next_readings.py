"""The next readings as lines of a report: what to do, what for, and the power before and after."""

from __future__ import annotations

from collections.abc import Iterator

from metrocli.cli.columns import text_table
from metrocli.diagnosis.next_readings.choice import Next

_ENOUGH = 0.95
"""Power above which no further reading is needed"""
_HEAD = ("next reading", "why", "power so far")


def next_lines(proposed: Next) -> Iterator[str]:
    """Yield the table of readings and, for each test, its power without them and with them."""
    if not proposed.aims:
        yield "what to measure next: nothing is indistinct, and no reading made once more would show anything unseen"
        return
    if proposed.readings:
        yield from text_table(
            _HEAD, [(reading.proposal.do, reading.why, f"{reading.power:.2f}") for reading in proposed.readings]
        )
    elif all(aim.before > _ENOUGH for aim in proposed.aims):
        yield "what to measure next: nothing, the readings decide this already"
    else:
        yield "what to measure next: readings made once more do not help; the pages of the effects state what does"
    for aim in proposed.aims:
        after = f", {aim.after:.2f} with these readings" if proposed.readings else ""
        yield f"  {aim.why}: power {aim.before:.2f} now{after}"
