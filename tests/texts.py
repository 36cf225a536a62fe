"""Texts of any characters, for hypothesis."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import strategies as st

_MARKS, _ASCII, _BEFORE_SURROGATES = ",;:\"'#=+-.|%", 0x7F, 0xD7FF


def texts(
    max_size: int, min_size: int = 0, of: Callable[[str], bool] = lambda character: True
) -> st.SearchStrategy[str]:
    """Texts of characters of one 16-bit word; `st.text` first sorts all of Unicode, which takes seconds a process."""
    some = st.sampled_from(_MARKS) | (st.integers(0, _ASCII) | st.integers(0, _BEFORE_SURROGATES)).map(chr)
    return st.lists(some.filter(of), min_size=min_size, max_size=max_size).map("".join)
