import copy
import functools
import json
import re
import shutil
import zipfile

import numpy as np
import pytest

from bench import cli
from bench.inputs.errors import InputError
from bench.records import FILE, load_run, load_together
from bench.runs.archive import _differences_of_values, unpack
from tests.tiers import long

SUITE = """
materials = ["satin"]
seeds = [0, 1]
data = {size = 12, views = 5, lights = 5, heldout = 8}
codecs = [{codec = "mean-colour"}, {codec = "pca", components = 4}]
"""


@pytest.fixture(scope="module")
def packed(tmp_path_factory):
    place = tmp_path_factory.mktemp("archive")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.timing.TURNS", 3)
        (place / "small.toml").write_text(SUITE)
        assert cli.main(["run", str(place / "small.toml"), "--out", str(place / "run")]) == 0
    assert cli.main(["results", "pack", str(place / "run"), "-o", str(place / "mine.zip")]) == 0
    return place


def altered(packed, path, change=lambda line: line, files=None):
    with zipfile.ZipFile(packed / "mine.zip") as before, zipfile.ZipFile(path, "w") as after:
        for name in before.namelist():
            content = before.read(name)
            if name == FILE:
                lines = [change(json.loads(line)) for line in content.splitlines()]
                content = "".join(json.dumps(line) + "\n" for line in lines).encode()
            after.writestr(name, (files or {}).get(name, content))
    return path


def verified(archive, tmp_path, capsys):
    code = cli.main(["results", "verify", str(archive), "--out", str(tmp_path / "verified")])
    return code, capsys.readouterr().out


def of_kind(kind, **changes):
    return lambda line: line | changes if line["kind"] == kind else line


def change_pca(change):
    def changed(line):
        return change(line) if line["kind"] == "job" and line["codec"] == "pca" and line["seed"] == 1 else line

    return changed


def test_an_honest_archive_agrees_and_makes_a_run_that_tables_read(packed, tmp_path, capsys):
    code, text = verified(packed / "mine.zip", tmp_path, capsys)
    assert (code, text.count(" agrees\n"), "differs" in text) == (0, 4, False)
    ours, theirs = load_run(tmp_path / "verified"), load_run(packed / "run")
    for job in theirs.jobs:
        here = ours.job(job["job"])
        assert (here["scores"], here["bytes"]) == (job["scores"], job["bytes"])
        assert here["verified"]
        assert "verified" not in job
        assert (tmp_path / "verified" / here["file"]).read_bytes() == (packed / "run" / job["file"]).read_bytes()
    assert cli.main(["compare", str(packed / "run"), str(tmp_path / "verified")]) == 0
    # The code that fitted these files is not known here.
    assert cli.main(["results", "pack", str(tmp_path / "verified"), "-o", str(tmp_path / "again.zip")]) == 2
    assert "fit_key/code" in capsys.readouterr().err
    assert not (tmp_path / "again.zip").exists()


def put(path, value):
    """A change of a record: the field at a path becomes `value`, or `value` of what it was."""

    def change(line):
        *places, last = path.split("/")
        held = functools.reduce(dict.get, places, line)
        held[last] = value(held[last]) if callable(value) else value
        return line

    return change


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("scores/heldout/metrics/psnr_display/mean", lambda x: x + 1),
        long("scores/heldout/metrics/psnr_display/pooled", lambda x: x + 0.05),
        ("bytes/total", lambda x: x - 1),
        long("scores/heldout/slices", lambda x: x + 1),
        long("scores/heldout/metrics/another", {"pooled": 1.0}),
        ("footprints/4/psnr_display", lambda x: x + 1),
        ("score_key/sha256", "0" * 64),
        ("fit_key/settings/components", 5),
        long("fit_key/training", "0" * 64),
        long("metrics/psnr_display/version", 9),
        ("parameters", 5),
        ("label", "pca"),
        ("called", "mine"),
        long("label", "pcacomponents=4"),
        long("curve", "vq"),
    ],
)
def test_every_claim_is_compared(packed, tmp_path, capsys, path, value):
    code, text = verified(altered(packed, tmp_path / "a.zip", change_pca(put(path, value))), tmp_path, capsys)
    (line,) = [line for line in text.splitlines() if "differs " in line or " not verified " in line]
    assert code == ("differs " in line)
    assert path.split("/")[-1] in line or "submitted data" in line, line
    assert text.count(" agrees\n") == 3
    verified_run = load_run(tmp_path / "verified")
    assert {job["label"] for job in verified_run.jobs} <= {"mean-colour", "pca components=4"}


