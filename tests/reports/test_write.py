import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from bench import cli
from reports import figures, write_report


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_report_is_tables_figures_and_a_page(made):
    written = write_report(made.job().job("vq").timing().trade("vq").folder)
    names = {str(path.relative_to(made.folder)) for path in written.files}
    assert {"tables/main.md", "tables/main.tex", "tables/results.csv", "tables/trade.csv", "report.html"} <= names
    kinds = ("contact", "rate", "speed", "angles", "polar", "abrdf", "fits", "footprints", "significance")
    assert {f"figures/{kind}-satin.png" for kind in kinds} == {name for name in names if name.endswith(".png")}
    for path in made.folder.glob("figures/*.png"):
        with Image.open(path) as picture:
            picture.verify()
    assert "satin" in written.text


def test_running_twice_gives_the_same_files_and_leaves_nothing_else(made):
    made.job().job("vq", psnr=25.0).timing().trade("vq")
    before = set(contents(made.folder))
    written = write_report(made.folder)
    first = contents(made.folder)
    write_report(made.folder)
    assert contents(made.folder) == first
    assert set(first) - before == {path.relative_to(made.folder) for path in written.files}


def test_a_run_without_a_result_says_so(made):
    written = write_report(made.unfinished("failed", "ValueError: no").folder)
    assert "ValueError: no" in written.text
    assert "ValueError: no" in (made.folder / "report.html").read_text()
    assert not list(made.folder.glob("figures/*"))


@pytest.mark.long
def test_figures_and_choices_of_an_earlier_report_go(made):
    write_report(made.job().job("vq").timing().trade("vq").folder)
    before = {path.name for path in made.folder.glob("figures/*")}
    assert {name.partition("-")[0] for name in before} <= figures.ALL.keys()
    own = {"mine.png", "rate-paper.png"}
    for name in own:
        (made.folder / "figures" / name).write_bytes(b"")
    (made.folder / "records.jsonl").unlink()
    written = write_report(made.start().job().folder)
    drawn = {path.name for path in written.files if path.parent.name == "figures"}
    assert drawn < before
    assert {path.name for path in made.folder.glob("figures/*")} == drawn | own
    assert not (made.folder / "tables" / "trade.csv").exists()


def test_a_table_needs_no_figures_and_no_torch(made):
    code = (
        "import sys, reports; reports.table_text(sys.argv[1]);"
        "heavy = {'torch', 'matplotlib'} & set(sys.modules); sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(made.job().folder)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_every_figure_is_written_as_svg_and_pdf_where_that_is_asked(made, capsys):
    made.job("a").job("b", psnr=31.0).timing("a").timing("b").trade("a")
    words = ["neubtf-bench", "report", "runs/quick", "--vector"]
    assert " ".join(words) in (Path(__file__).parents[2] / "docs" / "reports.md").read_text(encoding="utf-8")
    assert cli.main([str(made.folder) if word == "runs/quick" else word for word in words[1:]]) == 0
    names = {path.name for path in (made.folder / "figures").iterdir()}
    pictures = {name.removesuffix(".png") for name in names if name.endswith(".png")}
    assert {"contact-satin", "abrdf-satin", "significance-satin"} <= pictures
    assert names == {f"{name}.{suffix}" for name in pictures for suffix in ("png", "svg", "pdf")}
    first = {path.name: path.read_bytes() for path in (made.folder / "figures").iterdir()}
    assert all(text.startswith(b"%PDF-") for name, text in first.items() if name.endswith(".pdf"))
    assert all(b"</svg>" in text for name, text in first.items() if name.endswith(".svg"))
    write_report(made.folder, vector=True)
    assert first == {path.name: path.read_bytes() for path in (made.folder / "figures").iterdir()}
    write_report(made.folder)  # as `run` into the same folder does
    assert first == {path.name: path.read_bytes() for path in (made.folder / "figures").iterdir()}


@pytest.mark.long
def test_a_report_draws_the_formats_again_that_are_there(made):
    made.job("a").job("b", psnr=31.0)
    write_report(made.folder)
    figures = made.folder / "figures"
    (one,) = figures.glob("significance-satin.png")
    (figures / "significance-satin.svg").write_text("of an earlier report")
    (figures / "significance-mine.svg").write_text("of no material of the run, so perhaps a user's own")
    write_report(made.folder)
    assert "</svg>" in one.with_suffix(".svg").read_text()
    assert (figures / "significance-mine.svg").exists()
    assert not list(figures.glob("*.pdf"))
