"""Where things are that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SAMPLES = ROOT / "sample_projects"
SHARED = ROOT.parent / "shared"
"""Measurements and references from outside; absent in a clone: tests that need it skip"""
