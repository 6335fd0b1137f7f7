import pytest

from bench.records import load_run
from reports.leads import leads


@pytest.mark.parametrize(
    ("second", "words"),
    [
        (27.5, ["pca components=8", "30.0 dB", "2.5 dB", "vq"]),
        (30.03, ["level"]),
        (100, ["vq leads: 48.1 dB", "18.1 dB before pca"]),
    ],
)
def test_the_lead_of_a_run_without_budgets_is_that_before_another_codec(made, second, words):
    made.job("pca components=8", psnr=30.0).job("pca components=4", psnr=29.5).job("vq", psnr=second)
    sentence = leads(load_run(made.folder))
    assert all(word in sentence for word in words)
    assert "components=4" not in sentence


def test_one_codec_leads_nobody(made):
    assert leads(load_run(made.job("pca components=8").job("pca components=4").folder)) == ""


def test_with_validation_pairs_the_lead_is_that_within_a_budget(made):
    for label, psnr in (("pca", 25.0), ("neubtf-direct", 28.0), ("relief", 30.5)):
        scores = {"heldout": made._group(psnr), "validation": made._group(psnr)}
        made.job(label, bytes={"total": 256}, scores=scores, psnr=psnr)
    assert "32 bits" in leads(load_run(made.folder))


def test_a_codec_measured_on_fewer_materials_leads_nobody(made):
    made.job("pca", psnr=30.0).job("vq", psnr=28.0).job("pca", "brick", psnr=30.0).job("vq", "brick", psnr=28.0)
    made.job("relief", psnr=40.0)
    assert leads(load_run(made.folder)).startswith("pca leads")


def test_within_a_budget_too_equal_codecs_are_level(made):
    for label in ("neubtf-direct", "relief"):
        scores = {"heldout": made._group(28.0), "validation": made._group(28.0)}
        made.job(label, bytes={"total": 256}, scores=scores, psnr=28.0)
    assert "relief" in leads(load_run(made.folder))
    assert "are level on" in leads(load_run(made.folder))
