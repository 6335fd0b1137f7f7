import re
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.codecs.registry import current_versions
from bench.compare.frame import EAGER, frame_of
from bench.records import append, load_run, load_together
from bench.records.schema import setting_name
from reports.front import front_table
from reports.numbers import fixed, signed, significant
from reports.tables import all_tables

QUICK = Path(__file__).parents[3] / "docs" / "results" / "quick.jsonl"
PSNR = "psnr_display"
TEST, VALIDATION = (f"scores/{group}/metrics/{PSNR}/mean" for group in ("heldout", "validation"))
SIDE, ENOUGH = 64, 32
AGAINST = "neubtf-direct"


def job(label, material="satin", seed=0, test=30.0, validation=30.0, size=8192, **more):
    scores = {}
    for group, mean in (("heldout", test), ("validation", validation)):
        stats = {"mean": mean, "pooled": mean, "std": 0.5, "exact": 0, "slices": 4}
        scores[group] = {"slices": 4, "metrics": {PSNR: stats}}
    record = {"kind": "job", "job": f"{material}/{label}/{seed}", "run": "1", "material": material, "label": label}
    record |= {"codec": label.split()[0], "seed": seed, "status": "ok", "shape": [SIDE, SIDE], "scores": scores}
    record |= {"score_key": {"btf": f"of {material}", "exposure": 1.0}, "settings": {}, "parameters": 1}
    record |= {"metrics": {PSNR: {"unit": "dB", "direction": "higher", "space": "display", "version": 2}}}
    record |= {"bytes": {"total": size}, "footprints": {"2": {"mean": 31.0}}, "fit_seconds": 4.0}
    return record | more


def timing(name, median, **more):
    record = {"kind": "timing", "job": name, "run": "1", "ns_per_sample": 10.0, "interval95_ns": [9.0, 11.0]}
    record |= {
        "ratio_to_floor": median,
        "ratio_interval95": [median - 1, median + 1],
        "device": "cpu",
        "dtype": "float32",
    }
    return record | {"batch": 1, "execution": "eager"} | more


@pytest.fixture
def write(tmp_path):
    def written(*records, folder="run"):
        (tmp_path / folder).mkdir()
        start = {"kind": "run", "run": "1", "suite": "made", "git": "abc", "machine": {"processor": "P", "cores": 2}}
        for record in (start, *records):
            append(tmp_path / folder, record)
        return tmp_path / folder

    return written


def test_two_programs_behind_the_codec_command_are_two_methods(write):
    command = {"codec": "command", "settings": {"seconds": 3600.0}}
    folder = write(*(job(f"{name} seconds=9", **command, called=name) for name in ("mine", "theirs")), job("pca"))
    frame = bench.load_runs(folder)
    assert list(frame["codec"]) == list(frame["line"]) == ["mine", "theirs", "pca"]


def test_a_row_names_its_job_and_has_its_numbers(write):
    published = {"settings": {"recipe": "paper"}, "fit_key": {"version": 3, "threads": 1}}
    provenance = {"provenance": {"path_version": 1}}
    folder = write(job("neumip recipe=paper x=1", seed=2, size=4097, **published, **provenance), job("pca", "wool"))
    frame = frame_of(load_run(folder))
    first, second = frame.to_dict("records")
    expected = {"material": "satin", "surface": "path-traced", "codec": "neumip", "recipe": "paper", "seed": 2}
    expected |= {"line": "neumip, as published", "setting": "x=1", "label": "neumip recipe=paper x=1", "why": ""}
    expected |= {"bits": 8 * 4097 / SIDE**2, TEST: 30.0, "footprints/2/mean": 31.0, "fit_seconds": 4.0}
    expected |= {"codec_version": 3, "git": "abc", "processor": "P", "suite": "made", "status": "ok"}
    assert {name: first[name] for name in expected} == expected
    assert (second["line"], second["setting"], second["recipe"], second["surface"]) == (
        "pca",
        "default",
        "",
        "measured",
    )
    assert np.isnan([second["codec_version"], first["eager"], first["fused"], first["gpu"]]).all()
    assert frame.equals(bench.load_runs(folder).drop(columns="folder"))


