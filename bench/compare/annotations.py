"""Writes a comparison as workflow commands of GitHub Actions; a job that prints them gets annotations.

GitHub shows ten errors and ten warnings of a step. Each row is one line; the last line counts the omitted rows.
"""

from bench.compare.comparison import FORBIDDEN, Comparison

SHOWN = 10  # annotations of each kind in a step


def annotations(comparison: Comparison) -> str:
    """One command per line: an error for each row that stops a change, a warning for allowed rows and changed times."""
    rows = [*comparison.rows, *comparison.means]
    errors = [(row.name, "; ".join(row.reasons())) for row in rows if row.forbids]
    warnings = [(row.name, "; ".join(row.reasons())) for row in comparison.having(*FORBIDDEN) if not row.forbids]
    warnings += [(row.name, row.advice) for row in comparison.rows if row.advice]
    lines = [command("error", *finding) for finding in _few(errors)]
    return "\n".join(lines + [command("warning", *finding) for finding in _few(warnings)])


def command(kind: str, title: str, message: str) -> str:
    """`::KIND title=TITLE::MESSAGE`, escaped as GitHub Actions parses it."""
    return f"::{kind} title={_data(title).replace(':', '%3A').replace(',', '%2C')}::{_data(message)}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _few(findings: list[tuple[str, str]]) -> list[tuple[str, str]]:
    if len(findings) <= SHOWN:
        return findings
    rest = findings[SHOWN - 1 :]
    return [*findings[: SHOWN - 1], (f"{len(rest)} more", ", ".join(name for name, _ in rest))]
