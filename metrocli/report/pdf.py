"""Pages as PDF, printed by a browser that is present."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from metrocli.errors import UsageError

_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
_OPTIONS = (
    "--headless",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--no-pdf-header-footer",
)
_PATIENCE_S = 120


def printed(page: str) -> bytes:
    """Return a page as PDF on the paper that its style names; raises UsageError if no browser prints it."""
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        raise UsageError(f"--pdf needs one of these browsers on the PATH: {', '.join(_BROWSERS)}")
    # a browser refuses its sandbox to the administrator
    own = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
    with tempfile.TemporaryDirectory(prefix="metrocli-") as folder:
        source, target = Path(folder) / "page.html", Path(folder) / "page.pdf"
        source.write_text(page, encoding="utf-8")
        places = (f"--user-data-dir={folder}/profile", f"--print-to-pdf={target}", source.as_uri())
        try:
            done = subprocess.run(
                [browser, *_OPTIONS, *own, *places], capture_output=True, text=True, check=False, timeout=_PATIENCE_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise UsageError(f"--pdf: {browser} does not print: {error}") from error
        if not target.is_file():
            last = done.stderr.strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
            raise UsageError(f"--pdf: {browser} does not print: {last[0]}")
        return target.read_bytes()
