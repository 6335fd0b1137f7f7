import numpy as np
import pytest

from bench.compare.paired import Cell, Interval, against, decibels, interval_of, packed, told_apart, unpacked
from bench.compare.statistics import interval_over_slices, student
from bench.inputs.errors import InputError
from bench.records import FILE, MOST_DB, load_together


def test_pairing_takes_away_what_both_share_and_keeps_what_they_do_not():
    rng = np.random.default_rng(0)
    hard = rng.normal(25, 6, 150)
    gain = interval_of([Cell(0, "a", hard + 0.2 + rng.normal(0, 0.3, 150) - hard)])
    assert gain.low < 0.2 < gain.high
    assert gain.low > 0
    assert gain.high - gain.low < 0.15  # 2 · 1.96 · 0.3 / √150 = 0.1, where the means alone are known to ± 1 dB


def test_seeds_that_differ_widen_the_interval():
    rng = np.random.default_rng(2)

    def of_seeds(*centres):
        return interval_of([Cell(seed, "a", rng.normal(centre, 0.1, 100)) for seed, centre in enumerate(centres)])

    alike, apart = of_seeds(0, 0, 0, 0), of_seeds(-1, 1, -0.5, 0.5)
    assert apart.high - apart.low > 5 * (alike.high - alike.low)
    assert (apart.materials, apart.seeds, apart.chance) == (1, 4, 1)  # one material says nothing of others


def test_over_materials_it_is_student_s_of_the_differences_of_means_over_all_seeds(make):
    psnr_of = {"pca": [(30.0, 32.0), (20.0, 20.0), (25.0, 25.0)], "vq": [(32.0,), (22.0,), (29.0,)]}
    jobs = []
    for label, psnrs in psnr_of.items():
        for number, of_seeds in enumerate(psnrs):
            jobs += [make.job(label, f"m{number}", seed=seed, psnr=psnr) for seed, psnr in enumerate(of_seeds)]
    difference = against(make.run("run", *jobs), "pca", ["vq"]).over["vq"]
    means = np.array([1.0, 2.0, 4.0])
    reach, chance = student(means)
    assert (difference.mean, difference.low) == pytest.approx((means.mean(), means.mean() - reach))
    assert (difference.materials, difference.seeds, difference.chance) == (3, 2, chance)
    assert against(make.run("two", *jobs[:-1]), "pca", ["vq"]).over == {}  # it would be over fewer materials


@pytest.mark.parametrize("pairs", ["aaa", "aba", "abc"])
def test_of_one_material_it_is_a_bootstrap_of_seeds_and_their_pairs(pairs):
    slices = np.random.default_rng(3).normal(0, 1, (3, 50))
    difference = interval_of([Cell(seed, pairs[seed], slices[seed]) for seed in range(3)])
    assert (difference.low, difference.high) == interval_over_slices(slices, pairs)


def test_codecs_are_told_apart_from_one_by_holm_over_the_rows():
    chances = {"a": 0.026, "b": 0.016, "c": 0.04}
    rows = {label: Interval(1.0, 0.0, 2.0, 9, 1, chance) for label, chance in chances.items()}
    assert {label: each.apart for label, each in told_apart(rows).items()} == {"a": False, "b": True, "c": False}
    assert list(told_apart(rows)) == ["a", "b", "c"]
    assert not told_apart({"a": Interval(1.0, 0.5, 2.0, 1, 1)})["a"].apart
    assert told_apart({"a": Interval(1.0, 0.1, 1.9, 9, 1, 0.04)})["a"].apart