def test_why_a_row_has_no_number_to_show_stands_in_a_column(write):
    failed = {"kind": "job", "job": "satin/vq/0", "run": "1", "material": "satin", "codec": "vq", "label": "vq"}
    failed |= {"seed": 0}
    failed |= {"status": "failed", "error": "RuntimeError:\n  no luck"}
    other = job("a x=1", score_key={"btf": "other", "exposure": 1.0}, run="0")
    bare = job("hand", "wool")
    del bare["score_key"]
    infinite = job("exact", test=None)
    frame = frame_of(load_run(write(other, job("a x=2"), failed, bare, infinite))).set_index("label")
    why = frame["why"].to_dict()
    assert {label for label in why if not why[label]} == {"a x=2", "exact"}
    for label, named in (("a x=1", "fingerprint"), ("vq", "RuntimeError: no luck"), ("hand", "score_key")):
        assert named in why[label]
    assert frame.loc["vq", "surface"] == "measured"  # of its material
    assert frame[TEST].dtype == frame["bits"].dtype == float
    assert np.isnan([frame.loc["vq", TEST], frame.loc["vq", "bits"], frame.loc["exact", TEST]]).all()


def test_what_cannot_be_made_again_says_why(write):
    now = current_versions("pca")
    old = job("pca x=1", fit_key=now | {"version": 1})
    frame = frame_of(load_run(write(job("pca", "wool", fit_key=now), old, job("no-such-codec"))))
    none, stale, outside = frame["stale"]
    assert none == outside == ""
    assert re.search(f"version 1 .*{now['version']}$", stale)


def test_a_model_of_a_scene_is_marked(write):
    frame = frame_of(load_run(write(job("a"), job("a scene", settings={"scene": True}))))
    assert list(frame["fitted_to_scene"]) == [False, True]


def test_times_are_those_of_settings_where_there_are_any_and_otherwise_of_surfaces(write):
    jobs = [job("a x=1"), job("a x=2")]
    of_surface = timing("satin/a x=1/0", 5.0)
    assert frame_of(load_run(write(*jobs, of_surface)))["eager"].tolist()[0] == 5.0
    of_setting = timing(setting_name("a x=2", 0), 7.0, label="a x=2", rounds=[6.0])
    eager = frame_of(load_run(write(*jobs, of_surface, of_setting, folder="settings")))["eager"].tolist()
    assert np.isnan(eager[0])
    assert eager[1] == 7.0


def test_times_of_one_kernel_and_of_a_gpu_have_columns(write):
    quality = {
        "codec": "a",
        "settings": {},
        "score_key": {},
        "psnr": 20.0,
        "worst": 9.0,
        "flip": 0.1,
        "bytes": 10,
        "limit_ns": 0.1,
    }
    what = {"material": "satin", "label": "a", "of": "satin/a/0", "execution": "fused", "threads": 1}
    fused = timing("satin/a/0/fused", 3.0, **what, **quality)
    folder = write(job("a"), job("a", "wool"), job("b"), fused)
    of = {"label": "a", "device": "cuda", "of_tolerance": 0.1}
    slower = timing("any surface/a/1", 9.0, ns_per_sample=20.0, **of)
    on_gpu = write(slower, timing("any surface/a/2", 4.0, execution="fused", **of), folder="gpu")
    alone = frame_of(load_run(folder))
    np.testing.assert_array_equal(alone["fused"], [3.0, np.nan, np.nan])
    assert alone["gpu"].isna().all()
    for frame in (bench.load_runs([folder, on_gpu]), frame_of(load_together([on_gpu, folder]))):
        np.testing.assert_array_equal(frame["gpu"], [4.0, 4.0, np.nan])


def test_units_and_directions_are_known_by_column(write):
    attributes = bench.load_runs(write(job("a"))).attrs
    units = {TEST: "dB", "footprints/2/mean": "dB", "bits": "bits a texel", "eager": "× floor", "fit_seconds": "s"}
    assert {name: attributes["units"][name] for name in units} == units
    directions = {TEST: "higher", "footprints/2/mean": "higher", "bits": "lower", "gpu": "lower"}
    assert {name: attributes["directions"][name] for name in directions} == directions
    std, count = (TEST.replace("/mean", name) for name in ("/std", "/slices"))
    assert attributes["units"][std] == "dB"
    assert std not in attributes["directions"]
    assert count not in attributes["units"]


def test_a_free_field_of_a_record_takes_the_place_of_no_column(write):
    assert list(frame_of(load_run(write(job("a", why="mine", line="mine"))))[["why", "line"]].iloc[0]) == ["", "a"]


def test_the_frame_has_the_numbers_of_the_tables_of_a_run():
    frame = bench.load_runs(QUICK)
    numbers = frame.groupby(["material", "label"]).mean(numeric_only=True)
    std = TEST.replace("/mean", "/std")
    compared = 0
    for table in all_tables(load_run(QUICK)):
        for row in table.rows:
            if table.kind not in ("main", "footprints"):
                continue
            of = numbers.loc[table.title.split(":")[0].split(" (")[0], row[0].removesuffix(" †")]
            cells = dict(zip(map(" ".join, table.headers), row, strict=True))
            if table.kind == "main":
                expected = {"PSNR dB ↑ ± slices": f"{fixed(of[TEST], 2)} ± {fixed(of[std], 2)}"}
                expected["total bytes ↓"] = f"{of['bytes/total']:,.0f}"
                expected["time × floor ↓"] = significant(of["timing/ratio_to_floor"])
            else:
                expected = {"2 texels dB ↑": fixed(of["footprints/2/mean"], 2)}
            assert {name: cells[name] for name in expected} == expected
            compared += 1
    assert compared == 2 * len(numbers)


