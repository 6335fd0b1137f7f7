from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.hierarchical import HierarchicalObjective
from baselines.neumip import LOSSES, NeuMIPObjective
from baselines.neuralbtf import NeuralBTF, texture_factors
from bench.codec import Codec, Fit
from bench.codecs import shared
from bench.codecs.registry import codec_entries, load_codec, make_codec
from bench.conformance.check import tiny_btf
from bench.directions import hemisphere
from bench.inputs.errors import InputError
from bench.training import Samples
from bench.training import fitting as training
from tests.baselines.made import CPU, at_tiny_pairs, btf_of, decoded, noise, slices, stored, table
from tests.baselines.surfaces import bumps
from tests.tiers import long, short_for

SMALL = {"steps": 10, "batch": 256}
FEW = {"steps": 10, "texels": 8, "pairs": 8}
UP = [0.0, 0.0, 1.0]


@pytest.fixture
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hierarchical answer is computed from 81 places, so a curve and the choice of bits take seconds."""
    monkeypatch.setattr(training, "PROBE", 512)
    monkeypatch.setattr(training, "ROUNDING_SAMPLES", 256)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("bcf", {"textures": 0, "batch": 0, "width": 0}),
        ("hierarchical", {"patch": 0, "places": 17, "gradient": -1}),
        ("hsh", {"lights": 0, "views": 7, "smoothness": -1}),
        ("ptm", {"lights": 0, "views": 7, "smoothness": -1}),
        ("local-pca", {"clusters": 0, "components": 0, "bits": 9}),
        ("neumip", {"outputs": 4}),
        ("neuralbtf", {"levels": 0, "channels": 0, "layers": 0, "width": 0, "batch": 0}),
        ("ntc", {"reduction": 0, "fine": 0, "coarse": 0, "bits": 0, "width": 0}),
        ("pca", {"components": 0, "passes": 1, "domain": "yuv"}),
        ("rainer2019", {"texels": 0, "pairs": 0, "latents": 0}),
        ("relief", {"bits": -1, "latents": -1, "width": 0}),
        ("relief", {"bits": 9}),
        ("triple-plane", {"channels": 0, "resolution": 0, "batch": 0}),
        ("tucker", {"components": 0, "views": 0, "lights": 0}),
        ("vq", {"codes": 0, "stages": 0, "components": 0}),
        ("vq", {"codes": 1 << 20}),
        ("zeltner2024", {"latents": 0, "width": 0, "layers": 0, "batch": 0}),
    ],
)
def test_settings_without_sense_are_refused(name: str, wrong: dict[str, Any]) -> None:
    for setting, value in wrong.items():
        with pytest.raises(InputError, match=setting):
            make_codec(name, {setting: value})


@pytest.mark.parametrize("name", codec_entries())
def test_settings_that_could_exhaust_memory_are_refused(name: str) -> None:
    bounded = ["batch", "channels", "frames", "half", "latents", "layers", "quarter", "resolution", "width"]
    for setting in set(bounded) & {field.name for field in fields(load_codec(name).Settings)}:
        with pytest.raises(InputError, match=setting):
            make_codec(name, {setting: 10**9})


def test_settings_of_networks_without_sense_are_refused() -> None:
    for name, wrong in (("biplane", ["batch", "kept"]), ("rainer2020", ["texels", "pairs", "kept", "latents"])):
        for setting in wrong:
            with pytest.raises(InputError, match=setting):
                load_codec(name).network(**{setting: 0})  # type: ignore[misc]


def less(at: Any) -> Callable[[Tensor], Tensor]:
    """A tensor of which only `at` is left."""
    return lambda tensor: tensor[at].clone()


@pytest.mark.parametrize(
    ("name", "settings", "part", "change", "match"),
    [
        ("bcf", SMALL, "texture/latents.blocks", less(slice(None, -8)), "8 × 8 texels"),
        ("biplane", SMALL | {"bits": 32}, "decoder/half", less((..., slice(5))), "5 and 18 channels"),
        ("hsh", {}, "other/bands", lambda bands: torch.cat([torch.full_like(bands[:1], 4), bands[1:]]), "108 coef"),
        ("ptm", {}, "other/bands", lambda bands: torch.cat([torch.full_like(bands[:1], 4), bands[1:]]), "72 coef"),
        ("local-pca", {"clusters": 2, "components": 2}, "other/count", lambda _: torch.tensor([3]), "3 clusters"),
        ("ntc", SMALL, "texture/coarse", less(slice(None, -1)), "coarse grid"),
        ("triple-plane", SMALL | {"bits": 32}, "decoder/planes", less((..., slice(7))), "planes"),
        ("tucker", {"bits": 32}, "decoder/core", less(slice(None, -1)), "core"),
        ("zeltner2024", SMALL | {"bits": 32}, "texture/latents", less((..., slice(7))), "7 channels"),
        *(
            ("neuralbtf", SMALL | {"width": 32, "bits": 32}, f"texture/{texture}", less(slice(1)), "is not of")
            for texture in texture_factors(NeuralBTF().settings)
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_parts_that_do_not_fit_each_other_are_refused(
    name: str, settings: dict[str, Any], part: str, change: Callable[[Tensor], Tensor], match: str
) -> None:
    codec = make_codec(name, settings)
    parts = codec.encode(tiny_btf(), Fit(network=shared.find_for(codec)))
    section, tensor = part.split("/")
    tensors = getattr(parts, section)
    tensors[tensor] = change(tensors[tensor])
    with pytest.raises((ValueError, InputError), match=match):
        codec.decode(parts, CPU)


@pytest.mark.parametrize("size", [(1, 1), pytest.param((5, 3), marks=pytest.mark.long), (2, 16)])
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        long("hierarchical", SMALL | {"recipe": "paper", "steps": 2}),
        ("neumip", SMALL),
        ("neuralbtf", {"steps": 5, "batch": 256, "width": 32}),
        ("ntc", {"steps": 5, "batch": 256, "reduction": 2}),
        long("relief", {"steps": 20, "batch": 256}),
    ],
)
@pytest.mark.usefixtures("few_samples")
def test_pictures_of_any_size_are_fitted(name: str, settings: dict[str, Any], size: tuple[int, int]) -> None:
    answer = decoded(make_codec(name, settings), noise(*size)).slice(UP, UP)
    assert answer.shape == (*size, 3)
    assert answer.isfinite().all()


TRAINED = {"steps": 300, "batch": 512}
SLOW = ("neuralbtf", "rainer2019", "triple-plane")
BY_BOTH_RECIPES: dict[str, dict[str, Any]] = {
    "neuralbtf": TRAINED | {"width": 64},
    "ntc": TRAINED | {"reduction": 2},
    "rainer2019": {"steps": 200, "texels": 8, "pairs": 16},
    "triple-plane": TRAINED,
    "zeltner2024": TRAINED | {"width": 32, "rate": 1e-2, "latent_rate": 1e-2},
}


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("ntc", BY_BOTH_RECIPES["ntc"] | {"recipe": "paper"}),
        ("zeltner2024", BY_BOTH_RECIPES["zeltner2024"] | {"recipe": "paper"}),
        long("bcf", TRAINED),
        long("hierarchical", {"steps": 250, "batch": 512}),
        *(long(name, BY_BOTH_RECIPES[name] | {"recipe": "paper"}) for name in SLOW),
        *(long(name, settings | {"recipe": "ours"}) for name, settings in BY_BOTH_RECIPES.items()),
    ],
)
@pytest.mark.usefixtures("few_samples")
def test_it_comes_near_the_data(name: str, settings: dict[str, Any]) -> None:
    fit = Fit()
    make_codec(name, settings).encode(tiny_btf(), fit)
    assert fit.history[-1]["psnr"] > 25


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        long("hierarchical", {"batch": 64, "patch": 4, "gradient": 0.1}),
        ("neumip", {"batch": 64, "blur": True}),
        long("rainer2019", {"texels": 2, "pairs": 4, "recipe": "ours"}),
        long("rainer2019", {"texels": 2, "pairs": 4, "recipe": "paper"}),
        long("relief", {"batch": 64, "bits": 4}),
    ],
)
@pytest.mark.usefixtures("few_samples")
def test_a_killed_fit_gives_the_same_file(ends_alike_when_killed: Any, name: str, settings: dict[str, Any]) -> None:
    ends_alike_when_killed(make_codec(name, {"steps": 30} | settings), bumps()[0] if name == "relief" else tiny_btf())


@pytest.mark.parametrize(
    ("name", "settings", "tolerance"),
    [
        ("hsh", {}, 0.01),  # the harmonic that is not 0 is in eight bits: 1/255 of the range of albedos, of a log of 2
        ("pca", {"components": 3, "domain": "rgb", "bits": 32}, 1e-5),
        ("pca", {"components": 8}, 0.01),
        ("table", {}, 1e-3),
        ("tucker", {"components": 36}, 0.02),
        ("vq", {"codes": 36}, 0.02),
    ],
)
def test_between_the_samples_a_diffuse_material_is_exact(name: str, settings: dict[str, Any], tolerance: float) -> None:
    """Radiance is a/π · cos θ_i: logarithms interpolated with their samples' cosines would be 12 % dark."""
    albedo = np.random.default_rng(0).uniform(0.3, 0.9, (6, 6, 3))
    btf = at_tiny_pairs(tiny_btf().wi[:, None, None, 2:] * albedo / np.pi)
    wo, wi = hemisphere.from_degrees(33.0, 70.0), hemisphere.from_degrees(41.0, 200.0)
    answer = decoded(make_codec(name, settings), btf).slice(wo, wi)
    np.testing.assert_allclose(answer, wi[2] * albedo / np.pi, rtol=tolerance)


RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("name", "settings"), [("local-pca", {}), ("pca", {"domain": "log"}), ("pca", {"domain": "rgb"})]
)
@pytest.mark.parametrize(
    "values",
    [
        np.zeros((9, 4, 4, 3)),
        np.full((9, 4, 4, 3), 0.7),
        RANDOM.random((9, 1, 1, 3)),
        RANDOM.random((1, 5, 4, 3)),
        RANDOM.random((9, 1, 1, 3)) * RANDOM.random((1, 5, 4, 1)),
        RANDOM.random((9, 3, 3, 3)) * 1e6,
    ],
    ids=["black", "constant", "one texel", "one pair", "rank one", "bright"],
)
def test_degenerate_data(tmp_path: Any, values: np.ndarray, name: str, settings: dict[str, Any]) -> None:
    btf = btf_of(values, 1 if len(values) == 1 else 3)
    got = slices(stored(make_codec(name, settings | {"bits": 32}), btf, tmp_path), btf)
    np.testing.assert_allclose(got, table(btf), rtol=2e-4, atol=1e-5 * max(1e-6, table(btf).max()))


@pytest.mark.parametrize(
    ("name", "settings", "pairs", "tolerance"),
    [
        ("biplane", SMALL, 1, 0.01),
        ("biplane", SMALL, 81, 0.01),
        ("rainer2019", FEW | {"recipe": "ours"}, 81, 0.04),
        ("rainer2019", FEW | {"recipe": "paper"}, 81, 0.04),
        ("rainer2020", {}, 1, 0.01),
        ("rainer2020", {}, 81, 0.01),
        ("table", {}, 1, 1e-3),
        ("vq", {"bits": 16}, 81, 4e-3),
    ],
)
def test_a_material_of_one_colour_is_coded(name: str, settings: dict[str, Any], pairs: int, tolerance: float) -> None:
    colour = torch.tensor([0.1, 0.2, 0.3])
    btf = at_tiny_pairs(colour.expand(1, 2, 2, 3).numpy()).subset(np.arange(pairs))
    codec = make_codec(name, settings)
    answer = decoded(codec, btf, Fit(network=shared.find_for(codec))).slice(btf.wo[0].tolist(), btf.wi[0].tolist())
    assert (answer / colour - 1).abs().max() < tolerance


