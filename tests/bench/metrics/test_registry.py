import pytest

from bench.inputs.errors import InputError
from bench.metrics import DEFAULTS, chosen_names, get, label_of
from bench.metrics.flip import PPD


def test_chosen_names_take_the_variant_of_the_material_and_psnr_comes_first():
    names = ["flip_hdr_67ppd", "rmse_linear", "ssim_periodic"]
    assert chosen_names(names, True) == ("psnr_display", "flip_hdr_67ppd_periodic", "rmse_linear", "ssim_periodic")
    assert chosen_names(names, False) == ("psnr_display", "flip_hdr_67ppd", "rmse_linear", "ssim")
    assert chosen_names([], True) == ("psnr_display",)
    assert chosen_names(DEFAULTS, False) == DEFAULTS
    with pytest.raises(InputError, match="flip_hdr"):
        chosen_names(["flip_hdr"], True)
    with pytest.raises(InputError, match="psnr_log1p_periodic"):
        chosen_names(["psnr_log1p_periodic"], True)


@pytest.mark.parametrize(
    ("name", "label", "ppd"),
    [
        ("psnr_log1p", "log PSNR", None),
        ("ssim_periodic", "SSIM", None),
        ("flip_ldr_67ppd", "FLIP", PPD),
        ("flip_ldr_20ppd_periodic", "FLIP 20ppd", 20),
        ("flip_hdr_hable_12.5ppd_periodic", "HDR FLIP, Hable 12.5ppd", 12.5),
    ],
)
def test_a_known_name_loads_and_has_a_label(name, label, ppd):
    metric = get(name)
    assert (metric.name, label_of(name), getattr(metric.load(), "ppd", None)) == (name, label, ppd)
    assert metric.periodic == name.endswith("_periodic")


@pytest.mark.parametrize(
    ("wrong", "meant"), [("psnr_disply", "psnr_display"), ("SSIM", "ssim"), ("flip_ldr", "flip_ldr_67ppd")]
)
def test_an_unknown_name_suggests_the_nearest(wrong, meant):
    with pytest.raises(InputError, match=rf"{wrong}.*{meant}"):
        get(wrong)
    for variant in ("psnr_display_periodic", "flip_ldr_0ppd", "flip_ldr_067ppd", "flip_ldr_-5ppd", ""):
        with pytest.raises(InputError, match="no metric"):
            get(variant)
    assert label_of("of_an_older_version") == "of an older version"
