"""A comparison as annotations of GitHub Actions and as JUnit XML; a run as input of github-action-benchmark.

A row *forbids* if it stops the change under test: if its numbers got worse, or it is gone, failed or not comparable,
and that was not allowed by name.
"""

import json
import math
import re
from collections.abc import Iterator
from itertools import chain
from statistics import fmean
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from bench.compare.comparison import FORBIDDEN, Comparison
from bench.compare.quantities import deciding, undeciding
from bench.compare.rows import ComparedRow, multiples, sentence
from bench.compare.verdicts import Verdict
from bench.inputs.errors import visible
from bench.records import Run, by_row, grouped, rounded

MOST_ANNOTATIONS = 10  # annotations of each kind in a step: GitHub shows no more
# By the better end: github-action-benchmark takes one direction a file.
FILES = {"higher": "bigger-is-better.json", "lower": "smaller-is-better.json"}
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def annotations(comparison: Comparison) -> str:
    """One command per line: an error for each row that stops a change, a warning for allowed rows and changed times."""
    rows = [*comparison.rows, *comparison.means]
    errors = [(row.name, "; ".join(row.reasons())) for row in rows if row.forbids]
    warnings = [(row.name, "; ".join(row.reasons())) for row in comparison.having(*FORBIDDEN) if not row.forbids]
    warnings += [(row.name, row.advice) for row in comparison.rows if row.advice]
    lines = [command("error", title, message) for title, message in _first_and_rest(errors)]
    lines += [command("warning", title, message) for title, message in _first_and_rest(warnings)]
    return "\n".join(lines)


def command(kind: str, title: str, message: str) -> str:
    """`::KIND title=TITLE::MESSAGE`, escaped as GitHub Actions parses it."""
    escaped_title = _escaped(title).replace(":", "%3A").replace(",", "%2C")  # both separate properties
    return f"::{kind} title={escaped_title}::{_escaped(message)}"


def _escaped(text: str) -> str:
    """A text on one line, with the escapes that GitHub Actions undoes, and other control codes made visible."""
    return visible(text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A"))


def _first_and_rest(findings: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """At most `MOST_ANNOTATIONS` findings, each a title and a message: the last one counts the rest, and names them."""
    if len(findings) <= MOST_ANNOTATIONS:
        return findings
    shown = findings[: MOST_ANNOTATIONS - 1]  # and one for all others
    not_shown = findings[MOST_ANNOTATIONS - 1 :]
    names = ", ".join(name for name, _ in not_shown)
    return [*shown, (f"{len(not_shown)} more", names)]


def junit(comparison: Comparison) -> str:
    """JUnit XML: a suite per material, a case material/codec/quantity for each deciding number. Regressions and rows
    that are not comparable are failures; allowed and new rows are skipped."""
    root = Element("testsuites", name="neubtf-bench compare")
    by_material = grouped([*comparison.rows, *comparison.means], lambda row: row.material)
    for material, rows in by_material.items():
        suite = SubElement(root, "testsuite", name=_legal(material))
        suite.extend(chain.from_iterable(map(_cases, rows)))
        suite.attrib |= {**_counts(suite), "skipped": str(len(suite.findall(".//skipped"))), "time": "0"}
    root.attrib |= {**_counts(root), "time": "0"}  # the whole has no count of skipped cases
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True).decode() + "\n"


def _counts(element: Element) -> dict[str, str]:
    """The attributes that count the test cases of a suite, or of all suites, and those that failed."""
    failures = len(element.findall(".//failure"))
    return {"tests": str(len(element.findall(".//testcase"))), "failures": str(failures), "errors": "0"}


def _cases(row: ComparedRow) -> Iterator[Element]:
    """The test cases of a row: one for each quantity that decides.

    Also one for the whole row if it has a reason of its own, or no such quantity.
    """
    if row.why or not row.deciding:
        yield _case(row, "result", row.verdict, row.why)
    for change in row.deciding:
        yield _case(row, change.quantity.name, change.verdict, sentence(change))


def _case(row: ComparedRow, what: str, verdict: Verdict, text: str) -> Element:
    """A test case: failed for a verdict that is forbidden, skipped where nothing was compared."""
    case = Element("testcase", classname=_legal(row.name), name=_legal(f"{row.name}/{what}"), time="0")
    allowed = row.allowed and verdict in (Verdict.UNLIKE, Verdict.GONE)
    if verdict in FORBIDDEN and not allowed:
        failure = SubElement(case, "failure", type=verdict.lower(), message=_legal(text))
        failure.text = _legal(f"{row.name}: {text}")
    elif verdict in (Verdict.UNLIKE, Verdict.GONE, Verdict.NEW):
        SubElement(case, "skipped", message=_legal(text or verdict))  # a new row has no reason
    return case


def _legal(text: str) -> str:
    """The text without characters that XML 1.0 cannot hold, such as the colour codes of an error message."""
    return _NOT_XML.sub("", text)


def tracker(run: Run) -> dict[str, str]:
    """The text of each of `FILES` by its name: the means over seeds of each row of finished jobs, and its time."""
    entries: dict[str, list[dict[str, Any]]] = {name: [] for name in FILES.values()}
    finished = [job for job in run.jobs if job["status"] == "ok"]
    timed = multiples(finished, run.timings)
    for row, jobs in by_row(finished).items():
        for quantity in [*deciding(jobs[0]), *undeciding(jobs[0])]:
            values_of_seeds = [quantity.value(job) for job in jobs]
            values = [value for value in values_of_seeds if value is not None and math.isfinite(value)]
            if len(values) < len(jobs):  # JSON has no infinity, and a mean over some seeds is not comparable
                continue
            unit = quantity.unit or quantity.name  # the name of bytes, which have no unit, says what is counted
            name = "/".join((*row, quantity.name))  # material/label/quantity
            entries[FILES[quantity.better]].append(_entry(name, unit, values))
        if row in timed:
            entry = _entry("/".join((*row, "time")), "× floor", [timed[row].mean])
            low, high = timed[row].interval
            entries[FILES["lower"]].append(entry | {"range": f"{low:.3g} to {high:.3g}"})
    return {name: json.dumps(listed, indent=1, ensure_ascii=False) + "\n" for name, listed in entries.items()}


def _entry(name: str, unit: str, values: list[float]) -> dict[str, Any]:
    """One number of a tracker: the mean of `values`, one a seed; with half of their range if there are several."""
    entry: dict[str, Any] = {"name": name, "unit": unit, "value": rounded(fmean(values))}
    if len(values) > 1:
        half_range = (max(values) - min(values)) / 2
        entry |= {"range": f"± {half_range:.2g}", "extra": f"{len(values)} seeds"}
    return entry