@pytest.mark.parametrize("name", short_for(["neumip", "relief"], "neumip"))
def test_a_large_footprint_gives_the_mean_of_a_box(name: str) -> None:
    """A checkerboard of texels is grey from afar: a codec without levels would answer black or white."""
    checks = np.indices((8, 8)).sum(0) % 2 * tiny_btf().wi[:, 2, None, None]
    btf = at_tiny_pairs(np.repeat(checks[..., None], 3, -1))
    material = decoded(make_codec(name, {"steps": 300, "batch": 256}), btf)
    fine, coarse = (material.slice(UP, UP, (n, n)) for n in (8, 4))
    assert (fine.amax() - fine.amin()) > 0.8
    # Black or white would be 0.5 away, a fit of a few seconds is not exact.
    assert (coarse - 0.5).abs().max() < 0.25


@pytest.mark.parametrize(
    ("name", "objective", "settings"),
    [
        *(("hierarchical", HierarchicalObjective, {"loss": loss, "gradient": 1.0}) for loss in ("both", "l1", "root")),
        *(("neumip", NeuMIPObjective, {"loss": loss}) for loss in sorted(LOSSES)),
    ],
)
@pytest.mark.parametrize("shade", [0.0, 1.0])
def test_losses_of_black_and_white_have_gradients_at_equality_and_away_from_it(
    name: str, objective: Any, settings: dict[str, Any], shade: float
) -> None:
    generator = torch.Generator().manual_seed(0)
    codec: Codec = make_codec(name, settings | {"batch": 64})
    fitting = objective([Samples(at_tiny_pairs(np.full((1, 8, 8, 3), shade)), 8.0, Fit())], codec.settings, generator)
    for level in (fitting.samples.mean(generator), torch.zeros(3), torch.ones(3)):
        fitting.networks.start_at(level)
        value = fitting.loss(generator, 0.5)
        value.backward()
        assert value.isfinite()
        assert all(p.grad is None or p.grad.isfinite().all() for p in fitting.parameters())