def test_what_cannot_be_compared_is_not_published(packed, tmp_path, capsys):
    def boast(line):
        if line["kind"] == "run":
            return line | {"git": "boast", "text": "boast", "packages": {"torch": "boast"}, "device": "boast"}
        stamp = {"git": "boast", "at": "boast"}
        return line | {"fit_seconds": 123.25, "fitted": stamp, "scored": stamp, "history": [{"step": 1, "psnr": 99.0}]}

    code, text = verified(altered(packed, tmp_path / "a.zip", boast), tmp_path, capsys)
    assert (code, text.count(" agrees\n")) == (0, 4)
    published = (tmp_path / "verified" / FILE).read_text()
    assert not any(word in published for word in ("boast", "123.25", "99.0"))


@pytest.mark.parametrize(
    "scores", [{}, {"heldout": {"metrics": {}}}, {"train": {"metrics": {"ssim": {"pooled": 1.0}}}}]
)
def test_where_nothing_is_compared_nothing_is_verified(packed, tmp_path, capsys, scores):
    code, text = verified(altered(packed, tmp_path / "a.zip", of_kind("job", scores=scores)), tmp_path, capsys)
    assert (code, len(re.findall("not verified  .*scores", text))) == (4, 4)


@pytest.mark.parametrize(
    ("key", "value", "why"),
    [
        ("materials", [], "its run does not say how satin was prepared"),
        ("materials", [{"name": 3}], "materials of its run"),
        ("materials", [{"name": "satin", "path": "/etc/passwd"}], "say where it is with --material satin=PATH"),
        ("materials", [{"name": "satin", "path": "../x"}], "leads out of the folder"),
        ("materials", [{"name": "satin", "path": "none.btf"}], "none.btf: there is no such file"),
        ("data", None, "data of satin/mean-colour/0 must be a table"),
        ("data", {"size": 4096, "views": 5, "lights": 5, "heldout": 8}, "would render 6 GiB of satin"),
    ],
)
def test_an_archive_does_not_choose_what_is_opened_or_rendered(packed, tmp_path, capsys, monkeypatch, key, value, why):
    def never(*_):
        raise AssertionError("rendered")

    monkeypatch.setenv("NEUBTF_DATA", str(tmp_path))
    monkeypatch.setattr("bench.data.materials.store._write", never)
    code, text = verified(altered(packed, tmp_path / "a.zip", of_kind("run", **{key: value})), tmp_path, capsys)
    assert (code, text.count(why)) == (4, 4 if key == "materials" or value else 1), text
    assert "internal" not in text


def test_a_material_is_opened_where_the_user_says(packed, tmp_path, capsys):
    change = of_kind("run", materials=[{"name": "satin", "path": "/none"}])
    archive = altered(packed, tmp_path / "a.zip", change)
    (tmp_path / "satin.txt").write_text("not an archive of a known BTF")
    options = ["--out", str(tmp_path / "out"), "--material", f"satin={tmp_path / 'satin.txt'}"]
    assert cli.main(["results", "verify", str(archive), *options]) == 4
    assert "satin.txt: " in capsys.readouterr().out
    # Nothing was measured, so the folder is free for the corrected command.
    assert cli.main(["results", "verify", str(archive), *options[:2], "--material", "silk=/none"]) == 2
    assert "--material silk: " in capsys.readouterr().err


def test_answers_that_are_not_finite_are_said_to_be(packed, tmp_path, capsys, monkeypatch):
    def broken(self, pair, factor=1):
        return np.full((12, 12, 3), np.nan, np.float32)

    monkeypatch.setattr("bench.runs.evaluation.Slices.slice", broken)
    code, text = verified(packed / "mine.zip", tmp_path, capsys)
    assert (code, text.count("finite")) == (4, 4)
    assert "not whole" not in text


def test_an_error_whose_message_cannot_be_shown_leaves_jobs_not_verified(packed, tmp_path, capsys, monkeypatch):
    class MuteError(Exception):
        def __str__(self):
            raise RuntimeError

    def fails(*arguments, **options):
        raise MuteError

    monkeypatch.setattr("bench.runs.archive.evaluate", fails)
    code, text = verified(packed / "mine.zip", tmp_path, capsys)
    assert (code, text.count("cannot be scored here (MuteError")) == (4, 4)