def test_codecs_of_a_run_are_compared_at_the_slices_of_their_records(make, tmp_path):
    rng = np.random.default_rng(4)
    error = 10 ** rng.normal(-2, 0.5, 40)
    jobs = []
    for label, factor in (("pca", 1.0), ("vq", 2.0)):
        for seed in range(2):
            name = f"{label}{seed}.npz"
            np.savez(tmp_path / name, psnr_display=np.append(error * factor, 0.0), heldout=np.ones(41, bool))
            jobs.append(make.job(label, seed=seed) | {"slices": f"../{name}"})
    run = make.run("run", *jobs)
    for labels in (("vp", ["vq"]), ("pca", ["vq", "table"])):
        with pytest.raises(InputError, match=r"pca; vq$"):
            against(run, *labels)
    whole = against(run, "pca", ["vq"])
    difference = whole.over["vq"]
    # One of 41 slices has no error, so as many dB in both.
    assert difference.mean == pytest.approx(-10 * np.log10(2) * 40 / 41)
    assert (difference.seeds, list(whole.over), whole.on) == (2, ["vq"], {"satin": {"vq": difference}})
    ours = make.run("ours", *(job | {"settings": {"recipe": "ours"}} if job["label"] == "vq" else job for job in jobs))
    assert against(ours, "pca", ["vq"]).over == {"vq": difference}  # as tables call it
    one_seed = against(make.run("one seed", *jobs[:3]), "pca", ["vq"]).over["vq"]  # with each of the two of the other
    assert one_seed.mean == pytest.approx(difference.mean)
    without_slices = {name: value for name, value in jobs[3].items() if name != "slices"}
    assert against(make.run("slices of one", *jobs[:3], without_slices), "pca", ["vq"]).over == {}


def test_codecs_of_a_reference_whose_jobs_name_no_run_are_compared(make):
    jobs = []
    for label, decibels_of_slices in (("pca", 30.0), ("vq", 31.0)):
        job = make.job(label) | {"slices": {"psnr_display": packed(np.full(5, decibels_of_slices))}}
        del job["run"]
        jobs.append(job)
    assert against(make.run("reference", *jobs), "pca", ["vq"]).over["vq"].mean == 1.0
    del jobs[1]["score_key"]
    assert against(make.run("unknown pairs", *jobs), "pca", ["vq"]).over == {}


def test_a_job_beside_published_ones_has_the_slices_of_its_own_folder(make, tmp_path):
    make.run("published", make.job(btf="published"))
    (tmp_path / "published" / FILE).rename(tmp_path / "published.jsonl")
    for folder, error in (("other", 0.01), ("last", 0.1)):
        make.run(folder, make.job(label=folder) if folder == "last" else make.job(btf="b") | {"slices": "pca.npz"})
        np.savez(tmp_path / folder / "pca.npz", psnr_display=np.full(3, error), heldout=np.ones(3, bool))
    run = load_together([tmp_path / "published.jsonl", tmp_path / "other", tmp_path / "last"], beside=True)
    assert decibels(run.folder, run.job("satin/pca/0, other data of other")).tolist() == [20.0] * 3


def test_slices_that_cannot_be_read_cost_their_codec_alone(make, tmp_path):
    error = np.linspace(0.01, 0.1, 10)
    jobs = []
    for label in ("pca", "vq", "table"):
        np.savez(tmp_path / f"{label}.npz", psnr_display=error, heldout=np.ones(10, bool))
        jobs.append(make.job(label) | {"slices": f"../{label}.npz"})
    (tmp_path / "vq.npz").write_bytes(b"no archive")
    readable = against(make.run("run", *jobs), "pca", ["vq", "table"])
    assert list(readable.over) == ["table"]
    (tmp_path / "pca.npz").write_bytes(b"no archive")
    assert against(make.run("other", *jobs), "pca", ["vq", "table"]).over == {}


def test_a_reference_holds_slices_to_a_hundredth_of_a_decibel(make, tmp_path):
    values = np.array([31.234, 100.0, -4.5])
    np.testing.assert_allclose(unpacked(packed(values)), [31.23, MOST_DB, -4.5])
    np.savez(tmp_path / "a.npz", psnr_display=[0.1], other=[1])
    with pytest.raises(InputError, match=r"a\.npz: .*satin/pca/0"):
        decibels(tmp_path, make.job() | {"slices": "a.npz"})
    assert decibels(tmp_path, make.job() | {"slices": "absent.npz"}) is None