STORES_A_NETWORK = {
    "bcf": SMALL,
    "hierarchical": {"steps": 4, "batch": 256},
    "neubtf": {"steps": 5},
    "neubtf-direct": SMALL,
    "neumip": SMALL,
    "neuralbtf": SMALL | {"width": 32},
    "ntc": SMALL | {"reduction": 2},
    "rainer2019": FEW,
    "relief": SMALL,
    "triple-plane": SMALL,
    "zeltner2024": SMALL,
}


@pytest.mark.parametrize("name", short_for(STORES_A_NETWORK, "neubtf-direct", "zeltner2024"))
@pytest.mark.usefixtures("few_samples")
def test_weights_of_eight_bits_are_half_as_large_and_answer_alike(name: str) -> None:
    files, sizes = {}, {}
    for weights in ("half", "int8"):
        codec = make_codec(name, STORES_A_NETWORK[name] | {"weights": weights})
        parts = codec.encode(tiny_btf(), Fit())
        files[weights] = parts
        sizes[weights] = sum(x.numel() * x.element_size() for x in parts.decoder.values())
    assert sizes["int8"] < 0.8 * sizes["half"]  # biases, norms and the steps of rows stay halves
    exact, rounded = (codec.decode(parts, CPU).slice(UP, UP) for parts in files.values())
    assert (rounded - exact).abs().mean() < 0.25 * exact.abs().mean()
