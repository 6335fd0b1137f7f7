import base64
import json
import re
import zlib
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import torch

from bench import cli
from bench.btf import BAKED, RENDERED
from bench.codec import Fit
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import InputError
from bench.program.recording import program_of
from bench.records import append, load_run
from reports.board import Codec, Publication, write_site
from reports.board.sources import page_name, with_files

ROOT = Path(__file__).parents[2]
HOSTILE = ('"><script>bad()</script>', "</script><script>bad()</script>", "' onerror='bad()", "../../up", "\ud800")
CITED = Codec("About it.", "mine:Mine of mine 1", "@article{a,\n}", "https://doi.org/10/a", "https://example.org/")


class Links(HTMLParser):
    """The targets of a page's links, its ids, and the addresses that a browser would load."""

    def __init__(self, text):
        super().__init__()
        self.links, self.ids, self.loaded = [], set(), []
        self.feed(re.sub(r"(<script)[^>]*>.*?(</script>)", r"\1>\2", text, flags=re.S))

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        self.ids |= {known["id"]} if "id" in known else set()
        self.links += [known["href"]] if tag == "a" else []
        self.loaded += [known[name] for name in ("src", "href") if name in known and tag != "a"]


def dead_links(site):
    pages = {path.name: Links(path.read_text(encoding="utf-8")) for path in site.glob("*.html")}
    dead = [(name, url) for name, page in pages.items() for url in page.loaded if not url.startswith("data:")]
    for name, page in pages.items():
        for target in page.links:
            if not target.startswith("https://"):
                there, _, anchor = unquote(target).partition("#")
                other = pages.get(there or name)
                if other is None or (anchor and anchor not in other.ids):
                    dead.append((name, target))
    return dead


def write(site, *records, runs=(), codecs=None):
    write_site([Publication(f"source{i}", run) for i, run in enumerate(records)], list(runs), codecs or {}, site)
    return {path.name: path.read_text(encoding="utf-8") for path in site.glob("*.html")}


def text_of(page):
    return unescape(re.sub(r"<script.*?</script>|<style.*?</style>|<[^>]+>", " ", page, flags=re.S))


def site_of(records, folder):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        assert cli.main(["report", records, "--site", str(folder / "site")]) == 0
    return folder / "site"


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    return site_of("docs/results/quick.jsonl", tmp_path_factory.mktemp("quick"))


def test_the_site_of_the_records_of_quick_is_whole_and_has_no_dead_link(quick):
    held_whole(quick)


@pytest.mark.long
def test_the_site_of_the_committed_records_is_whole_small_and_has_no_dead_link(tmp_path):
    site = site_of("docs/results", tmp_path)
    held_whole(site)
    assert sum(path.stat().st_size for path in site.iterdir()) < 60e6


def held_whole(site):
    assert dead_links(site) == []
    names = {path.name for path in site.iterdir()}
    assert {"index.html", "material-satin.html", "codec-neumip.html"} <= names


def test_no_picture_of_a_material_is_written_whose_licence_is_not_stated(made, tmp_path):
    """UBO2003 and UBO2014 state none; so of all that is not built in, or made of maps that are CC0."""
    where = {"one": "somewhere, CC0", "two": "somewhere, CC0", "three": "somewhere", "four": "", "five": "CC0"}
    sources = {"one": "measured", "two": BAKED, "three": BAKED, "four": RENDERED}
    append(made.folder, {"kind": "run", "run": "1", "materials": [{"name": n, "where": w} for n, w in where.items()]})
    codec = load_codec("mean-colour")()
    program = program_of(codec.decode(codec.encode(tiny_btf(), Fit()), torch.device("cpu")))
    for name in ("drawn", "truth-f"):  # a codec's, and what the page draws of the data themselves
        np.savez(made.folder / f"{name}.npz", **program.arrays())
    for name, source in sources.items():
        made.job(material=name, provenance={"source": source}, drawing="drawn.npz")
    made.job(material="five", provenance={"source": BAKED}, verified=True, drawing="drawn.npz")
    made.job(material="six", drawing="drawn.npz")
    pages = write(tmp_path / "site", runs=[Publication("mine", load_run(made.folder))])
    for part in ("data:image", "data-live="):
        shown = {name for name in (*where, "six") if part in pages[f"material-{name}.html"]}
        assert shown == {"two", "four"}, part
    assert "No pictures: " in pages["material-one.html"]
    assert not any("data:image" in page for name, page in pages.items() if not name.startswith("material"))


