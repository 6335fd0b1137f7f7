import pytest

from bench import metrics, records
from bench.records.fields import fault_of

STATS = {"pooled": 30.0}


def job(**groups):
    return {"label": "a", "scores": {name: {"metrics": dict.fromkeys(names, STATS)} for name, names in groups.items()}}


def test_held_out_pairs_decide_and_all_pairs_where_there_are_none():
    assert records.deciding_group({"all": 0, "train": 0, "heldout": 0}) == "heldout"
    assert records.deciding_group(["all", "train"]) == "all"
    assert records.metrics_of(job(all=["b"], heldout=["a"])) == {"a": STATS}
    assert records.metrics_of(job(all=["b"], train=["c"])) == {"b": STATS}
    assert records.metrics_of(job(all=["b"]), "train") == {}


def test_a_family_is_its_own_name_or_a_variant_and_no_other_word():
    names = ["ssimilar", "ssim_periodic", "flip_ldr_20ppd"]
    assert metrics.metric_of(names, "ssim") == "ssim_periodic"
    assert metrics.metric_of(names, records.FLIP) == "flip_ldr_20ppd"
    assert metrics.metric_of([*names, "flip_ldr_67ppd_periodic"], records.FLIP) == "flip_ldr_67ppd_periodic"
    assert metrics.metric_of(["ssim_of_another_package"], "ssim") == ""
    assert metrics.metric_of(["flip_hdr_hable_67ppd"], "flip_hdr") == ""
    assert metrics.metric_of(names, records.PSNR) == ""
    assert metrics.stats_of(job(heldout=names), "ssim") == STATS
    assert metrics.stats_of(job(heldout=names), records.PSNR) == {}


def test_a_record_is_flattened_to_numbers_by_path():
    record = {"label": "a", "kind": "job", "bytes": {"total": 3}, "frames": [1, 2], "history": [{"step": 1}]}
    record |= {"long": list(range(100)), "score_key": {"metrics": {"ssim": 2}}}
    numbers = records.flattened(record, {"interval95_ns": [1.0, 2.0], "samples_ns": [1.0], "run": "1"})
    assert {name: value for name, value in numbers.items() if value is not None} == {
        "label": "a",
        "metric_version/ssim": 2,
        "bytes/total": 3,
        "frames/0": 1,
        "frames/1": 2,
        "timing/interval95_ns/0": 1.0,
        "timing/interval95_ns/1": 2.0,
    }


def test_a_record_keeps_of_scores_what_something_reads():
    every = {"mean": 30.0, "std": 1.0, "pooled": 29.0, "exact": 0, "slices": 4, "worst": 20.0, "relative": 0.1}
    names = (records.PSNR, "psnr_log1p", records.RMSE, "ssim_periodic", "flip_ldr_67ppd_periodic")
    group = {"slices": 4, "radiance": 0.5, "metrics": dict.fromkeys(names, every)}
    parts = ("heldout, new view", "heldout, new view, grazing light", "train, grazing light", "grazing light")
    scores = dict.fromkeys(("all", "heldout", "validation", "low light", "scene", "scene, held out", *parts), group)
    mean_psnr = {"mean": 30.0, "exact": 0, "slices": 4}
    of_part = {records.PSNR: mean_psnr, records.RMSE: {"pooled": 29.0, "relative": 0.1}}
    fitted = dict.fromkeys((records.PSNR, "ssim_periodic", "flip_ldr_67ppd_periodic"), mean_psnr | {"std": 1.0})
    read = metrics.read_scores(scores)
    assert {name: found["metrics"] for name, found in read.items()} == {
        "all": fitted,
        "heldout": group["metrics"],
        "validation": {records.PSNR: mean_psnr | {"pooled": 29.0}},
        "low light": of_part,
        "scene": group["metrics"],
        "scene, held out": {records.PSNR: mean_psnr},
        "heldout, new view": of_part,
    }
    assert {found["slices"] for found in read.values()} == {4}
    assert metrics.read_scores(read) == read
    # Where no pairs are held out, all pairs decide, and their parts are read.
    assert list(metrics.read_scores(dict.fromkeys(("all", "all, grazing view"), group))) == ["all", "all, grazing view"]
    assert metrics.read_scores({"all": group})["all"]["metrics"] == group["metrics"]


@pytest.mark.parametrize(
    ("record", "said"),
    [
        ({"slices": {"a": 3}}, "slices/a must be a valid string, not 3"),
        ({"slices": 3}, "slices must be a valid string or a valid dictionary, not 3"),
        ({"shape": [1]}, "shape must have at least 2 items, not [1]"),
        ({"shape": {"a": 1}}, "shape must be a valid list, not an object of 1 fields"),
    ],
)
def test_a_fault_names_the_place_and_what_stands_there(record, said):
    assert fault_of(records.Job, record) == said
