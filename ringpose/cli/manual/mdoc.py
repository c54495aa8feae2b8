"""Plain text of a manual page, from the macros of mdoc(7) that ringpose's pages use, and plain tables of tbl(7)."""

import re
import shlex
import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

GLUE = "\0"
"""Between two words: no space here."""

CELL = "\t"
"""Between two cells of a row."""

ENCLOSURES = {
    "Op": ("[", "]"),
    "Pq": ("(", ")"),
    "Dq": ("“", "”"),
    "Ql": ("\N{LEFT SINGLE QUOTATION MARK}", "\N{RIGHT SINGLE QUOTATION MARK}"),
}
BRACKETS = {"Oo": ("[", GLUE), "Oc": (GLUE, "]"), "Po": ("(", GLUE), "Pc": (GLUE, ")")}
PLAIN = frozenset({"Ar", "Cm", "Em", "Ic", "Li", "No", "Pa", "Sx", "Sy", "Va"})
"""Macros that only change the typeface."""

CALLABLE = PLAIN | ENCLOSURES.keys() | BRACKETS.keys() | {"Fl", "Fn", "Nm", "Ns", "Ta", "Xr"}
CLOSING = frozenset(".,:;)]?!")
OPENING = frozenset("([")

ESCAPES = {
    r"\(dq": '"',
    r"\(aq": "'",
    r"\(ha": "^",
    r"\(mu": "\N{MULTIPLICATION SIGN}",
    r"\(+-": "±",
    r"\(*p": "π",
    r"\('e": "é",
    r"\&": "",
    r"\-": "-",
    r"\e": "\\",
}

PARAGRAPH_INDENT = 5
DISPLAY_INDENT = 6
MAX_TAG_INDENT = 14


class UnknownMacro(ValueError):
    """A page uses a macro that is not rendered here."""


def plain_text(source: str, width: int = 78) -> str:
    """The page as lines of at most this width, except literal ones; UnknownMacro if it uses another macro."""
    page = _Page(width)
    for line in source.splitlines():
        if line.startswith(('.\\"', "'\\\"")):
            continue
        if page.table_line(line):
            continue
        if line.startswith(".") and not page.literal_line(line):
            page.macro(*_split(line[1:]))
        elif not line.startswith("."):
            page.text(line)
    page.flush()
    return "\n".join(page.lines).strip("\n") + "\n"


def _split(line: str) -> list[str]:
    """Macro and arguments; a quoted argument keeps its spaces."""
    lexer = shlex.shlex(line, posix=False)
    lexer.whitespace_split, lexer.commenters, lexer.quotes = True, "", '"'
    return list(lexer)


def unescaped(text: str) -> str:
    """The text with the characters that its escapes stand for."""
    return re.sub(r"\\(\(..|.)", lambda match: ESCAPES[match[0]], text)


def _spans(words: Sequence[str], name: str) -> Iterator[str]:
    """The words that the macros of a line print, with `GLUE` and `CELL` between them."""
    ending = len(words)
    while ending and words[ending - 1] in CLOSING:
        ending -= 1
    yield from _macros(words[:ending], name)
    for closing in words[ending:]:
        yield from (GLUE, closing)


def _macros(words: Sequence[str], name: str) -> Iterator[str]:
    """The same without punctuation at the end of the line, which stands outside of all brackets."""
    macro, taken = "No", 0
    for place, word in enumerate(words):
        if word in ENCLOSURES:
            opening, closing = ENCLOSURES[word]
            yield from (opening, GLUE, *_macros(words[place + 1 :], name), GLUE, closing)
            return
        if word in CALLABLE:
            macro, taken = word, 0
            yield from _begun(word, words[place + 1 : place + 2], name)
        else:
            yield from _argument(macro, taken, word)
            taken += 1