def test_records_get_the_pictures_of_a_run_at_hand_of_the_same_files_alone(made, run_maker, tmp_path):
    built_in = {"source": RENDERED}
    made.job("pca", provenance=built_in).job("vq", "brick", provenance=built_in)
    records = run_maker(tmp_path / "records").start().job("pca", provenance=built_in, slices={}, pictures="none.npz")
    records.job("vq", "brick", provenance=built_in, btf="other", pictures="/etc/passwd")
    published, run = load_run(records.folder), Publication("quick", load_run(made.folder))
    pages = write(tmp_path / "site", published, runs=[run])
    found = json.loads(re.search(r'id="slices0">(.*?)</script>', pages["material-satin.html"])[1])
    assert [codec["label"] for codec in found["codecs"]] == ["pca"]
    assert pages["material-brick.html"].count('id="slices') == 1, "of the run, whose vq is of other data"
    assert ": quick</h2>" in pages["index.html"], "vq of other data is in no records, so the run stands by itself, too"
    assert "data:image" not in write(tmp_path / "site", published)["material-satin.html"]


def test_the_front_says_who_leads_within_budgets(made, tmp_path):
    for label, psnr in (("pca", 25.0), ("neubtf-direct", 28.0), ("relief", 30.5)):
        scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
        made.job(label, bytes={"total": 256}, scores=scores, psnr=psnr)
    front = write(tmp_path / "site", load_run(made.folder))["index.html"]
    assert re.search(r"relief leads .* 2\.5 dB .*neubtf-direct", text_of(front))


def test_each_row_says_whose_word_it_is_and_claims_count_nowhere(made, run_maker, tmp_path):
    seal = {"fitted": {"git": "abc"}, "scored": {"git": "def", "at": "2026-01-02T03"}, "machine": {"processor": "mine"}}
    own = made.job("pca", psnr=30.0, **seal).job("vq", psnr=31.0, verified=True)
    claim = run_maker(tmp_path / "claim").start().job("hero", psnr=99.0, verified=True)
    sources = [Publication("own", load_run(own.folder)), Publication("hero.zip", load_run(claim.folder), claimed=True)]
    write_site(sources, [], {}, tmp_path / "site")
    names = ("index", "material-satin", "codec-pca")
    front, of_satin, of_pca = ((tmp_path / f"site/{name}.html").read_text() for name in names)
    words = " ".join(text_of(of_satin).split())
    assert "pca own run 0 0 abc def mine 2026-01-02" in words
    assert "vq verified 0 0" in words
    assert "hero claimed 0 0" in words
    assert words.count(" verified 0 0") == 1, "what an archive says of itself is no verdict"
    assert "hero" not in front.split('id="materials"')[0]
    assert "vq 1 of 1 1.0 1 31.00" in " ".join(text_of(front).split()), "first by rank, and won"
    assert "<b>31.00</b>" in of_satin, "the best of its source"
    assert "99.00" not in of_pca


def test_strings_of_records_stay_text_and_name_no_other_place(made, tmp_path):
    for name in HOSTILE:
        changes = {"fitted": {"git": name}, "scored": {"git": name, "at": name}, "machine": {"processor": name}}
        made.job(f"pca {name}", material=name, provenance={"source": name}, **changes)
        made.job(f"{name} x=1", material=name).unfinished("failed", name, material=name)
    run = load_run(made.folder)
    site = tmp_path / "site"
    write_site(
        [Publication(name, run, claimed) for name in HOSTILE for claimed in (False, True)], [], {"pca": CITED}, site
    )
    assert {path.parent for path in tmp_path.rglob("*.html")} == {site}
    assert len(list(site.glob("material-*"))) == len(HOSTILE) - 1  # a line with half of a letter is unreadable
    assert dead_links(site) == []
    for path in site.iterdir():
        markup = re.sub(r"<script[^>]*>.*?</script>", "", path.read_text(encoding="utf-8"), flags=re.S)
        assert "<script" not in markup
        assert not re.search(r"""<[^<>"']*("[^"]*"[^<>"']*)*\sonerror=""", markup)


