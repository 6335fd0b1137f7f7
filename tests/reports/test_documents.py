from pathlib import Path

from bench import cli

ROOT = Path(__file__).parents[2]


def test_every_table_of_the_documents_is_that_of_the_records(monkeypatch):
    monkeypatch.chdir(ROOT)
    documents = (path for path in (ROOT / "README.md", *ROOT.glob("docs/*.md")) if path.name != "sharing.md")
    shown = [str(path.relative_to(ROOT)) for path in documents if "<!-- neubtf-bench" in path.read_text()]
    assert "docs/results.md" in shown
    assert cli.main(["results", "check", *shown]) == 0
