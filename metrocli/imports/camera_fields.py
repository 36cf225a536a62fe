"""What the readers of cameras share: a camera as its file has it, and the search for fields in a text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.imports.lines import TextLines, is_number
from metrocli.instruments.lenses.forms import PROGRAMS, LensForm


@dataclass(frozen=True)
class ReadCamera:
    """A camera as its file has it."""

    form: LensForm
    size: tuple[int, int]
    values: Mapping[str, str]
    """As the file has them, but cx and cy from the centre of the first pixel"""


def form_of(lines: TextLines, program: str, name: str, count: int | None = None) -> LensForm:
    """Return the model of a program by its name, and where names stand for several, by its number of coefficients."""
    forms = PROGRAMS[program].forms
    named = [form for form in forms if form.name == name]
    if not named:
        known = ", ".join(form.name for form in forms)
        raise InputError([lines.fault(f"the model {name} of {program} is not known here", None, f"expected {known}")])
    if count is None:
        return named[0]
    counts = {len(coefficients(form)): form for form in named}
    if count not in counts:
        expected = f"expected {' or '.join(map(str, counts))}"
        raise InputError([lines.fault(f"{count} distortion coefficients of the model {name}", None, expected)])
    return counts[count]


def coefficients(form: LensForm) -> tuple[str, ...]:
    return tuple(name for name in form.terms if name not in ("f", "fx", "fy", "cx", "cy", "skew"))


def camera_of(
    lines: TextLines, program: str, form: LensForm, size: Sequence[str], values: Mapping[str, str]
) -> ReadCamera:
    """Return what was read; raises InputError for values that are no numbers."""
    wrong = [f"{name} = '{value}'" for name, value in values.items() if not is_number(value)]
    if wrong:
        raise InputError([lines.fault(f"not a number: {', '.join(wrong)}")])
    pixel = PROGRAMS[program].pixel
    centre = {name: repr(float(values[name]) - pixel) for name in ("cx", "cy")} if pixel else {}
    return ReadCamera(form, (int(size[0]), int(size[1])), {**values, **centre})


def must_have(lines: TextLines, what: str, fields: Mapping[str, object]) -> None:
    lacking = [name for name, value in fields.items() if not value]
    if lacking:
        raise InputError([lines.fault(f"the file lacks {', '.join(lacking)}", None, f"expected a camera of {what}")])


def parsed_xml(lines: TextLines, text: str) -> ElementTree.Element:
    """Return the root of an XML text; raises InputError for any other text."""
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError([lines.fault(f"this is not XML: {error}", error.position[0])]) from error


def by_name(form: LensForm, numbers: Sequence[str]) -> dict[str, str]:
    return dict(zip(coefficients(form), numbers, strict=True))


def text_after(pattern: str, text: str, flags: int = 0) -> str | None:
    match = re.search(pattern, text, flags)
    return match[1] if match else None


LIST = r"(?:\[([^\]]*)\]|((?:\s*\n\s*-\s+[-+.0-9eE]+)+))"
"""A list of YAML, in brackets or with an entry a line"""


def numbers_after(pattern: str, text: str) -> list[str]:
    """Return the numbers of a list as written; an empty list if one is no number."""
    match = re.search(pattern, text, re.DOTALL | re.MULTILINE)
    held = next((one for one in match.groups() if one), "") if match else ""
    parts = re.split(r"[\s,]+", re.sub(r"^\s*-\s+", "", held, flags=re.MULTILINE).strip().strip(","))
    parts = [part.rstrip(".") for part in parts]
    return parts if all(map(is_number, parts)) else []