def _begun(macro: str, following: Sequence[str], name: str) -> Iterator[str]:
    """What a macro prints before its arguments."""
    if macro in BRACKETS:
        yield from BRACKETS[macro]
    elif macro == "Ns":
        yield GLUE
    elif macro == "Ta":
        yield CELL
    elif macro == "Fl" and "Fl" in following:
        yield from ("-", GLUE)
    elif macro == "Nm" and (not following or following[0] in CALLABLE | CLOSING):
        yield name


def _argument(macro: str, taken: int, word: str) -> Iterator[str]:
    """An argument of a macro; `taken` have come before it."""
    if word in CLOSING:
        yield from (GLUE, word)
    elif word in OPENING:
        yield from (word, GLUE)
    elif macro == "Xr" and taken == 1:
        yield from (GLUE, f"({word})")
    elif macro == "Fl" and word != "|":
        yield f"-{_bare(word)}"
    else:
        yield _bare(word) + ("()" if macro == "Fn" else "")


def _bare(word: str) -> str:
    is_quoted = len(word) > 1 and word[0] == word[-1] == '"'
    return unescaped(word[1:-1] if is_quoted else word)


def _joined(spans: Sequence[str]) -> str:
    """The words with single spaces, and none where there is glue."""
    return re.sub(f" ?{GLUE} ?", "", " ".join(span for span in spans if span)).replace(f" {CELL} ", CELL)


@dataclass
class _List:
    kind: str
    is_compact: bool
    items: int = 0


