"""Magnification of small vectors in large pictures: 1, 2 or 5 times a power of ten."""

from __future__ import annotations

import math
import re

from metrocli.units import sized


def magnification(longest: float, wanted: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... (also below 1) by which `longest` stays at most `wanted` long.

    1 if there is nothing to magnify.
    """
    if not (longest > 0 and wanted > 0 and math.isfinite(longest)):
        return 1.0
    factor = wanted / longest * (1 + 1e-12)
    power = 10.0 ** math.floor(math.log10(factor))
    return max(step for step in (1.0, 2.0, 5.0) if step * power <= factor) * power


def round_size(wanted: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... that is at most `wanted`: the length of a scale arrow."""
    return magnification(1.0, wanted)


def in_words(factor: float) -> str:
    """Return a magnification as text: "x 5000"."""
    return f"× {factor:,.0f}".replace(",", " ") if factor >= 1 else f"× {factor:g}"


def length_in_words(length: float) -> str:
    """Return a length (mm) to two digits in the unit that suits its size: "0.21 µm"."""
    return micro(sized(length, "length"))


def micro(text: str) -> str:
    """Return a text whose units are printed with the sign µ: "0.21 µm", "17 µrad"."""
    return re.sub(r"\bu(?=(m|rad)\b)", "µ", text)
