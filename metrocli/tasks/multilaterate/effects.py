"""Effects on the lengths of a network (docs/effects)."""

from __future__ import annotations

from metrocli.tasks.shared.length_effects import LENGTH_EFFECTS

EFFECTS = LENGTH_EFFECTS
"""The table of effects, in the order of docs/effects"""

RANGING = {"length-scale": "0.01 to 5 percent"}
"""Usual sizes for distances measured by radio or pulses: no interferometer has such errors"""
