import json
import re

import pytest
from junitparser import Error, Failure, JUnitXml, Skipped

from bench.compare.comparison import compare
from bench.compare.forms import FILES, annotations, command, junit, tracker
from bench.records import MOST_DB
from reports.comparison import markdown, terminal

AWKWARD = 'my|codec <b>a</b> channels=7 name="π, 50 %: x" [1](2) and some more words'


@pytest.fixture
def base(make):
    labels = ["mean-colour", "pca", "vq", "gone", "fails", "other"]
    jobs = [make.job(label, seed=seed, psnr=30 + 0.1 * seed * (label == "vq")) for label in labels for seed in range(3)]
    jobs += [make.job(AWKWARD, "a/material", seed) for seed in range(3)]
    return make.run("base", *jobs, make.timing("mean-colour", ns=100), make.timing("pca", ns=300))


@pytest.fixture
def mixed(make, base):
    """Every verdict there is, in two materials, with names that each format must escape."""
    jobs = make.three("mean-colour")
    jobs += make.three("pca", psnr=29.5, size=65_920, ssim=0.89)
    jobs += [make.job("vq", seed=seed, psnr=31.0 + 0.1 * seed) for seed in range(3)]
    error = "E: \x1b[31mred\x00\nsecond, line: 5 %"
    jobs += [make.unfinished("failed", "fails", seed=seed, error=error) for seed in (0, 1)]
    jobs += make.three("other", version=2)
    jobs += [make.job(AWKWARD, "a/material", seed, parameters=10**9) for seed in range(3)]
    jobs += [make.job("brand-new", "a/material", seed) for seed in range(3)]
    new = make.run("new", *jobs, make.timing("mean-colour", ns=100), make.timing("pca", ns=600))
    return compare(base, new)


def test_a_terminal_of_120_columns_shows_all_of_it(mixed):
    text = terminal(mixed)
    assert max(map(len, text.splitlines())) <= 120
    assert re.search(r"^pca +3,011 +65,920 \(\+1,920\) +29\.50 +−0\.50 ± 0\.02 .* WORSE$", text, re.M)
    for line in (
        r"WORSE +satin/pca: PSNR 30\.00.*29\.50.*−0\.50.*0\.02",
        r"better +satin/vq: PSNR 30\.10.*31\.10.*\+1\.00",
        "n/c +satin/other: .*version 2.*1",
        "GONE +satin/gone: ",
        r"advice +satin/pca: .*3\.00.*6\.00.*floor",
    ):
        assert re.search(f"^{line}", text, re.M), line
    counts = [("8", "rows"), ("1", "failed"), ("1", "gone"), ("2", "worse"), ("1", "not"), ("1", "better")]
    counts += [("1", "same"), ("1", "new"), ("1", "worse")]  # the last of means of rows
    assert re.findall(r"(\d+) (\w+)", text.splitlines()[-1]) == counts


def test_a_run_of_a_part_is_told_how_to_compare_what_is_there(make):
    base = make.run("base", *(make.job(label, seed=0) for label in ("pca", "vq", "hsh", "table")))
    text = terminal(compare(base, make.run("new", make.job("pca", seed=0))))
    (said,) = [line for line in text.splitlines() if line.startswith("GONE")]
    assert re.search("3 rows.* --material satin --codec pca$", said)
    base = make.run("sweep", *(make.job(f"pca components={number}", seed=0) for number in (1, 2, 4, 8)))
    text = terminal(compare(base, make.run("one", make.job("pca components=4", seed=0))))
    options = [f"--allow 'pca components={number}'" for number in (1, 2, 8)]  # `--codec pca` would choose them, too
    assert " ".join(options) in " ".join(text.split())


def test_markdown_keeps_its_tables_whole_and_shows_names_as_they_stand(mixed):
    text = markdown(mixed)
    assert re.match("### .*8 rows.*1 failed", text)
    for table in re.findall(r"(?:^\|.*\n?)+", text, re.M):
        columns = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
        assert len(columns) == 1, table
    assert r"my\|codec \<b>a\</b>" in text
    assert re.search(r"^\| pca .*\| +29\.50 \| +−0\.50 ± 0\.02 .*❌ worse \|$", text, re.M)
    assert text.count("<details>") == text.count("</details>") == 1


