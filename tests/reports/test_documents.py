"""What documents show of records: their tables, and the picture that is drawn from them."""

from pathlib import Path

import numpy as np
from PIL import Image

from bench import cli

ROOT = Path(__file__).parents[2]


def test_every_table_of_the_documents_is_that_of_the_records(monkeypatch):
    monkeypatch.chdir(ROOT)
    documents = (path for path in (ROOT / "README.md", *ROOT.glob("docs/*.md")) if path.name != "sharing.md")
    shown = [str(path.relative_to(ROOT)) for path in documents if "<!-- neubtf-bench" in path.read_text()]
    assert "docs/results.md" in shown
    assert cli.main(["results", "check", *shown]) == 0


def test_the_picture_of_the_results_is_that_of_the_records(tmp_path):
    """If not: neubtf-bench figure fronts docs/results/budgets.jsonl --material satin -o docs/images/fronts-satin.png"""
    records, drawn = ROOT / "docs/results/budgets.jsonl", tmp_path / "fronts.png"
    assert cli.main(["figure", "fronts", str(records), "--material", "satin", "-o", str(drawn)]) == 0
    of_records = grey_levels(drawn)
    of_documents = grey_levels(ROOT / "docs/images/fronts-satin.png")
    # Letters may differ between versions of Matplotlib. With curves of former records 1.6 % of the pixels differed.
    assert (abs(of_records - of_documents) > 64).mean() < 0.002


def grey_levels(path):
    return np.asarray(Image.open(path).convert("L"), int)
