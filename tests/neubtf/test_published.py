from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import container, loading
from bench.conformance.check import tiny_btf
from bench.metrics.display import decode_srgb
from bench.training import Samples
from neubtf.augmentation import Crop
from neubtf.autoencoder import Autoencoder, Encoder, as_guidance, displayed, eight_bits
from neubtf.codec import NeuBTF
from neubtf.published import COMPARED, COMPILED_FROM, DARKEST, Elements, Published, linear_display, slice_means
from neubtf.training import by_texel, slice_of

GREY = torch.full((1, 3, 16, 16), 0.3)  # a guidance image


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def published(btf: BTF | None = None, **settings: Any) -> Published:
    samples = Samples(btf or tiny_btf(16), 2.0, Fit())
    encoder = Encoder.for_guidance(GREY, Autoencoder(14, generator(1)))
    chosen = NeuBTF(recipe="paper", **settings).settings
    return Published(samples, chosen, encoder, GREY, generator())


def alone(elements: Elements, at: int) -> Elements:
    """One element of several."""
    return Elements(elements.window, *(part[[at]] for part in elements[1:]))


def test_a_step_has_windows_of_several_sizes_and_its_losses_are_the_mean_over_elements() -> None:
    fitting = published(smallest=0.5, slices=60, texel_pairs=0)
    batch = fitting.batch(generator())
    assert len({elements.window.size for elements in batch}) > 1
    assert sum(len(elements.input_pairs) for elements in batch) == 60
    assert len({int(pair) for elements in batch for pair in elements.input_pairs}) > 20
    each = [
        fitting.losses([alone(elements, at)], generator())
        for elements in batch
        for at in range(len(elements.input_pairs))
    ]
    torch.testing.assert_close(fitting.losses(batch, generator()), torch.stack(each).mean(0))


def test_several_targets_are_compared_with_one_texture_each_as_if_alone() -> None:
    fitting = published(targets=5, texel_pairs=0)
    elements = fitting.elements([Crop((0, 0), (16, 16), (16, 16))], generator())
    assert elements.targets.shape[1] == elements.pairs.shape[1] == 5
    each = [
        fitting.losses([elements._replace(targets=elements.targets[:, [i]], pairs=elements.pairs[:, [i]])], generator())
        for i in range(5)
    ]
    torch.testing.assert_close(fitting.losses([elements], generator()), torch.stack(each).mean(0))


WINDOWS = [
    [Crop((3, 5), (8, 8), (8, 8)), Crop((12, 14), (10, 9), (8, 8))],  # the second reaches over the border
    [Crop((0, 0), (16, 16), (12, 8))],
]


@pytest.mark.parametrize("windows", WINDOWS)
def test_slices_and_single_pairs_are_the_radiance_of_the_window(windows: list[Crop]) -> None:
    """A window's texel is a mean of those of its source, in the slices of its pairs as at a pair of its own."""
    fitting = published(hue=0, saturation=0, blur=0, noise=0, targets=3)
    elements = fitting.elements(windows, generator())
    count = len(windows) * windows[0].size[0] * windows[0].size[1]
    pairs = torch.randint(81, (count,), generator=generator(1)).view(len(windows), -1)
    drawn = fitting.averaged(elements.texels, elements.weights, pairs)
    for at, window in enumerate(windows):
        texels = window.texels(fitting.samples.shape)
        whole = fitting.window_of_slices(window, texels, torch.arange(81)).flatten(2).movedim(1, -1)  # (81, n, 3)
        torch.testing.assert_close(elements.targets[at], whole[elements.pairs[at]], rtol=1e-4, atol=1e-5)
        own = whole[pairs[at], torch.arange(whole.shape[1])]
        torch.testing.assert_close(drawn[at], own, rtol=1e-4, atol=1e-5)


def half_dark() -> BTF:
    """The left half has a tenth of the radiance of the right one, in slices whose brightness differs."""
    like = tiny_btf(16)
    values = np.stack([np.full((16, 16, 3), 0.04 * (1 + pair % 5), np.float32) for pair in range(81)])
    values[:, :, :8] /= 10
    return BTF("half dark", like.wo, like.wi, ArraySource(values), periodic=True)


def test_a_crop_of_an_input_has_the_exposure_of_its_slice_not_its_own() -> None:
    """The dark half stays dark: a whole photograph is brought to the guidance's mean, not each of its crops."""
    fitting = published(half_dark(), hue=0, saturation=0, blur=0, noise=0)
    guidance = float(decode_srgb(np.full(1, 0.3))[0])
    dark, bright = (Crop((0, col), (8, 8), (8, 8)) for col in (0, 8))
    elements = fitting.elements([dark, bright] * 10, generator())
    means = decode_srgb(elements.picture.numpy()).mean((1, 2, 3))
    np.testing.assert_allclose(means[::2], guidance * 2 / 11, rtol=0.02)
    np.testing.assert_allclose(means[1::2], guidance * 20 / 11, rtol=0.02)