KINDS = {"measured": {}, "path-traced": {"path_version": 1}, "rendered": {"renderer_version": 1}}
SURFACES = {"silk": "measured", "rock": "path-traced", "brick": "path-traced", "satin": "rendered"}


def rungs():
    """Two lines with curves over bytes on four surfaces, with two seeds a rung, and one with a single rung."""
    for place, (material, kind) in enumerate(SURFACES.items()):
        for step in range(4):
            for seed in range(2):
                for line, lead in ((AGAINST, 0.0), ("relief", 1.3 - 0.5 * place)):
                    score = 20.0 + 3.1 * place + 4.0 * step**0.7 + lead + 0.4 * seed
                    label = f"{line} x={step}"
                    size = 2**step * SIDE**2 // 2 + 100 * place
                    record = job(label, material, seed, score - 0.2, score, size, provenance=KINDS[kind])
                    yield record
                    yield timing(record["job"], 3.0 + step + place)
        yield job("vq", material, 0, 15.0 + place, 15.0, 2 * SIDE**2, provenance=KINDS[kind])


def hull(rungs):
    """The curve of the rungs of a line on a surface: log2 of bits, test PSNR, time; chosen by validation."""
    keep = []
    for rung in rungs.assign(x=np.log2(rungs["bits"])).sort_values("x").itertuples():
        if keep and rung.valid <= keep[-1].valid:
            continue
        while len(keep) > 1 and np.linalg.det([[1, p.x, p.valid] for p in (*keep[-2:], rung)]) >= 0:
            keep.pop()  # it lies below the line between its neighbours
        keep.append(rung)
    return np.array([(rung.x, rung.test, rung.eager) for rung in keep]).T


def gap(ours, theirs):
    """The mean difference of two curves over the sizes that both have."""
    x = np.linspace(max(ours[0][0], theirs[0][0]), min(ours[0][-1], theirs[0][-1]), 4001)
    gaps = np.interp(x, *ours[:2]) - np.interp(x, *theirs[:2])
    return (gaps.sum() - (gaps[0] + gaps[-1]) / 2) / (len(x) - 1)  # by the trapezoidal rule


def test_the_front_is_a_few_groups_of_the_frame(write):
    """Every number of PSNR, lead and time in the table of the front follows from the columns of the frame alone."""
    folder = write(*rungs())
    frame = bench.load_runs(folder).query("status == 'ok' and why == '' and not fitted_to_scene")
    columns = {"bits": ("bits", "mean"), "valid": (VALIDATION, "mean"), "test": (TEST, "mean"), EAGER: (EAGER, "first")}
    means = frame.groupby(["line", "label", "material", "surface"]).agg(**columns).reset_index()
    within = means[means["bits"] <= ENOUGH].sort_values("valid").groupby(["line", "material"]).tail(1)
    of_line = {line: cells.groupby("material") for line, cells in means.groupby("line")}
    curves = {line: {name: hull(group) for name, group in groups} for line, groups in of_line.items() if line != "vq"}
    value, time = {}, {}
    for line, by in curves.items():
        value[line] = {name: np.interp(np.log2(ENOUGH), sizes, test) for name, (sizes, test, _) in by.items()}
        # Of the files between which PSNR is read off, in the same shares.
        time[line] = {name: np.interp(np.log2(ENOUGH), sizes, eager) for name, (sizes, _, eager) in by.items()}
    value["vq"] = within[within["line"] == "vq"].set_index("material")["test"].to_dict()
    table = next(front_table(load_run(folder)))
    assert [row[0] for row in table.rows] == ["relief", AGAINST, "vq"]  # the largest lead first
    for row in table.rows:
        line = row[0]
        mark = "≥" if line == "vq" else ""
        cells = []
        for kind in KINDS:
            of_kind = [value[line][name] for name, each in SURFACES.items() if kind == each]
            cells.append(mark + fixed(np.median(of_kind), 1))
        assert row[1:4] == cells
        assert row[-1] == significant(np.median(list(time[line].values())) if line in time else None)
    leads = [gap(curves["relief"][name], curves[AGAINST][name]) for name in SURFACES]
    lead_of = {row[0]: row[4] for row in table.rows}
    assert lead_of["relief"] == signed(np.median(leads), 1)
