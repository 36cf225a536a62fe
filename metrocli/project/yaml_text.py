"""Strict YAML: text to nodes that know their line and column; no types, aliases or tags.

Nodes are built from the events of the parser, so that an alias is refused at its place, before anything expands it.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from metrocli.errors import Fault, InputError
from metrocli.formats.file_bytes import FileBytes, read_bytes
from metrocli.nodes import Node, Source, values_in, with_paths

HDF5 = b"\x89HDF"
"""First bytes of a result file"""
MOST_BYTES = 4_000_000
DEEPEST, MOST_VALUES = 30, 100_000
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f]")
_ESCAPED = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")
"""What JSON leaves as it is in quotes, and YAML does not read"""
_NOT_PLAIN = re.compile(
    r"[\s,\[\]{}#&*!|>'\"%@`]|[-?:](\s|$)|---|\.\.\.|.*(\s#|:\s|:$|\s$|[\x00-\x1f]|" + _ESCAPED.pattern + ")", re.DOTALL
)
"""Text that YAML reads as itself only in quotes"""
_PLAIN_WORDS = (
    ("unexpected non-alphabetical character", "the file does not begin as YAML does",
     "a camera of OpenCV (%YAML:1.0) is read by `metrocli import FILE --from opencv`"),
    ("tab character", "the line is indented with a tab", "indent with spaces"),
    ("cannot start any token", "text cannot begin with this character", "put the text in quotes"),
    ("mapping values are not allowed", "a second ': ' in one value, or a line is indented too far",
     "put text with ': ' in quotes; indent all keys of a mapping alike"),
    ("did not find expected key", "this line does not fit the lines above", "indent all keys of a mapping alike"),
    ("did not find expected '-'", "this line does not fit the list above", "begin each value of a list with '- '"),
    ("block sequence entries are not allowed", "a list cannot begin here", "begin it on a new line"),
    ("could not find expected ':'", "a key without ': '", "write 'key: value'"),
    ("',' or ']'", "a list [ ... ] is not closed, or a comma is missing", "write [a, b, c]"),
    ("',' or '}'", "a mapping { ... } is not closed, or a comma is missing", "write {a: 1, b: 2}"),
    ("unknown escape character", "an unknown escape in a text in double quotes", "use single quotes"),
    ("quoted scalar", "a quotation mark is opened but not closed", "close it on the same line"),
    ("unexpected end of stream", "a quotation mark is opened but not closed", "close it on the same line"),
    ("undefined tag", "YAML tags are not used in jobs", "remove the word that begins with '!'"),
    ("node content", "a value is expected here", "close the bracket, or put the text in quotes"),
    ("document start", "a job file holds one document only", "remove the '---' and what follows"),
)  # fmt: skip


def read_text(path: Path, shown: str) -> str:
    """Return the text of a YAML file in UTF-8 (byte order mark tolerated), or raise InputError."""
    return text_of(read_bytes(path, "a job file", shown, MOST_BYTES), shown)


def text_of(held: FileBytes, shown: str) -> str:
    """Return the text of a YAML file that is already read; raises InputError as `read_text`."""
    data = held.data
    try:
        return data.decode("utf-8").lstrip("\ufeff")  # a mark that some editors write twice
    except UnicodeDecodeError as error:
        if data.startswith(HDF5):
            hint = f"`metrocli show {shown}` prints it"
            raise InputError([Fault("this is a result file; a job file is expected", shown, hint=hint)]) from error
        line = data[: error.start].count(b"\n") + 1
        raise InputError([Fault("the file is not text in UTF-8", shown, line, 1)]) from error


def parse(text: str, file: str, folder: Path, repeated: list[Fault] | None = None) -> Node:
    """Return the root of a YAML text; raise InputError with all faults of syntax.

    If `repeated` is given, repeated keys are added to it instead of being raised, and the first value is used. They can
    then be reported together with the faults of the content.
    """
    source = Source(file, tuple(text.splitlines()), folder)
    match = _CONTROL.search(text)
    if match is not None:
        control = match.start()
        line = text.count("\n", 0, control) + 1
        column = control - text.rfind("\n", 0, control)
        raise InputError([Fault("the file holds a control character; it is not a text file", file, line, column)])
    builder = _Builder(source)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            builder.take(event)
    except yaml.MarkedYAMLError as error:
        raise InputError([*builder.faults, _syntax_fault(error, source)]) from error
    except yaml.YAMLError as error:
        raise InputError([Fault(f"this is not YAML: {error}", file)]) from error
    if builder.root is None and not builder.faults:
        raise InputError([Fault("the file is empty", file, 1, 1)])
    if builder.faults or builder.root is None or (builder.repeated and repeated is None):
        raise InputError([*builder.faults, *builder.repeated])
    if repeated is not None:
        repeated.extend(builder.repeated)
    return builder.root


def _syntax_fault(error: yaml.MarkedYAMLError, source: Source) -> Fault:
    """Return the parser's error in plain words, with its place in the file."""
    texts = f"{error.problem} {error.context or ''}"
    unclosed = "',' or" in texts or "unexpected end of stream" in texts
    mark = (error.context_mark if unclosed else None) or error.problem_mark or error.context_mark
    line = min((mark.line if mark else 0) + 1, max(len(source.lines), 1))
    shown = source.lines[line - 1] if source.lines else ""
    column = min((mark.column if mark else 0) + 1, len(shown) + 1)
    if shown[column - 1 : column] == "\t" or shown[: len(shown) - len(shown.lstrip())].count("\t"):
        column, texts = shown.find("\t") + 1, "tab character"
    for known, message, hint in _PLAIN_WORDS:
        if known in texts:
            return Fault(message, source.file, line, column, shown, hint)
    return Fault(f"this is not YAML: {error.problem}", source.file, line, column, shown)


