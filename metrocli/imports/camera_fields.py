"""What the readers of cameras share: a camera as its file has it, and the fields of its text, each of them once."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from metrocli.effects.links.lens_shape import KnownShape
from metrocli.errors import Fault, InputError
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
    shape: KnownShape | None = None
    """Of a lens that no parameters hold"""
    notes: tuple[str, ...] = ()


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
    """Return the names of the distortion coefficients of a model, in the order of its program."""
    return tuple(name for name in form.terms if name not in ("f", "fx", "fy", "cx", "cy", "skew"))


def camera_of(
    lines: TextLines, program: str, form: LensForm, size: Sequence[str], values: Mapping[str, str]
) -> ReadCamera:
    """Return what was read; raises InputError for values that are not numbers, and sizes that are not whole ones."""
    must_be_numbers(lines, values)
    wrong = [
        _at(lines, f"image {side} = '{text}'", text, "expected a whole number of pixels")
        for side, text in zip(("width", "height"), size, strict=True)
        if not (is_number(text) and float(text).is_integer() and float(text) > 0)
    ]
    if wrong:
        raise InputError(wrong)
    # the centre of the first pixel is (0, 0) here, and (0.5, 0.5) or (1, 1) in some programs
    pixel = PROGRAMS[program].pixel
    centre = {name: repr(float(values[name]) - pixel) for name in ("cx", "cy")} if pixel else {}
    return ReadCamera(form, (int(float(size[0])), int(float(size[1]))), {**values, **centre})


def must_be_numbers(lines: TextLines, values: Mapping[str, str]) -> None:
    """Raise InputError with each value that is not a finite number."""
    wrong = [(name, text) for name, text in values.items() if not is_number(text)]
    if wrong:
        raise InputError([_at(lines, f"not a number: {name} = '{text}'", text) for name, text in wrong])


def _at(lines: TextLines, message: str, text: str, hint: str | None = None) -> Fault:
    """Return a fault at the line that has a text, if there is one such line."""
    there = [number for number, line in enumerate(lines.lines, 1) if text and text in line]
    return lines.fault(message, there[0] if len(there) == 1 else None, hint)


def must_have(lines: TextLines, what: str, fields: Mapping[str, object]) -> None:
    """Raise InputError that names the fields without a value."""
    lacking = [name for name, value in fields.items() if not value]
    if lacking:
        raise InputError([lines.fault(f"the file lacks {', '.join(lacking)}", None, f"expected a camera of {what}")])


def parsed_xml(lines: TextLines, text: str) -> ElementTree.Element:
    """Return the root of an XML text; raises InputError for any other text."""
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        line = min(error.position[0], len(lines.lines))
        raise InputError([lines.fault(f"this is not XML: {error}", line)]) from error


def children(lines: TextLines, element: ElementTree.Element) -> dict[str, ElementTree.Element]:
    """Return the elements in an element by their tags; raises InputError if one stands twice."""
    by_tag = dict[str, ElementTree.Element]()
    for each in element:
        if each.tag in by_tag:
            raise InputError([lines.fault(f"{each.tag} stands twice")])
        by_tag[each.tag] = each
    return by_tag


def by_name(form: LensForm, numbers: Sequence[str]) -> dict[str, str]:
    """Return the distortion coefficients of a model by name."""
    return dict(zip(coefficients(form), numbers, strict=True))


def text_after(lines: TextLines, pattern: str, text: str) -> str | None:
    """Return the first group of a pattern, without quotes around it; None if the pattern is not in the text.

    Raises InputError if it is there twice, since it is not known which is right.
    """
    matches = list(re.finditer(pattern, text, re.MULTILINE))
    if len(matches) > 1:
        raise InputError([lines.fault(f"{re.split('[:=]', matches[1][0].strip())[0].strip()} stands twice")])
    return matches[0][1].strip().strip("'\"").strip() if matches else None


def listed(text: str) -> list[str]:
    """Return the entries of a list as written, and an empty text where commas have nothing between them.

    "1., 2.5" are "1" and "2.5": OpenCV writes whole numbers with a point.
    """
    parts = text.split() if not re.search("[,;]", text) else re.split("[,;]", re.sub(r"[,;]\s*$", "", text))
    return [re.sub(r"(?<=[0-9])\.$", "", part.strip()) for part in parts]


# indentation, key in quotes or without, and what stands behind it: a colon without a blank is not a key of YAML
_KEY = re.compile(r"([ \t]*)(?:'|\")?([\w.]+)(?:'|\")?[ \t]*:(?![^ \t])(.*)")
# a line of a list, "- 1.5"
_ENTRY = re.compile(r"^[ \t]*-(?:[ \t]+(.*))?$", re.MULTILINE)


class Keys:
    """The keys of a text in the YAML that cameras are written in, of whatever version."""

    def __init__(self, lines: TextLines, text: str) -> None:
        """Take the text; comments are left out, and so are the types of FileStorage."""
        self._file = lines
        self._rows = [re.sub(r"(^|\s)#.*|!!opencv-matrix", "", row).rstrip() for row in text.splitlines()]
        self._keys = [(n, match) for n, row in enumerate(self._rows) if (match := _KEY.fullmatch(row))]

    def has(self, key: str) -> bool:
        """Return whether a key is there, a pattern that is matched in any case."""
        return any(re.fullmatch(key, match[2], re.IGNORECASE) for _, match in self._keys)

    def text(self, key: str, nested: bool = True) -> str | None:
        """Return what stands behind a key; None if it is not there.

        Raises InputError if it is there twice, since it is not known which is right.
        """
        place = self._place(key, nested)
        return None if place is None else place[1][3].strip().strip("'\"").strip()

    def entries(self, key: str, nested: bool = True) -> list[str]:
        """Return the list of a key as written: in brackets, with an entry a line, or as `data` beside rows and cols.

        Empty if it is not there or not closed. Raises InputError as `text`, and where rows and cols state others.
        """
        place = self._place(key, nested)
        if place is None:
            return []
        body = "\n".join([place[1][3], *self._below(*place)])
        if mapping := re.fullmatch(r"\s*\{(.*)\}\s*", body, re.DOTALL):
            body = re.sub(r",\s*(?=\w+\s*:)", "\n", mapping[1].strip())
        inner = Keys(self._file, body)
        if inner._place("data") is None:
            return _entries(body)
        numbers = inner.entries("data")
        sides = {side: text for side in ("rows", "cols") if is_number(text := inner.text(side) or "")}
        # of both sides the size of the matrix; a file that ends too early may have one of them, which must divide it
        size = math.prod(map(float, sides.values()))
        if numbers and (not size or len(numbers) % size or (len(sides) == 2 and len(numbers) != size)):
            stated = " and ".join(f"{side} {text}" for side, text in sides.items())
            raise InputError(
                [self._file.fault(f"{place[1][2]} has {len(numbers)} numbers", None, f"it states {stated}")]
            )
        return numbers

    def _place(self, key: str, nested: bool = True) -> tuple[int, re.Match[str]] | None:
        """Return row and match of a key; only keys without indentation unless `nested`."""
        matches = [
            (n, match)
            for n, match in self._keys
            if re.fullmatch(key, match[2], re.IGNORECASE) and (nested or not match[1])
        ]
        if len(matches) > 1:
            raise InputError([self._file.fault(f"{matches[1][1][2]} stands twice")])
        return matches[0] if matches else None

    def _below(self, row: int, match: re.Match[str]) -> list[str]:
        """Return the lines that belong to a key: indented farther, entries of a list, or within its brackets."""
        indent, body = len(match[1]), list[str]()
        for line in self._rows[row + 1 :]:
            own = len(line) - len(line.lstrip())
            # FileStorage breaks lists within brackets at any indentation: such lines have no colon
            inside = own > indent or (own == indent and re.match(r"\s*-(\s|$)", line)) or ":" not in line
            if not inside or line.startswith(("---", "...")):
                break
            body.append(line)
        return body


def _entries(body: str) -> list[str]:
    """Return the entries of a list in brackets, or with "- " on each line; none of brackets that are not closed."""
    opened = body.lstrip().startswith("[")
    brackets = re.match(r"\s*\[([^\]]*)\]\s*$", body) if opened else None
    if opened:
        return listed(brackets[1]) if brackets else []
    return [part for entry in _ENTRY.findall(body) for part in listed(entry) or [""]]
