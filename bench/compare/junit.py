"""Writes a comparison as JUnit XML: a suite per material, a case material/codec/quantity for each deciding number."""

import re
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from bench.compare.comparison import FORBIDDEN, Comparison
from bench.compare.rows import ComparedRow, sentence
from bench.compare.verdicts import Verdict

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(comparison: Comparison) -> str:
    """The document. Regressions and rows that are not comparable are failures; allowed and new rows are skipped."""
    root = Element("testsuites", name="neubtf-bench compare")
    rows = [*comparison.rows, *comparison.means]
    for material in dict.fromkeys(row.material for row in rows):
        suite = SubElement(root, "testsuite", name=_legal(material))
        for row in rows:
            if row.material == material:
                suite.extend(_cases(row))
    for element in (root, *root):
        cases = list(element.iter("testcase"))
        failed, skipped = (sum(case.find(what) is not None for case in cases) for what in ("failure", "skipped"))
        element.attrib |= {"tests": str(len(cases)), "failures": str(failed), "errors": "0"}
        if element is not root:
            element.set("skipped", str(skipped))
        element.set("time", "0")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True).decode() + "\n"


def _cases(row: ComparedRow) -> Iterator[Element]:
    if row.why or not row.deciding:
        yield _case(row, "result", row.verdict, row.why)
    for change in row.deciding:
        yield _case(row, change.quantity.name, change.verdict, sentence(change))


def _case(row: ComparedRow, what: str, verdict: Verdict, text: str) -> Element:
    case = Element("testcase", classname=_legal(row.name), name=_legal(f"{row.name}/{what}"), time="0")
    if verdict in FORBIDDEN and not (row.allowed and verdict in (Verdict.UNLIKE, Verdict.GONE)):
        SubElement(case, "failure", type=verdict.lower(), message=_legal(text)).text = _legal(f"{row.name}: {text}")
    elif verdict in (Verdict.UNLIKE, Verdict.GONE, Verdict.NEW):
        SubElement(case, "skipped", message=_legal(text or verdict))
    return case


def _legal(text: str) -> str:
    """The text without characters that XML 1.0 cannot hold, such as the colour codes of an error message."""
    return _NOT_XML.sub("", text)