@dataclass
class _Open:
    """A list or mapping that is not yet complete."""

    node: Node
    children: list[Node] = field(default_factory=list)
    anchor: str = ""


class _Builder:
    """Build nodes from the events of the parser."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.faults: list[Fault] = []
        self.repeated: list[Fault] = []
        self.root: Node | None = None
        self.stack: list[_Open] = []
        self.documents = self.events = 0
        self.anchored: dict[str, tuple[Node, int]] = {}
        """Value of each anchor, and how many values it holds: an alias counts as all of them"""

    def take(self, event: Any) -> None:
        self._count(event, 1)
        if isinstance(event, yaml.DocumentStartEvent):
            self._start_document(event)
        elif isinstance(event, yaml.AliasEvent):
            self._repeat(event)
        elif isinstance(event, yaml.ScalarEvent):
            self._refuse_extras(event)
            quoted = event.style in tuple("'\"|>")
            self._close(self._node(event, "scalar", text=event.value, quoted=quoted), event.anchor)
        elif isinstance(event, yaml.CollectionStartEvent):
            self._refuse_extras(event)
            self._open(event)
        elif isinstance(event, yaml.CollectionEndEvent):
            opened = self.stack.pop()
            self._close(self._finished(opened), opened.anchor)

    def _count(self, event: Any, values: int) -> None:
        self.events += values
        if self.events > MOST_VALUES:
            self._refuse(event, f"more than {MOST_VALUES} values", "this is not a job file; put long lists into a CSV")
            raise InputError(self.faults)

    def _repeat(self, event: Any) -> None:
        """Put the value of an anchor in the place of its alias."""
        if event.anchor not in self.anchored:
            self._refuse(event, f"no value above has the anchor &{event.anchor}", "write the value out")
            self._close(self._node(event, "scalar", text="*"))
            return
        node, values = self.anchored[event.anchor]
        self._count(event, values)
        self._close(with_paths(node, self._path()))

    def _start_document(self, event: Any) -> None:
        self.documents += 1
        if self.documents > 1:
            self._refuse(event, "a second document begins here", "a job file holds one document only")
            raise InputError(self.faults)

    def _open(self, event: Any) -> None:
        if len(self.stack) >= DEEPEST:
            self._refuse(event, f"more than {DEEPEST} nested levels", "this is not a job file")
            raise InputError(self.faults)
        kind = "mapping" if isinstance(event, yaml.MappingStartEvent) else "list"
        self.stack.append(_Open(self._node(event, kind), anchor=event.anchor or ""))

    def _close(self, node: Node, anchor: str | None = None) -> None:
        if anchor:
            self.anchored[anchor] = node, values_in(node)
        if self.stack:
            self.stack[-1].children.append(node)
        else:
            self.root = node

    def _path(self) -> str:
        """Return the path of the next node; that of a key is the path of its mapping."""
        if not self.stack:
            return ""
        node, children = self.stack[-1].node, self.stack[-1].children
        if node.kind == "list":
            return f"{node.path}[{len(children) + 1}]"
        if len(children) % 2 == 0:
            return node.path
        return f"{node.path}.{children[-1].text}" if node.path else children[-1].text

    def _finished(self, opened: _Open) -> Node:
        if opened.node.kind == "list":
            return replace(opened.node, items=tuple(opened.children))
        pairs = list(zip(opened.children[::2], opened.children[1::2], strict=True))
        seen: dict[str, Node] = {}
        for key, _ in pairs:
            if key.kind != "scalar" or not key.text:
                self.faults.append(key.fault("a key must be a plain word"))
            elif key.text in seen:
                first = seen[key.text].line
                self.repeated.append(key.fault(f"the key '{key.text}' is repeated", f"first in line {first}"))
            seen.setdefault(key.text, key)
        firsts = {id(key) for key in seen.values()}
        return replace(opened.node, entries=tuple(pair for pair in pairs if id(pair[0]) in firsts))

    def _node(self, event: Any, kind: Any, text: str = "", quoted: bool = False) -> Node:
        mark = event.start_mark
        return Node(kind, self.source, self._path(), text, quoted, (), (), mark.line + 1, mark.column + 1)

    def _refuse_extras(self, event: Any) -> None:
        if event.tag is not None:
            self._refuse(event, f"a YAML tag ({event.tag}) is not used in jobs", "write the plain value")

    def _refuse(self, event: Any, message: str, hint: str) -> None:
        self.faults.append(self._node(event, "scalar").fault(message, hint))


def emit(node: Node, comment: str = "") -> str:
    """Return the node as YAML text in block form below one line of comment; its own comments are lost."""
    line = "".join(letter if letter.isprintable() else " " for letter in comment)
    return (f"# {line}\n" if comment else "") + _emitted(node, 0)


def _emitted(node: Node, indent: int) -> str:
    pad = " " * indent
    if node.kind == "mapping" and node.entries:
        return "".join(f"{pad}{_word(key)}:{_below(value, indent)}" for key, value in node.entries)
    if node.kind == "list" and node.items:
        return "".join(f"{pad}-{_below(item, indent)}" for item in node.items)
    return f"{pad}{_word(node)}\n"


def _below(node: Node, indent: int) -> str:
    nested = node.entries or node.items
    return f"\n{_emitted(node, indent + 2)}" if nested else f" {_word(node)}\n"


def _word(node: Node) -> str:
    if node.kind != "scalar":
        return "{}" if node.kind == "mapping" else "[]"
    if not node.quoted and not _NOT_PLAIN.match(node.text):
        return node.text
    return _ESCAPED.sub(lambda match: f"\\u{ord(match[0]):04x}", json.dumps(node.text, ensure_ascii=False))


@dataclass(frozen=True)
class YamlFile:
    """The content of a YAML file."""

    bytes: FileBytes
    text: str
    root: Node
    repeated: tuple[Fault, ...]
    """A fault for each repeated key; the first value is in the tree"""


@dataclass(frozen=True)
class YamlFiles:
    """The files that were read so far, as they were then."""

    held: dict[Path, YamlFile] = field(default_factory=dict)

    def read(self, path: Path) -> YamlFile:
        """Return the content of a file; raises InputError with all faults of its syntax."""
        place = path.absolute()
        if place not in self.held:
            repeated: list[Fault] = []
            held = read_bytes(path, "a job file", str(path), MOST_BYTES)
            text = text_of(held, str(path))
            root = parse(text, str(path), path.parent, repeated)
            self.held[place] = YamlFile(held, text, root, tuple(repeated))
        return self.held[place]

    def root(self, path: Path) -> Node:
        """Return the root of a file; raises InputError also for repeated keys."""
        root = self.read(path)
        if root.repeated:
            raise InputError(root.repeated)
        return root.root
