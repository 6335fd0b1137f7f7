"""Tables as LaTeX: `tabular` in a `table`, no package beyond what LaTeX brings, labels of any characters."""

from collections.abc import Sequence

from reports.table import Table

_SPECIAL = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\ensuremath{<}",
    ">": r"\ensuremath{>}",
    "|": r"\ensuremath{|}",
    "±": r"\ensuremath{\pm}",
    "×": r"\ensuremath{\times}",
    "θ": r"\ensuremath{\theta}",
    "φ": r"\ensuremath{\varphi}",
    "°": r"\ensuremath{^\circ}",
    "↑": r"\ensuremath{\uparrow}",
    "↓": r"\ensuremath{\downarrow}",
    "−": r"\ensuremath{-}",
    "—": "---",
    "…": r"\ldots{}",
    "“": "``",
    "”": "''",
}


def latex(tables: Sequence[Table]) -> str:
    """Tables to be `\\input`, each a `table*` with its notes below it."""
    return "\n".join(map(_latex, tables))


def escaped(text: str) -> str:
    """Text that LaTeX sets as it stands."""
    text = " ".join(text.split()).replace("θ_o", "\0o").replace("θ_i", "\0i")
    text = "".join(_SPECIAL.get(character, character) for character in text)
    return text.replace("\0o", r"\ensuremath{\theta_o}").replace("\0i", r"\ensuremath{\theta_i}")


def _latex(table: Table) -> str:
    align = "".join("l" if i < table.words else "r" for i in range(len(table.headers)))
    if table.words == len(table.headers):
        align = align[:-1] + r"p{0.5\textwidth}"
    lines = [r"\begin{table*}", r"\centering\scriptsize", r"\setlength{\tabcolsep}{3pt}"]
    lines += [rf"\caption{{{escaped(table.title)}}}", rf"\begin{{tabular}}{{{align}}}", r"\hline"]
    lines += [_line([name for name, _ in table.headers])]
    if any(unit for _, unit in table.headers):
        lines += [_line([unit for _, unit in table.headers])]
    lines += [r"\hline", *map(_line, table.rows), r"\hline", r"\end{tabular}"]
    lines += [rf"\par\smallskip {escaped(note)}" for note in table.notes]
    return "\n".join([*lines, r"\end{table*}", ""])


def _line(cells: Sequence[str]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"