@pytest.mark.parametrize("where", ["absolute", "../secret", "link", "network", "other"])
def test_only_files_of_a_run_whose_hash_is_recorded_are_packed(packed, tmp_path, capsys, where):
    shutil.copytree(packed / "run", tmp_path / "run")
    secret = tmp_path / "secret"
    shutil.copyfile(next((packed / "run" / "files").glob("*pca*.nbtf")), secret)
    (tmp_path / "run" / "files" / "link").symlink_to(secret)
    (tmp_path / "run" / "files" / "other").write_bytes(b"other")
    name = {"absolute": str(secret), "../secret": "../secret", "link": "files/link", "other": "files/other"}.get(where)
    lines = [json.loads(line) for line in (packed / "run" / FILE).read_text().splitlines()]
    for line in lines:
        line.pop("crc32", None)
        if line["kind"] == "job":
            line |= {"file": name} if name else {"fit_key": line["fit_key"] | {"shared": "../../secret"}}
    (tmp_path / "run" / FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert cli.main(["results", "pack", str(tmp_path / "run"), "-o", str(tmp_path / "b.zip")]) == 2
    assert "run" in capsys.readouterr().err
    assert not (tmp_path / "b.zip").exists()


def test_entries_that_overlap_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FILE, "{}")
        archive.writestr("files/a.nbtf", bytes(1 << 20))
        for number in range(5):
            twin = copy.copy(archive.filelist[1])
            twin.filename = f"files/{number}.nbtf"
            archive.filelist.append(twin)
    with pytest.raises(InputError, match=r"a\.zip: files/.*: .*files/"):
        unpack(tmp_path / "a.zip", tmp_path / "inside")


def test_a_large_archive_is_refused_by_what_it_unpacks_to(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.runs.archive.LEAST_BYTES", 1 << 20)
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FILE, "{}")
        for number in range(3):
            archive.writestr(f"files/{number}.nbtf", bytes(1 << 20))
    with pytest.raises(InputError, match=r"a\.zip: .*1 MiB"):
        unpack(tmp_path / "a.zip", tmp_path / "inside")


def test_another_codecs_file_is_found(packed, tmp_path, capsys):
    names = {job["codec"]: job["file"] for job in load_run(packed / "run").jobs}
    swapped = {names["pca"]: (packed / "run" / names["mean-colour"]).read_bytes()}
    code, text = verified(altered(packed, tmp_path / "a.zip", files=swapped), tmp_path, capsys)
    assert code == 1
    assert "codec mean-colour" in text


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda line: line | {"codec": "theirs"}, "codec theirs version 5, code"),
        (lambda line: line | {"score_key": line["score_key"] | {"btf": "0" * 64}}, "differ from the submitted data"),
        (lambda line: {key: value for key, value in line.items() if key != "file"}, "has no 'file'"),
        (lambda line: line | {"file": "files/none.nbtf"}, "none.nbtf"),
    ],
)
def test_what_cannot_be_verified_is_named_and_the_rest_goes_on(packed, tmp_path, capsys, change, why):
    code, text = verified(altered(packed, tmp_path / "a.zip", change_pca(change)), tmp_path, capsys)
    (line,) = [line for line in text.splitlines() if " not verified " in line]
    assert why in line
    assert (text.count(" agrees\n"), code) == (3, 0)


def test_jobs_of_a_start_without_a_name_are_not_verified(packed, tmp_path, capsys):
    def nameless(line):
        return {key: value for key, value in line.items() if key != "run" or line["kind"] != "run"}

    _, text = verified(altered(packed, tmp_path / "a.zip", nameless), tmp_path, capsys)
    assert text.count(" not verified ") == 4


@pytest.mark.parametrize("name", ["../evil.nbtf", "files/../../evil", "/evil", "files/a/b", "other.txt"])
def test_a_foreign_name_is_refused_before_anything_is_unpacked(tmp_path, name):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(FILE, "{}")
        archive.writestr(name, "x")
    with pytest.raises(InputError, match=re.escape(name)):
        unpack(tmp_path / "a.zip", tmp_path / "inside")
    assert not (tmp_path / "inside").exists()


