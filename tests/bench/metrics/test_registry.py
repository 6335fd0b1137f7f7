"""The registry names metrics, fills in the variable parts of a name, and imports nothing before it must."""

import pytest

from bench.errors import InputError
from bench.metrics import DEFAULTS, chosen_names, default_names, get, label_of, registered
from bench.metrics.flip import PPD


@pytest.mark.parametrize(
    "name",
    [
        "psnr_display",
        "psnr_log1p",
        "rmse_linear",
        "ssim",
        "ssim_periodic",
        "flip_ldr_67ppd",
        "flip_ldr_20ppd_periodic",
        "flip_hdr_67ppd_periodic",
        "flip_hdr_hable_67ppd",
        "flip_hdr_reinhard_12.5ppd",
    ],
)
def test_a_known_name_loads(name):
    metric = get(name)
    assert metric.name == name
    assert metric.direction in ("higher", "lower")
    assert metric.periodic == name.endswith("_periodic")
    assert metric.load().prepare is not None


def test_the_name_carries_the_pixels_per_degree():
    assert get("flip_ldr_67ppd").load().ppd == PPD
    assert get("flip_ldr_20ppd").load().ppd == 20
    assert get("flip_ldr_120ppd_periodic").load().periodic


@pytest.mark.parametrize(
    ("wrong", "meant"), [("psnr_disply", "psnr_display"), ("SSIM", "ssim"), ("flip_ldr", "flip_ldr_67ppd")]
)
def test_an_unknown_name_suggests_the_nearest(wrong, meant):
    with pytest.raises(InputError, match=rf"{wrong}.*{meant}"):
        get(wrong)


@pytest.mark.parametrize("name", ["psnr_display_periodic", "flip_ldr_0ppd", "flip_ldr_067ppd", "flip_ldr_-5ppd", ""])
def test_a_variant_that_does_not_exist_is_unknown(name):
    with pytest.raises(InputError, match="no metric is named"):
        get(name)


@pytest.mark.parametrize("periodic", [False, True])
def test_the_default_metrics_exist(periodic):
    metrics = [get(name) for name in default_names(periodic)]
    assert any(m.periodic for m in metrics) == periodic


def test_chosen_names_take_the_variant_of_the_material_and_psnr_comes_first():
    names = ["flip_hdr_67ppd", "rmse_linear", "ssim_periodic"]
    assert chosen_names(names, True) == ("psnr_display", "flip_hdr_67ppd_periodic", "rmse_linear", "ssim_periodic")
    assert chosen_names(names, False) == ("psnr_display", "flip_hdr_67ppd", "rmse_linear", "ssim")
    assert chosen_names([], True) == ("psnr_display",)
    assert chosen_names(DEFAULTS, False) == DEFAULTS
    with pytest.raises(InputError, match=r"flip_hdr.*did you mean"):
        chosen_names(["flip_hdr"], True)


def test_tables_call_a_metric_by_its_label_and_an_unknown_one_by_its_name():
    labels = [label_of(name) for name in ("psnr_log1p", "ssim_periodic", "flip_ldr_67ppd")]
    assert labels == ["log PSNR", "SSIM", "FLIP"]
    assert label_of("flip_hdr_hable_20ppd_periodic") == "HDR FLIP, Hable 20ppd"
    assert label_of("of_an_older_version") == "of an older version"


def test_names_are_unique():
    names = [metric.name for metric in registered()]
    assert len(set(names)) == len(names)
