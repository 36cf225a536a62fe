"""Probing points: the tips they are probed with, and how the errors of corrected points depend on each other."""
