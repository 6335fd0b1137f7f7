"""Tables as LaTeX for `\\usepackage{booktabs,graphicx}`: no wider than the text, in one column or over both of two."""

import re
import unicodedata
from collections.abc import Sequence

from reports.table import BOLD, UNDERLINED, Table

PACKAGES = r"% needs \usepackage{booktabs,graphicx}"
_MARKS = {BOLD: r"\textbf{%s}", UNDERLINED: r"\underline{%s}", "": "%s"}
_MATH = {"<": "<", ">": ">", "|": "|", "−": "-", "±": r"\pm", "×": r"\times", "θ": r"\theta", "φ": r"\varphi"}
_MATH |= {"°": r"^\circ", "↑": r"\uparrow", "↓": r"\downarrow"}
_SPECIAL = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{character: rf"\ensuremath{{{math}}}" for character, math in _MATH.items()},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"—": "---", "…": r"\ldots{}", "“": "``", "”": "''"},
}


def latex(tables: Sequence[Table]) -> str:
    """Tables to be `\\input`, each a `table*` with its notes below it and a label: `tab:summary`, or see `label`."""
    kinds, written = [table.kind for table in tables], []
    for table in tables:
        alone = kinds.count(table.kind) == 1 and not table.material
        written.append(_latex(table, f"tab:{table.kind}" if alone else label(table)))
    return "\n".join([PACKAGES, *written]) if tables else ""


def escaped(text: str) -> str:
    """Text escaped for LaTeX."""
    text = " ".join(text.split()).replace("θ_o", "\0o").replace("θ_i", "\0i")
    text = "".join(_SPECIAL.get(character, character) for character in text)
    return text.replace("\0o", r"\ensuremath{\theta_o}").replace("\0i", r"\ensuremath{\theta_i}")


def _latex(table: Table, called: str) -> str:
    align = "".join("l" if i < table.words else "r" for i in range(len(table.headers)))
    if table.words == len(table.headers):
        align = align[:-1] + r"p{0.5\textwidth}"
    names_and_units = zip(*table.headers, strict=True)
    heads = [" & ".join(map(escaped, line)) + r" \\" for line in names_and_units if any(line)]
    rows = []
    for i, row in enumerate(table.rows):
        cells = (_MARKS[table.marks.get((i, j), "")] % escaped(cell) for j, cell in enumerate(row))
        rows.append(" & ".join(cells) + r" \\")
    lines = [r"\begin{table*}", r"\centering", rf"\caption{{{escaped(table.title)}}}", rf"\label{{{called}}}"]
    lines += [r"\footnotesize", r"\setlength{\tabcolsep}{3pt}", r"\sbox0{%", rf"\begin{{tabular}}{{@{{}}{align}@{{}}}}"]
    lines += [r"\toprule", *heads, r"\midrule", *rows]
    lines += [r"\bottomrule", r"\end{tabular}}%", _FITTED]
    if notes := " ".join(map(escaped, table.footnotes)):
        lines += [r"\par\smallskip\begin{minipage}{\linewidth}\raggedright\scriptsize", notes, r"\end{minipage}"]
    return "\n".join([*lines, r"\end{table*}", ""])


# Scaled down to the width of the text, never up.
_FITTED = r"\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi"


def label(table: Table) -> str:
    """The label of a table for `\\ref`, `tab:main-satin`: letters, digits and hyphens of its kind and title."""
    words = re.findall("[A-Za-z0-9]+", unicodedata.normalize("NFKD", table.title.partition(" (")[0]))
    return "-".join([f"tab:{table.kind}", *words]).lower()