@pytest.mark.long
def test_the_board_needs_no_clone_but_records_and_says_how_to_make_them(made, tmp_path, monkeypatch, capsys):
    made.job("pca")
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    assert cli.main(["report", ".", "--site", "site"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    (command,) = re.findall("`neubtf-bench (results add .*?)`", line)
    add = {"RUN": str(made.folder), "FOLDER/NAME.jsonl": "kept.jsonl"}
    assert cli.main([add.get(word, word) for word in command.split()]) == 0
    assert cli.main(["report", ".", "--site", "site"]) == 0
    assert ": kept</h2>" in Path("site/index.html").read_text(encoding="utf-8")


def test_runs_files_and_folders_of_runs_become_sources_of_one_site(made, run_maker, tmp_path):
    made.job("pca")
    (tmp_path / "runs").mkdir()
    for name in ("a", "b"):
        run_maker(tmp_path / "runs" / name).start().job("vq", material=name)
    assert cli.main(["results", "add", str(made.folder), str(tmp_path / "kept.jsonl")]) == 0
    places = [str(tmp_path / name) for name in ("kept.jsonl", "runs", "run")]
    assert cli.main(["report", *places, "--site", str(tmp_path / "site")]) == 0
    front = (tmp_path / "site/index.html").read_text(encoding="utf-8")
    assert re.findall(": (.*?)</h2>", front) == ["kept", "a", "b"], "all that the last run measured is in records"


def test_a_run_at_hand_says_nothing_of_this_machine(made, tmp_path):
    job = {"provenance": {"source": RENDERED}, "machine": {"host": "my-host", "processor": "mine"}}
    made.job(**job, drawing="gone.npz").unfinished("failed", f"no {Path.home()}/secret").timing(host="my-host")
    job = load_run(made.folder).jobs[1]
    append(made.folder, job | {"traceback": "in my-host"})
    pages = write(tmp_path / "site", runs=[Publication("mine", load_run(made.folder))])
    packed = re.search(r'id="records-data">(.*?)</script>', pages["material-satin.html"])[1]
    told = zlib.decompress(base64.b64decode(packed))[4:].decode() + "".join(pages.values())  # behind its length
    assert "processor" in told
    assert "data:image" in told
    for secret in ("my-host", str(tmp_path), f"{Path.home()}/secret"):
        assert secret not in told, secret


def test_two_sources_never_share_a_name(made):
    run = load_run(made.job().folder)
    claimed = [Publication(name, run, claimed=True) for name in ("a", "a", "a (2)", "a")]
    assert [source.name for source in with_files(claimed, [])] == ["a", "a (2)", "a (2) (2)", "a (3)"]


def test_two_names_never_share_a_page():
    names = ["Satin", "satin", "sa tin", "sa-tin", "", "..", "名", "x" * 300, "index"]
    pages = {page_name("material", name) for name in names}
    assert len(pages) == len(names)
    assert all(re.fullmatch(r"material-[a-z0-9-]{0,80}\.html", page) for page in pages)


def test_pages_that_are_not_made_anew_are_removed_and_other_files_stay(made, tmp_path):
    write(tmp_path, load_run(made.job("vq").folder))
    (tmp_path / "codec-vq.html").rename(tmp_path / "codec-gone.html")
    (tmp_path / "codec-mine.html").write_text("mine")
    write(tmp_path, load_run(made.job().folder))
    names = {"index.html", "codec-mine.html", "codec-pca.html", "codec-vq.html", "material-satin.html"}
    assert {path.name for path in tmp_path.glob("*.html")} == names
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(InputError, match=r"index\.html"):
        write(tmp_path, load_run(made.folder))
    assert (tmp_path / "index.html").read_text() == "mine"


def test_several_sources_need_a_site(made, capsys):
    made.job()
    for places in ([str(made.folder)] * 2, [str(made.folder / "records.jsonl")]):
        assert cli.main(["report", *places]) == 2
        assert "give --site" in capsys.readouterr().err
    assert cli.main(["results", "write"]) == 2
    assert "Markdown" in capsys.readouterr().err


@pytest.mark.long
def test_a_page_asks_for_nothing_and_fits_a_telephone(browser, quick):
    problems = []
    for scheme, width in (("light", 1200), ("dark", 390)):
        tab = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
        tab.on("console", lambda message: problems.append(message.text))
        tab.on("pageerror", lambda error: problems.append(str(error)))
        tab.on("request", lambda request: problems.append(request.url) if request.url.startswith("http") else None)
        for name in ("index", "material-satin", "codec-pca"):
            tab.goto((quick / f"{name}.html").as_uri())
            assert tab.locator("img.figure:visible").count() == 0, (
                "a white picture on dark paper; plots fold with the window"
            )
            tab.locator(".plot svg").first.scroll_into_view_if_needed()
            tab.locator(".plot polygon").first.wait_for(state="attached")
            assert tab.evaluate("document.documentElement.scrollWidth") == width
        tab.keyboard.press("Tab")
        tab.keyboard.press("Tab")
        tab.keyboard.press("Enter")  # past the theme, the link back to the front
        tab.wait_for_url("**/index.html")
        tab.close()
    assert problems == []