def test_what_is_no_archive_is_refused(tmp_path, capsys):
    (tmp_path / "a.zip").write_bytes(b"PK no")
    assert cli.main(["results", "verify", str(tmp_path / "a.zip"), "--out", str(tmp_path / "out")]) == 2
    assert "a.zip: " in capsys.readouterr().err
    (tmp_path / "folder").mkdir()
    for name in ("none.zip", "folder"):
        assert cli.main(["results", "verify", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
        assert f"{name}: " in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_kept_records_make_the_tables_of_the_run(packed, tmp_path, capsys):
    for _ in range(2):  # adding keeps what is there
        assert cli.main(["results", "add", str(packed / "run"), str(tmp_path / "kept.jsonl")]) == 0
    for kind in ("main", "slices", "angular", "footprints"):
        capsys.readouterr()
        tables = []
        for source in (packed / "run", tmp_path / "kept.jsonl"):
            assert cli.main(["table", kind, str(source), "--format", "markdown"]) == 0
            tables.append(capsys.readouterr().out)
        assert tables[0] == tables[1]
    assert str(packed) not in (tmp_path / "kept.jsonl").read_text()
    damaged = (tmp_path / "kept.jsonl").read_bytes()[:-20]
    (tmp_path / "kept.jsonl").write_bytes(damaged)
    assert cli.main(["results", "add", str(packed / "run"), str(tmp_path / "kept.jsonl")]) == 2
    assert (tmp_path / "kept.jsonl").read_bytes() == damaged


def test_runs_on_other_data_are_not_put_together(packed, tmp_path):
    def other(line):
        return line | {"score_key": line["score_key"] | {"btf": "0" * 64}} if line["kind"] == "job" else line

    with zipfile.ZipFile(altered(packed, tmp_path / "a.zip", other)) as archive:
        (tmp_path / "other.jsonl").write_bytes(archive.read(FILE))
    with pytest.raises(InputError, match="other data"):
        load_together([packed / "run", tmp_path / "other.jsonl"])


def test_tables_of_a_document_come_from_records(packed, tmp_path, capsys):
    results, page = tmp_path / "results.jsonl", tmp_path / "page.md"
    assert cli.main(["results", "add", str(packed / "run"), str(results)]) == 0
    page.write_text(f"# Page\n\n<!-- neubtf-bench table summary {results} -->\nold\n<!-- end -->\n\nWords.\n")
    assert cli.main(["results", "check", str(page)]) == 1
    assert cli.main(["results", "write", str(page)]) == 0
    text = page.read_text()
    assert "mean-colour" in text
    assert text.startswith("# Page\n")
    assert text.endswith("<!-- end -->\n\nWords.\n")
    assert cli.main(["results", "check", str(page)]) == 0
    page.write_text(text.replace(f"summary {results}", f"summary {results} --column PSNR"))
    assert cli.main(["results", "write", str(page)]) == 0
    assert ("SSIM" in text, "SSIM" in page.read_text()) == (True, False)
    page.write_text(text.replace("mean-colour", "mean-color"))
    assert cli.main(["results", "check", str(page)]) == 1


def test_what_stands_around_tables_is_never_lost(packed, tmp_path, capsys):
    block = f"<!-- neubtf-bench table summary {packed / 'run'} -->\r\nold\r\n<!-- end -->\r\n"
    good, bad = tmp_path / "good.md", tmp_path / "bad.md"
    good.write_bytes(f"Words.\r\n{block}".encode())
    bad.write_text(block.replace("<!-- end -->", "more words").replace("\r", "") + block.replace("\r", ""))
    before = good.read_bytes(), bad.read_bytes()
    assert cli.main(["results", "write", str(good), str(bad)]) == 2
    assert f"{bad}, line 1: " in capsys.readouterr().err
    assert (good.read_bytes(), bad.read_bytes()) == before
    assert cli.main(["results", "write", str(good)]) == 0
    assert good.read_bytes().count(b"\r\n") == good.read_bytes().count(b"\n")


def test_results_references_and_measurements_do_not_replace_each_other(packed, tmp_path):
    results, reference, data = tmp_path / "results.jsonl", tmp_path / "reference.jsonl", tmp_path / "data.zip"
    assert cli.main(["results", "add", str(packed / "run"), str(results)]) == 0
    assert cli.main(["compare", str(packed / "run"), "--update", "--wide", "-o", str(reference)]) == 0
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr("picture.png", b"")
    before = [path.read_bytes() for path in (results, reference, data)]
    assert cli.main(["compare", str(packed / "run"), "--update", "--wide", "-o", str(results)]) == 2
    assert cli.main(["results", "add", str(packed / "run"), str(reference)]) == 2
    assert cli.main(["results", "pack", str(packed / "run"), "-o", str(data)]) == 2
    assert [path.read_bytes() for path in (results, reference, data)] == before


KINDS = "run quick; table summary; table --format latex x.jsonl; table main rungs x.jsonl; table main --b x.jsonl"


@pytest.mark.parametrize("words", KINDS.split("; "))
def test_only_tables_of_records_are_written(tmp_path, capsys, words):
    (tmp_path / "page.md").write_text(f"<!-- neubtf-bench {words} -->\n<!-- end -->\n")
    assert cli.main(["results", "write", str(tmp_path / "page.md")]) == 2
    assert "table [KIND]" in capsys.readouterr().err


def test_an_archive_that_inflates_beyond_all_proportion_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(FILE, "{}")
        with archive.open("files/a.nbtf", "w") as file:
            for _ in range(65):
                file.write(bytes(1 << 20))
    with pytest.raises(InputError, match=r"a\.zip: files/a\.nbtf: .*68157440"):
        unpack(tmp_path / "a.zip", tmp_path / "inside")


def test_an_archive_without_jobs_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.writestr(FILE, "")
    with pytest.raises(InputError, match=r"a\.zip: its records have no job"):
        unpack(tmp_path / "a.zip", tmp_path / "inside")


@pytest.mark.parametrize("claimed", ["12.5", {"mean": 12.5}, [12.5], None])
def test_a_claim_of_another_type_than_the_measurement_differs(claimed):
    (difference,) = _differences_of_values("scores/all", claimed, 12.5)
    assert difference.startswith("scores/all is 12.5, not ")
