"""The guard at work on what was really measured: the committed reference, and the scores of many further seeds."""

import json
import random
from pathlib import Path

import pytest

from bench.compare import compare
from bench.compare.reference import committed
from bench.compare.verdicts import Verdict
from bench.records import load_run

REFERENCE = committed("ci")
PSNR, FLIP = "psnr_display", "flip_ldr_67ppd_periodic"
SEEDS = json.loads((Path(__file__).parent / "seeds.json").read_text())  # PSNR and FLIP of each row, seed after seed
LINES = [json.loads(line) for line in REFERENCE.read_text().splitlines()]
ROWS = sorted({(line["material"], line["label"]) for line in LINES if line["kind"] == "job"})


def written(path, lines):
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    return load_run(path)


def worse_by_half_a_decibel(job):
    job["scores"]["heldout"]["metrics"][PSNR]["pooled"] -= 0.5


def a_parameter_more(job):
    job["parameters"] += 1


def three_per_cent_more_bytes(job):
    job["bytes"]["total"] = round(1.03 * job["bytes"]["total"])


def worse_in_flip(job):
    job["scores"]["heldout"]["metrics"][FLIP]["pooled"] += 0.02


def test_the_reference_is_small_and_of_this_suite():
    assert REFERENCE.stat().st_size < 200_000
    assert {"mean-colour", "pca", "vq", "neubtf-direct", "neumip", "rainer2019"} <= {
        label.split()[0] for _, label in ROWS
    }
    seeds = [{line["seed"] for line in LINES if line.get("label") == label} for _, label in ROWS]
    assert all({0, 1, 2} <= found for found in seeds)


def test_a_run_that_gives_the_reference_again_is_the_same():
    found = compare(load_run(REFERENCE), load_run(REFERENCE))
    assert {row.verdict for row in found.rows} == {Verdict.SAME}
    assert found.exit_code == 0


def test_no_margin_of_the_reference_exceeds_three_tenths_of_a_decibel(tmp_path):
    three = written(tmp_path / "new.jsonl", [line for line in LINES if line.get("seed", 0) in (0, 1, 2)])
    found = compare(load_run(REFERENCE), three)
    margins = {(row.name, c.quantity.name): c.margin for row in found.rows for c in row.deciding}
    assert max(margin for (_, name), margin in margins.items() if name == "PSNR") <= 0.3
    assert max(margin for (_, name), margin in margins.items() if name == "FLIP") <= 0.02


@pytest.mark.parametrize("plant", [worse_by_half_a_decibel, a_parameter_more, three_per_cent_more_bytes, worse_in_flip])
def test_a_planted_regression_of_any_codec_is_caught(tmp_path, plant):
    base = load_run(REFERENCE)
    for row in ROWS:
        lines = [json.loads(json.dumps(line)) for line in LINES]
        for line in lines:
            if line["kind"] == "job" and (line["material"], line["label"]) == row:
                plant(line)
        found = compare(base, written(tmp_path / "new.jsonl", lines))
        assert [f.name for f in found.having(Verdict.WORSE)] == ["/".join(row)]
        assert found.exit_code == 1


def job(row, seed, scores):
    """A job of the reference with other scores; exact copies but for these."""
    line = json.loads(json.dumps(next(line for line in LINES if line["kind"] == "job")))
    line["material"], line["label"] = row.split("/")
    for name, value in zip((PSNR, FLIP), scores, strict=True):
        line["scores"]["heldout"]["metrics"][name] = {"pooled": value}
    return line | {"job": f"{row}/{seed}", "seed": seed}


def replay(folder, rng, loss=0.0):
    """A reference of every seed measured, in a new order for each row, and a run whose three seeds are others of them.

    The spread is that of the reference, as in real use; the means compared share no seed.
    """
    base, new = [], []
    for row, seeds in SEEDS.items():
        drawn = rng.sample(seeds, len(seeds))
        base += [job(row, i, scores) for i, scores in enumerate(drawn)]
        new += [job(row, i, (psnr - loss, flip)) for i, (psnr, flip) in enumerate(drawn[3:6])]
    return compare(written(folder / "base.jsonl", base), written(folder / "new.jsonl", new))


def test_a_hundred_replays_of_other_seeds_raise_no_alarm(tmp_path):
    rng = random.Random(0)
    found = [replay(tmp_path, rng) for _ in range(100)]
    assert [row.reasons() for each in found for row in each.having(Verdict.WORSE)] == []
    assert {each.exit_code for each in found} == {0}


def test_a_hundred_replays_that_lost_half_a_decibel_are_all_caught(tmp_path):
    rng = random.Random(1)
    for _ in range(100):
        found = replay(tmp_path, rng, loss=0.5)
        assert found.exit_code == 1
        # A row by itself is caught but for the luck of its draw, which reaches past 0.2 dB once in hundreds.
        assert len(found.having(Verdict.WORSE)) >= len(found.rows) - 1
