"""One table type for the terminal, Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
import textwrap
from collections.abc import Iterable
from typing import Any, NamedTuple


class Bold(str):
    """A cell in bold."""

    __slots__ = ()


class Column(NamedTuple):
    """The head of a column, aligned `left` or right, under the `group` of its neighbours if any."""

    name: str
    left: bool = False
    group: str = ""

    @property
    def text(self) -> str:
        """The head in one line."""
        return f"{self.group}: {self.name}" if self.group else self.name


class Table:
    """Columns and rows of text.

    Args:
        columns: heads; a text stands for a column without a group.
        title: shown above the table, not in LaTeX and CSV.
        text_columns: how many of the first columns that are given as text are aligned left.
    """

    def __init__(self, *columns: str | Column, title: str = "", text_columns: int = 1) -> None:
        self.columns = [
            c if isinstance(c, Column) else Column(c, left=i < text_columns)
            for i, c in enumerate(columns)
        ]
        self.title = title
        self.rows: list[tuple[str, ...]] = []
        self.sections: set[int] = set()

    def add_row(self, *cells: str) -> None:
        """Append a row of one cell a column."""
        assert len(cells) == len(self.columns), (cells, self.columns)
        self.rows.append(cells)

    def add_section(self) -> None:
        """Draw a line below the last row, on the terminal and in LaTeX."""
        self.sections.add(len(self.rows))

    def rich(self) -> Any:
        """The table for `rich.console.Console.print`."""
        import rich.table
        from rich.text import Text

        title = Text(self.title) if self.title else None
        heads = any(column.text for column in self.columns)
        result = rich.table.Table(title=title, title_justify="left", show_header=heads)
        for column in self.columns:
            result.add_column(Text(column.text), justify="left" if column.left else "right")
        for index, row in enumerate(self.rows):
            if index in self.sections:
                result.add_section()
            result.add_row(*(Text(cell, "bold" * isinstance(cell, Bold)) for cell in row))
        return result

    def markdown(self) -> str:
        """The table in GitHub's Markdown, below its title in bold."""
        lines = [
            [column.text for column in self.columns],
            ["---" if column.left else "---:" for column in self.columns],
            *([f"**{c}**" if isinstance(c, Bold) else c for c in row] for row in self.rows),
        ]
        lines = [f"| {' | '.join(c.replace('|', '∣') for c in line)} |" for line in lines]
        return "\n".join([*([f"**{self.title}**", ""] if self.title else []), *lines])

    def latex(self, comment: str = "") -> str:
        """The table as a `tabular` for booktabs, below `comment`."""
        groups, rules, first = [], "", 1
        for group, columns in itertools.groupby(self.columns, key=lambda column: column.group):
            size = len(list(columns))
            if group:
                groups.append(rf"\multicolumn{{{size}}}{{c}}{{{_latex(group)}}}")
                rules += rf"\cmidrule(lr){{{first}-{first + size - 1}}}"
            else:
                groups += [""] * size
            first += size
        lines = [f"% {comment}"] if comment else []
        lines += [
            rf"\begin{{tabular}}{{{''.join('l' if c.left else 'r' for c in self.columns)}}}",
            r"\toprule",
            *([" & ".join(groups) + r" \\", rules] if rules else []),
            " & ".join(_latex(column.name) for column in self.columns) + r" \\",
        ]
        for index, row in enumerate(self.rows):
            lines += [r"\midrule"] * (index == 0 or index in self.sections)
            lines.append(" & ".join(map(_latex, row)) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"

    def csv(self) -> str:
        """The table as CSV with a header."""
        text = io.StringIO()
        rows = [tuple(column.text for column in self.columns), *self.rows]
        csv.writer(text, lineterminator="\n").writerows(rows)
        return text.getvalue()


Part = str | Table
"""A paragraph or a table of a section."""


def markdown(parts: Iterable[Part]) -> str:
    """Paragraphs, in lines of at most 100 characters where words allow, and tables."""
    return "\n\n".join(
        part.markdown()
        if isinstance(part, Table)
        else textwrap.fill(part, 100, break_long_words=False, break_on_hyphens=False)
        for part in parts
    )


def number(value: float, digits: int = 3) -> str:
    """`value` with a fixed number of decimals, without a minus before zero."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0 else text


def significant(value: float) -> str:
    """`number`, but with three significant digits where decimals would not show them.

    A time that is never reached is infinite.
    """
    if not math.isfinite(value):
        return "never" if value > 0 else "–"
    return f"{value:.3g}" if 0 < abs(value) < 0.1 else number(value)


_SYMBOLS = str.maketrans({
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "ℓ": r"\(\ell\)", "σ": r"\(\sigma\)", "−": r"\(-\)", "±": r"\(\pm\)", "↑": r"\(\uparrow\)",
    "↓": r"\(\downarrow\)", "–": "--", "’": "'",
})  # fmt: skip


def _latex(cell: str) -> str:
    text = re.sub(r"\bL\\_([dp])", r"\\(L_\1\\)", cell.translate(_SYMBOLS))
    return rf"\textbf{{{text}}}" if isinstance(cell, Bold) else text