def test_junit_is_read_by_another_program_as_it_was_meant(mixed):
    read = JUnitXml.fromstring(junit(mixed).encode())
    suites = list(read)
    assert [suite.name for suite in suites] == ["satin", "a/material", "all materials"]
    cases = {case.name: case for suite in suites for case in suite}
    assert (read.tests, read.failures, read.errors) == (len(cases), 9, 0)  # one of them in the mean of all codecs
    assert sum(suite.failures for suite in suites) == 9
    assert sum(suite.skipped for suite in suites) == 1
    of_all = [case for case in cases.values() if case.classname.endswith("all codecs") and case.result]
    assert [case.name for case in of_all] == ["all materials/all codecs/PSNR"]
    (failure,) = cases["satin/pca/PSNR"].result
    assert isinstance(failure, Failure)
    assert failure.type == "worse"
    assert re.match(r"PSNR 30\.00.*29\.50.*−0\.50", failure.message)
    assert (cases["satin/pca/PSNR"].classname, cases["satin/pca/FLIP"].result) == ("satin/pca", [])
    assert cases["satin/other/result"].result[0].type == "not comparable"
    assert isinstance(cases["a/material/brand-new/result"].result[0], Skipped)
    assert "[31mred" in cases["satin/fails/result"].result[0].message
    assert cases[f"a/material/{AWKWARD}/parameters"].result[0].type == "worse"
    assert not any(isinstance(result, Error) for case in cases.values() for result in case.result)


def test_annotations_are_one_escaped_line_each(mixed):
    lines = annotations(mixed).splitlines()
    assert all(re.fullmatch(r"::(error|warning) title=[^:,\n]+::[^\n]+", line) for line in lines)
    assert sum(line.startswith("::error ") for line in lines) == 6
    assert any(re.match("::error title=satin/pca::bytes.*64,000.*65,920.*PSNR", line) for line in lines)
    assert any("red second," in line and "5 %25" in line for line in lines)
    assert any(line.startswith("::error title=satin/other::") for line in lines)
    assert any(line.startswith("::warning title=satin/pca::") for line in lines)


def test_a_workflow_command_is_taken_apart_as_it_was_put_together():
    title, message = "a: b, 5 %0A", "c::d, 5 %\r\ne"
    kind, properties, data = re.fullmatch(r"::(\w+) (.*?)::(.*)", command("error", title, message)).groups()
    back = {"%0D": "\r", "%0A": "\n", "%3A": ":", "%2C": ",", "%25": "%"}
    name, _, value = properties.partition("=")
    unescaped = [re.sub("%[0-9A-F]{2}", lambda m: back[m[0]], text) for text in (value, data)]
    assert (kind, name, *unescaped) == ("error", "title", title, message)


def test_of_many_regressions_the_last_annotation_counts_the_rest(make):
    jobs = [make.job(f"codec-{i}") for i in range(14)]
    lines = annotations(compare(make.run("base", *jobs), make.run("new", make.job("codec-0")))).splitlines()
    assert len(lines) == 10
    assert re.match("::error title=4.*satin/codec-10.*satin/codec-11", lines[-1])


def test_the_tracker_gets_numbers_by_direction(make):
    jobs = [make.job("vq", seed=seed, psnr=30.0 + seed) for seed in range(3)] + [make.job("table", psnr=100.0)]
    jobs += [make.job("mean-colour"), make.unfinished("failed", "pca")]
    run = make.run("new", *jobs, make.timing("mean-colour", ns=100), make.timing("vq", ns=250))
    files = {name: json.loads(text) for name, text in tracker(run).items()}
    assert set(files) == set(FILES.values())
    higher, lower = ({entry["name"]: entry for entry in files[FILES[side]]} for side in ("higher", "lower"))
    psnr = {"name": "satin/vq/PSNR", "unit": "dB", "value": 31.0, "range": "± 1", "extra": "3 seeds"}
    assert higher["satin/vq/PSNR"] == psnr
    assert {"satin/vq/FLIP", "satin/vq/bytes", "satin/vq/parameters", "satin/vq/time"} <= set(lower)
    assert (lower["satin/vq/time"]["value"], lower["satin/vq/time"]["unit"]) == (2.5, "× floor")
    assert higher["satin/table/PSNR"]["value"] == MOST_DB  # every slice is exact
    assert not any("pca" in name for name in [*higher, *lower])
    assert all(isinstance(entry["value"], float | int) for entry in [*higher.values(), *lower.values()])


def test_a_number_of_another_version_that_does_not_decide_has_no_change(make):
    base = make.run("base", *make.three())
    text = terminal(compare(base, make.run("new", *make.three(ssim=0.7, versions={"ssim_periodic": 2}))))
    assert re.search(r"everything else\n.*^pca +n/c", text, re.M | re.S)
    assert "0.2000" not in text
