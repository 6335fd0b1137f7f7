from bench import metrics, records

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