def test_the_mean_of_a_slice_is_that_of_what_is_displayed() -> None:
    samples = Samples(half_dark(), 8.0, Fit())
    wanted = [0.55 * 0.04 * (1 + pair % 5) for pair in range(81)]
    np.testing.assert_allclose(slice_means(samples), wanted, rtol=2e-3)
    like = tiny_btf(8)
    black = BTF("black", like.wo, like.wi, ArraySource(np.zeros((81, 8, 8, 3), np.float32)))
    assert (slice_means(Samples(black, 8.0, Fit())) == DARKEST).all()


def test_the_papers_recipe_shows_every_slice_at_the_guidances_brightness() -> None:
    fitting = published(hue=0, saturation=0, blur=0, noise=0, keep_scale=1)
    pictures = fitting.elements([Crop((0, 0), (16, 16), (16, 16))] * 20, generator()).picture
    guidance = float(decode_srgb(np.full(1, 0.3))[0])
    np.testing.assert_allclose(decode_srgb(pictures.numpy()).mean((1, 2, 3)), np.full(20, guidance), rtol=0.1)


def test_shown_is_radiance_in_the_range_of_a_display() -> None:
    np.testing.assert_allclose(linear_display(torch.tensor([0.0, 8 * 0.5, 8 * 2.0]).log1p()), [0, 0.5, 1], rtol=1e-6)


@pytest.mark.long
def test_the_guidance_of_a_file_is_the_slice_whose_texture_answers_best() -> None:
    fitting = published(smallest=1.0)
    optimiser = torch.optim.Adam(fitting.parameters(), 3e-3)
    for _ in range(20):  # so that textures matter
        optimiser.zero_grad()
        fitting.loss(generator(), 0.0).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
    samples, fit = fitting.samples, Fit()
    batch = samples.draw(COMPARED, fit.generator())
    pictures = [fitting.guidance.clone()]
    for pair in range(0, 81, 2):  # at most 64 of 81
        level = fitting.exposed(slice_of(samples, pair), torch.tensor([pair]))
        pictures.append(as_guidance(eight_bits(displayed(level))))
    errors = {}
    for picture in pictures:
        with torch.no_grad():
            ours = fitting.rendered(by_texel(fitting.encoder(picture)), batch.texel, batch.pair)
        errors[picture] = float((ours - batch.target).abs().mean())
    best = min(errors, key=errors.__getitem__)
    assert errors[best] < 0.995 * max(errors.values())  # it matters
    torch.testing.assert_close(fitting.best_guidance(fit), best)


@pytest.mark.long
def test_a_file_by_the_papers_recipe_has_the_version_of_that_recipe(tmp_path: Path) -> None:
    for settings, version in (({"recipe": "paper"}, NeuBTF.recipe_versions["paper"]), ({}, NeuBTF.version)):
        codec = NeuBTF(steps=2, batch=64, slices=2, **settings)
        header = container.save(tmp_path / "file.nbtf", codec, codec.encode(tiny_btf(), Fit()))
        assert header.version == version
        assert loading.load(header.path).header.version == version
    assert NeuBTF.recipe_versions["paper"] != NeuBTF.version


LONG_FIT = {"steps": COMPILED_FROM, "crop": 8}  # crops that a scale of 0.75 leaves smaller than 16 x 16 texels


@pytest.mark.parametrize(
    ("settings", "device", "compiler", "compiled"),
    [
        (LONG_FIT, "cuda", "/usr/bin/gcc", True),
        (LONG_FIT, "cpu", "/usr/bin/gcc", False),
        (LONG_FIT | {"steps": COMPILED_FROM - 1}, "cuda", "/usr/bin/gcc", False),
        (LONG_FIT | {"around": 2}, "cuda", "/usr/bin/gcc", False),
        (LONG_FIT | {"crop": 16}, "cuda", "/usr/bin/gcc", False),  # windows of many sizes
        (LONG_FIT, "cuda", None, False),  # Triton would fail in the first step
    ],
)
def test_a_long_fit_on_a_gpu_compiles_what_its_steps_compute(
    settings: dict[str, Any], device: str, compiler: str | None, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    fitting = published(**settings)
    fitting.samples.device = torch.device(device)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name)  # as if Triton were installed
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("shutil.which", lambda name: compiler)
    monkeypatch.setattr(torch, "compile", lambda function, dynamic, mode: "compiled")
    assert (fitting._quickest(fitting._compared) == "compiled") == compiled


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:The .grad attribute of a Tensor that is not a leaf")  # PyTorch's compiler asks
def test_a_compiled_step_has_the_gradient_of_any_other_and_the_same_state() -> None:
    """By the compiler for processors, which is as near to a GPU's as this machine comes."""
    eager, compiled = published(slices=2, crop=8), published(slices=2, crop=8)
    compiled.comparison = torch.compile(compiled.comparison, dynamic=False)
    for fitting in (eager, compiled):
        fitting.loss(generator(), 0.0).backward()  # type: ignore[no-untyped-call]
    assert eager.state_dict().keys() == compiled.state_dict().keys()
    for ours, theirs in zip(compiled.parameters(), eager.parameters(), strict=True):
        torch.testing.assert_close(ours.grad, theirs.grad, rtol=1e-3, atol=1e-6)
