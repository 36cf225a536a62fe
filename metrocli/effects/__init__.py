"""Effects: physical causes that a model can leave out, and a job can add by name."""

from __future__ import annotations

EFFECTS: dict[str, str] = {}
"""The effects that a job may name under `effects:`, with the module of each."""
