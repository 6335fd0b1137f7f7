"""The templates: whatever a text holds, it stays text."""

from html.parser import HTMLParser

import pytest

from bench.records import load_run
from reports.html import TEMPLATES
from reports.table import BOLD, UNDERLINED, Table
from reports.tables import all_tables

PARTS = TEMPLATES.get_template("parts.html").module
HOSTILE = ["<script>bad()</script>", "\"><img src=x onerror='bad()'>", "' onclick='bad()", "]]>", "--><b>", "&lt;i&gt;"]


class Read(HTMLParser):
    """The elements of a page with their attributes, and its text."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def shape(page: str) -> list[tuple[str, list[str]]]:
    """The elements and the names of their attributes."""
    return [(tag, list(attributes)) for tag, attributes in Read(page).elements]


def made_table(text: str) -> Table:
    marks = {(0, 1): BOLD, (0, 2): UNDERLINED}
    headers = [(text, text), ("b", ""), ("c", ""), ("d", "")]
    return Table("main", text, headers, [[text] * 4], [text], words=2, material=text, marks=marks)


def with_every_part(text: str) -> str:
    parts = (
        PARTS.note(text),
        PARTS.contents([(text, text)]),
        PARTS.details(text, caller=lambda: text),
        PARTS.table(made_table(text), lambda material, cell: material + cell),
        PARTS.strip(0, [(text, text)]),
    )
    return "\n".join(parts)


@pytest.mark.parametrize("text", HOSTILE)
def test_a_text_stays_text_in_every_part(text: str) -> None:
    page = with_every_part(text)
    assert shape(page) == shape(with_every_part("plain"))
    assert Read(page).text == Read(with_every_part("plain")).text.replace("plain", text)


@pytest.mark.parametrize("text", HOSTILE)
def test_a_title_and_a_material_stay_text_on_every_page(text: str) -> None:
    view, history = TEMPLATES.get_template("view.html"), TEMPLATES.get_template("history.html")
    whole = {"styles": ["a { }"], "scripts": ["1 < 2"], "data": []}
    page, plain = (view.render(title=title, **whole) for title in (text, "plain"))
    assert shape(page) == shape(plain)
    assert "<script>1 < 2</script>" in page
    page, plain = (history.render(figures=[(name, "<svg></svg>")]) for name in (text, "plain"))
    assert shape(page) == shape(plain)
    assert "<svg></svg>" in page


def test_a_name_steers_no_browser(made):
    made.job("pca\x1b[2J", material="a\x00b")
    (table,) = all_tables(load_run(made.folder), kind="main")
    page = PARTS.table(table)
    assert {each for each in page if not each.isprintable()} == {"\n"}
    assert "pca\\x1b[2J" in page


def test_a_row_links_to_its_place_and_the_best_are_marked() -> None:
    page = PARTS.table(made_table("x"), lambda material, cell: f"#{material}-{cell}")
    row = page.partition("<tbody>")[2].partition("</tbody>")[0].strip()
    cells = '<td class="word"><a href="#x-x">x</a></td><td class="word"><b>x</b></td><td><u>x</u></td><td>x</td>'
    assert row == f"<tr>{cells}</tr>"
    assert "<a " not in PARTS.table(made_table("x"))
