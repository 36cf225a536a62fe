"""The look of pages, and pages as PDF."""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import tempfile
from importlib.resources import files
from pathlib import Path

from metrocli.errors import UsageError
from metrocli.plots.style import DARK, LIGHT, Theme
from metrocli.report.html import EMPTY, Html, joined, tag

_ROLES = tuple(Theme.__dataclass_fields__)


def variable(role: str) -> str:
    """Return the CSS variable of a colour by its role."""
    return f"var(--{role})"


def roles(theme: Theme) -> dict[str, str]:
    """Return the colour of each role of a theme."""
    return {role: getattr(theme, role) for role in _ROLES}


def _variables(theme: Theme) -> str:
    return "".join(f"--{role}:{colour};" for role, colour in roles(theme).items())


def _style() -> Html:
    text = files("metrocli.report").joinpath("page.css").read_text(encoding="utf-8")
    light, dark = _variables(LIGHT), _variables(DARK)
    themes = f":root{{color-scheme:light dark;{light}}}@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"
    return Html(f"<style>{themes}{text}</style>")


def script() -> str:
    """Return the script that turns 3-D views."""
    return files("metrocli.report").joinpath("turn.js").read_text(encoding="utf-8")


def page(title: str, *content: str, turns: bool = False) -> str:
    """Return a whole page; with `turns` it has the script of 3-D views.

    The policy in its head allows the inline style, images in the page and that one script by its digest, nothing else.
    """
    code = script() if turns else ""
    digest = base64.b64encode(hashlib.sha256(code.encode()).digest()).decode()
    allowed = f"script-src 'sha256-{digest}'" if turns else "script-src 'none'"
    policy = (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; {allowed}; base-uri 'none'; form-action 'none'"
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("title", title),
        _style(),
    )
    skip = tag("a", "to the figures", href="#figures", class_="skip") if turns else EMPTY
    end = Html(f"<script>{code}</script>") if turns else EMPTY
    body = tag("body", skip, tag("main", *content), end)
    return f"<!doctype html>\n{tag('html', joined([head, body]), lang='en')}\n"


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