class _Page:
    """The lines so far, and the paragraph that is being filled."""

    def __init__(self, width: int) -> None:
        self.lines: list[str] = []
        self._width = width
        self._name = ""
        self._section = ""
        self._spans: list[str] = []
        self._label = ""
        """What begins the next line, left of the paragraph: the tag or bullet of an item."""
        self._indent = PARAGRAPH_INDENT
        self._outer: list[int] = []
        """Indents of the lists and displays around the current one."""
        self._lists: list[_List] = []
        self._rows: list[list[str]] = []
        self._table: list[str] | None = None
        """The lines since `.TS`: formats, the last of them with a point at its end, and rows of cells between tabs."""
        self._is_literal = False

    def literal_line(self, line: str) -> bool:
        """Whether the line is an example's although it begins with a point; `.Ed` ends the example."""
        return self._is_literal and line.split()[0] != ".Ed"

    def table_line(self, line: str) -> bool:
        """Whether the line belongs to a table, which is written at its `.TE`."""
        if line == ".TS":
            self.flush()
            self._gap()
            self._table = []
        elif self._table is None:
            return False
        elif line == ".TE":
            self._write_table(self._table)
            self._table = None
        else:
            self._table.append(line)
        return True

    def _write_table(self, lines: list[str]) -> None:
        """Rows of cells, each column as wide as its longest cell, aligned as its last format states: l or r."""
        first_row = next(number for number, line in enumerate(lines, 1) if line.endswith("."))
        aligned = [str.rjust if key.startswith("r") else str.ljust for key in lines[first_row - 1].split()]
        rows = [[unescaped(cell) for cell in line.split("\t")] for line in lines[first_row:]]
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        for row in rows:
            cells = [align(cell, width) for align, cell, width in zip(aligned, row, widths, strict=True)]
            self.lines.append((" " * self._indent + "  ".join(cells)).rstrip())
        self.lines.append("")

    def text(self, line: str) -> None:
        """A line without a macro."""
        if self._is_literal:
            self.lines.append((" " * self._indent + unescaped(line)).rstrip())
        elif line.strip():
            self._spans.append(unescaped(line.strip()))

    def macro(self, macro: str, *words: str) -> None:
        """A line that begins with a macro."""
        block: Callable[..., None] | None = getattr(self, f"_on_{macro.lower()}", None)
        if block is not None and macro[0].isupper():
            block(*words)
        elif macro in CALLABLE:
            self._spans += _spans((macro, *words), self._name)
        else:
            raise UnknownMacro(macro)

    def flush(self) -> None:
        """End the paragraph."""
        text, label = _joined(self._spans), self._label
        self._spans, self._label = [], ""
        outer = self._outer[-1] if self._outer else self._indent
        if label and (len(label) >= self._indent - outer or not text):
            self.lines.append(" " * outer + label)
            label = ""
        if text:
            first = (" " * outer + label).ljust(self._indent) if label else " " * self._indent
            self.lines += self._filled(text, first, " " * self._indent)

    def _filled(self, text: str, first: str, others: str) -> list[str]:
        return textwrap.wrap(
            text,
            self._width,
            initial_indent=first,
            subsequent_indent=others,
            break_long_words=False,
            break_on_hyphens=False,
        )

    def _gap(self) -> None:
        if self.lines and self.lines[-1]:
            self.lines.append("")

    def _on_dd(self, *_: str) -> None:
        """The date of the page."""

    def _on_os(self, *_: str) -> None:
        """The operating system."""

    def _on_dt(self, title: str, section: str) -> None:
        heading = f"{title}({section})"
        self.lines.append(heading + heading.rjust(self._width - len(heading)))

    def _on_sh(self, *words: str) -> None:
        self.flush()
        self._gap()
        self._section, self._indent = " ".join(words), PARAGRAPH_INDENT
        self.lines.append(self._section)

    def _on_ss(self, *words: str) -> None:
        self.flush()
        self._gap()
        self.lines.append("   " + _joined(list(_spans(words, self._name))))

    def _on_pp(self) -> None:
        self.flush()
        self._gap()

    def _on_nm(self, *words: str) -> None:
        if self._section == "NAME":
            self._name = words[0]
        elif self._section == "SYNOPSIS":
            self.flush()
        self._spans += _spans(("Nm", *words), self._name)

    def _on_nd(self, *words: str) -> None:
        self._spans += ["\N{EN DASH}", *_spans(words, self._name)]

    def _on_dl(self, *words: str) -> None:
        self.flush()
        self.lines.append(" " * (self._indent + DISPLAY_INDENT) + _joined(list(_spans(words, self._name))))

    def _on_bd(self, *options: str) -> None:
        self.flush()
        self._gap()
        self._outer.append(self._indent)
        self._indent += DISPLAY_INDENT if "-offset" in options else 0
        self._is_literal = options[0] in ("-literal", "-unfilled")

    def _on_ed(self) -> None:
        self.flush()
        self._is_literal = False
        self._indent = self._outer.pop()

    def _on_bl(self, *options: str) -> None:
        self.flush()
        kind = options[0][1:]
        width = options[options.index("-width") + 1] if "-width" in options else "Ds"
        indent = {"tag": 6 if width == "Ds" else min(len(_bare(width)) + 2, MAX_TAG_INDENT), "column": 0}.get(kind, 3)
        self._outer.append(self._indent)
        self._indent += indent
        self._lists.append(_List(kind, "-compact" in options))

    def _on_it(self, *words: str) -> None:
        self.flush()
        current = self._lists[-1]
        current.items += 1
        content = _joined(list(_spans(words, self._name)))
        if current.kind == "column":
            self._rows.append(content.split(CELL))
            return
        if not current.is_compact:
            self._gap()
        self._label = {"bullet": "•", "dash": "-", "enum": f"{current.items}."}.get(current.kind, content)

    def _on_el(self) -> None:
        self.flush()
        if self._lists.pop().kind == "column":
            self._columns()
        self._indent = self._outer.pop()

    def _columns(self) -> None:
        """The rows of a list of columns, each column as wide as its longest cell but the last, which is filled."""
        self._gap()
        widths = [max(map(len, cells)) + 2 for cells in zip(*self._rows, strict=True)]
        for row in self._rows:
            *cells, last = row
            first = " " * self._indent + "".join(map(str.ljust, cells, widths))
            self.lines += self._filled(last, first, " " * len(first)) if last else [first.rstrip()]
        self._rows = []
