import re
import shlex
from pathlib import Path

import pytest

import bench
from bench import cli

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("baselines/**/*.md")])
IN_BLOCK = re.compile(r"(?:^|&& |; do |run: )(?: {4})?(?:[A-Z_]+=\S+ )?(neubtf-bench .*)$", re.M)
INLINE = re.compile(r"`(neubtf-bench [^`\n]+)`")


def prose(page: Path) -> str:
    return re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def commands(page: Path) -> list[list[str]]:
    """The words of every command of the suite on a page, without the comments and redirections behind them."""
    text = re.sub(r"\\\n\s*", " ", page.read_text(encoding="utf-8")).replace("$seed", "3")
    lines = [re.split(r"\s#|;|&&|\s[>|]|\$\(", found)[0] for found in (*IN_BLOCK.findall(text), *INLINE.findall(text))]
    return [words for line in lines if len(words := shlex.split(line)[1:]) > 0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"[a-z]+:", target):  # of another site
            continue
        name, _, anchor = target.partition("#")
        there = (page.parent / name).resolve() if name else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


def test_every_command_parses() -> None:
    shown = [(page, words) for page in PAGES for words in commands(page)]
    names = [(page.name, " ".join(words)) for page, words in shown]  # found in blocks, behind others, and in sentences
    assert {("ci.md", "run mine.toml --seed 3 --jobs 2 --out runs/mine"), ("neubtf.md", "run ablation")} <= {*names}
    for _, words in shown:
        parser = cli.parser(words[:1])  # an error where there is no such command
        named = 2 if words[0] in {"new", "results"} else 1  # words that name the command
        if len(words) > named:  # otherwise it is only mentioned
            try:
                parser.parse_args(words)
            except SystemExit:
                pytest.fail(f"does not parse: neubtf-bench {' '.join(words)}")


@pytest.mark.parametrize("page", ["README.md", "docs/results.md"])
def test_levels_and_sizes_stand_in_generated_tables_alone(page: str) -> None:
    """Another test holds the tables to the records; a sentence with a level or a file's size would grow old unseen."""
    text = re.sub(r"<!-- neubtf-bench.*?<!-- end -->", "", (ROOT / page).read_text(), flags=re.S)
    assert re.findall(r"\d{2,}\.\d+ dB|\d[\d,]+ (?:B|kB|bytes)\b", text) == []


def test_the_site_has_every_page_and_every_public_name() -> None:
    listed = re.findall(r"(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(["reference.md", *(str(page.relative_to(ROOT)) for page in PAGES if on_site(page))])
    reference = (ROOT / "tools" / "site" / "reference.md").read_text(encoding="utf-8")
    described = {*re.findall(r"^::: (\S+)$", reference, re.M)}
    assert {f"bench.{name}" for name in bench._LAZY} | {"reports.table_text", "reports.table_values"} <= described


def on_site(page: Path) -> bool:
    return page.parent == ROOT or ROOT / "docs" in page.parents
