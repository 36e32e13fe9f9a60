"""One table type for the terminal, Markdown, LaTeX and CSV."""

import csv
import io
import itertools
import math
import re
import textwrap
from collections.abc import Collection, Iterable
from typing import Any


class Bold(str):
    """A cell in bold."""

    __slots__ = ()


class Table:
    """Columns and rows of text.

    Args:
        columns: heads; those of a group begin with its name, `GROUP: NAME`.
        title: shown above the table, not in LaTeX and CSV.
        left: indices of the columns that are aligned left.
    """

    def __init__(self, *columns: str, title: str = "", left: Collection[int] = (0,)) -> None:
        self.columns, self.title, self.left = columns, title, left
        self.rows: list[tuple[str, ...]] = []
        self.sections: set[int] = set()

    def add_row(self, *cells: str) -> None:
        """Append a row of one cell a column."""
        assert len(cells) == len(self.columns), (cells, self.columns)
        self.rows.append(cells)

    def add_section(self) -> None:
        """Draw a line below the last row on the terminal."""
        self.sections.add(len(self.rows))

    def _aligned(self, left: str, right: str) -> list[str]:
        return [left if i in self.left else right for i in range(len(self.columns))]

    def rich(self) -> Any:
        """The table for `rich.console.Console.print`."""
        import rich.table
        from rich.text import Text

        title = Text(self.title) if self.title else None
        result = rich.table.Table(title=title, title_justify="left", show_header=any(self.columns))
        for column, side in zip(self.columns, self._aligned("left", "right"), strict=True):
            result.add_column(Text(column), justify=side)  # pyright: ignore[reportArgumentType]
        for index, row in enumerate(self.rows):
            if index in self.sections:
                result.add_section()
            result.add_row(*(Text(cell, "bold" * isinstance(cell, Bold)) for cell in row))
        return result

    def markdown(self) -> str:
        """The table in GitHub's Markdown, below its title in bold."""
        lines = [
            self.columns,
            self._aligned("---", "---:"),
            *([f"**{c}**" if isinstance(c, Bold) else c for c in row] for row in self.rows),
        ]
        lines = [f"| {' | '.join(c.replace('|', '∣') for c in line)} |" for line in lines]
        return "\n".join([*([f"**{self.title}**", ""] if self.title else []), *lines])

    def latex(self, comment: str = "") -> str:
        """The table as a `tabular` for booktabs, below `comment`."""
        heads = [column.rpartition(": ") for column in self.columns]
        groups, rules, first = [], "", 1
        for group, columns in itertools.groupby(group for group, _, _ in heads):
            size = len(list(columns))
            groups.append(rf"\multicolumn{{{size}}}{{c}}{{{_latex(group)}}}")
            rules += rf"\cmidrule(lr){{{first}-{first + size - 1}}}" if group else ""
            first += size
        lines = [
            f"% {comment}",
            rf"\begin{{tabular}}{{{''.join(self._aligned('l', 'r'))}}}",
            r"\toprule",
            *([" & ".join(groups) + r" \\", rules] if rules else []),
            " & ".join(_latex(name) for _, _, name in heads) + r" \\",
            r"\midrule",
            *(" & ".join(map(_latex, row)) + r" \\" for row in self.rows),
        ]
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"]) + "\n"

    def csv(self) -> str:
        """The table as CSV with a header."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self.rows])
        return text.getvalue()


Part = str | Table
"""A paragraph or a table of a section."""


def markdown(parts: Iterable[Part]) -> str:
    """Paragraphs, in lines of at most 100 characters where words allow, and tables."""
    return "\n\n".join(
        part.markdown() if isinstance(part, Table) else _filled(part) for part in parts
    )


def _filled(paragraph: str) -> str:
    # "1. " at the start of a line would begin a list: such a number stays with the word before.
    tied = re.sub(r" (\d+[.)])(?= )", "\0\\1", paragraph)
    text = textwrap.fill(tied, 100, break_long_words=False, break_on_hyphens=False)
    return text.replace("\0", " ")


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


def three_digits(value: float) -> str:
    """Three significant digits, more of a whole number."""
    if abs(value) >= 100:
        return f"{value:,.0f}"
    return f"{value:.2e}" if 0 < abs(value) < 0.01 else f"{value:#.3g}".rstrip(".")


_SYMBOLS = str.maketrans({
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "#": r"\#", "_": r"\_", "$": r"\$",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "ℓ": r"\(\ell\)", "σ": r"\(\sigma\)", "−": r"\(-\)", "±": r"\(\pm\)", "↑": r"\(\uparrow\)",
    "↓": r"\(\downarrow\)", "–": "--", "’": "'",
})  # fmt: skip


def _latex(cell: str) -> str:
    text = re.sub(r"\bL\\_([dp])", r"\\(L_\1\\)", cell.translate(_SYMBOLS))
    return rf"\textbf{{{text}}}" if isinstance(cell, Bold) else text
