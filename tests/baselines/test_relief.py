from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from baselines.relief import sweep
from baselines.relief.codec import Relief, ReliefMaterial, ReliefObjective
from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.conformance.check import tiny_btf
from bench.conformance.counting import held_floats
from bench.data.materials import load, recipe
from bench.data.materials.maps import resize
from bench.inputs.errors import InputError
from bench.material import parameters
from bench.training import fitting as training
from bench.training import gain_of
from tests.baselines.made import decoded
from tests.baselines.surfaces import bumps


def fitted(btf: BTF, **settings: Any) -> ReliefMaterial:
    codec = Relief(**{"steps": 20, "batch": 256} | settings)
    material = decoded(codec, btf)
    assert isinstance(material, ReliefMaterial)
    return material


@pytest.mark.parametrize(
    ("settings", "count"),
    # (16 + 1 + 9 + 1) · 64 + 2 · 65 · 64 + 65 · 3, and of the offset (4 + 1) · 32 + 33 + 1
    [({}, 10_437), ({"offset": 0}, 10_243), ({"half": 0, "quarter": 0, "offset": 0, "width": 16}, 835)],
    ids=["default", "no offset", "small"],
)
def test_parameters_without_relief(settings: dict[str, Any], count: int) -> None:
    material = fitted(tiny_btf(), **settings)
    assert parameters(material) == material.cost.parameters == count


@pytest.mark.parametrize("btf", [tiny_btf(), bumps()[0]], ids=["flat", "with a height"])
def test_the_numbers_that_are_declared_are_those_that_its_decoder_holds(btf: BTF) -> None:
    material = fitted(btf)
    assert material.cost.texture_floats == held_floats(material)
    assert material.cost.texture_floats > material.size[0] * material.size[1] * material.cost.texture_channels


def test_a_texture_without_channels_is_refused() -> None:
    with pytest.raises(InputError, match=r"relief .*channel"):
        Relief(latents=0, half=0, quarter=0)
    assert fitted(tiny_btf(), latents=0, half=0, quarter=3).cost.texture_channels == 0


def test_the_height_is_found() -> None:
    btf, truth = bumps()
    material = fitted(btf)
    assert material.relief is not None
    found = material.relief.height[..., 0].numpy()
    assert np.corrcoef(found.ravel(), truth.ravel())[0, 1] > 0.9
    # A texel is 0.06 wide.
    assert np.sqrt(np.square(found - truth).mean()) < 0.02


@pytest.mark.long
def test_highlights_that_move_hide_no_relief() -> None:
    btf = load("leather", 48, views=25, lights=13, heldout=0)
    truth = resize(recipe("leather").maps(0).height, (48, 48))
    found = sweep.find(btf, gain_of(btf, Fit()), Fit())
    assert found is not None
    assert found.stands
    assert np.corrcoef(found.height.numpy().ravel(), truth.ravel())[0, 1] > 0.7


@pytest.mark.parametrize(
    "btf",
    [bumps(amplitude=0.0)[0], tiny_btf(), bumps(views=1)[0], bumps(lights=1)[0]],
    ids=["flat", "flat and glossy", "one view", "one light"],
)
def test_no_height_is_written_where_there_is_none(btf: BTF) -> None:
    parts = Relief(steps=1, batch=64).encode(btf, Fit())
    assert "height" not in parts.texture
    assert "offset" in parts.texture


@pytest.mark.long
def test_relief_is_nearer_than_none() -> None:
    btf, _ = bumps(amplitude=0.09)
    truth = np.stack(list(btf))

    def error(**settings: Any) -> float:
        material = fitted(btf, steps=60, batch=512, **settings)
        ours = [material.slice(btf.wo[i].tolist(), btf.wi[i].tolist()).numpy() for i in range(len(btf))]
        return float(np.square(np.stack(ours) - truth).mean())

    assert error() < 0.8 * error(relief=False)


@pytest.mark.long
def test_bits_are_what_is_paid() -> None:
    """Latents of n bits in the mean take at most n bits of the file, and their channels a byte each."""
    noise = BTF("noise", tiny_btf().wo, tiny_btf().wi, ArraySource(np.random.default_rng(0).random((81, 32, 32, 3))))
    sizes = {}
    for bits in (2, 4, 8):
        parts = Relief(steps=1, batch=64, bits=bits).encode(noise, Fit())
        sizes[bits] = len(parts.texture["latents"])
        assert sizes[bits] <= 32 * 32 * 14 * bits / 8 + 1 + 14
    assert sizes[2] < sizes[4] < sizes[8]


@pytest.mark.long
def test_a_height_is_stored_as_finely_as_it_is_felt() -> None:
    """Rounded, it moves a look-up by at most a third of a texel at the steepest slope that is marched, 5."""
    btf, _ = bumps()
    found = sweep.find(btf, gain_of(btf, Fit()), Fit())
    assert found is not None
    relief = fitted(btf, refine=False).relief
    assert relief is not None
    stored = relief.height[..., 0]
    assert (stored - found.height).abs().max() * btf.shape[1] * 5 < 1 / 3 + 1e-3
    assert len(stored.unique()) < 64


@pytest.mark.long
def test_a_height_is_refined_toward_the_truth() -> None:
    btf, truth = bumps()

    def error(**settings: Any) -> float:
        relief = fitted(btf, **settings).relief
        assert relief is not None
        found = relief.height[..., 0].numpy()
        return float((found - found.mean() - truth).std())

    assert error(steps=80) < 0.9 * error(steps=1, refine=False)  # which no step changes


@pytest.mark.long
def test_an_altered_height_is_searched_all_the_same() -> None:
    codec, (btf, _) = Relief(steps=2, batch=64), bumps()
    parts = codec.encode(btf, Fit())
    for wrong in (1e9, -1e9, float("nan"), float("inf")):
        parts.texture["height.range"][1] = wrong
        assert codec.decode(parts, torch.device("cpu")).slice([0, 0, 1], [0, 0, 1]).isfinite().all()


def test_a_file_answers_as_the_fit_did(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is rounded in the fit is what the file holds."""
    btf, _ = bumps()
    codec = Relief(steps=20, batch=256, weights="float32", bits=4)
    fit, kept = Fit(), list[ReliefObjective]()

    class Watched(ReliefObjective):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            kept.append(self)

    monkeypatch.setattr("baselines.relief.codec.ReliefObjective", Watched)
    material = codec.decode(codec.encode(btf, fit), torch.device("cpu"))
    samples = kept[0].samples
    batch = samples.draw(200, fit.generator())
    with torch.no_grad():
        expected = kept[0].predict(batch, 1.0).expm1().clamp_min(0) / samples.gain
    found = material.query(samples.centres(batch.texel), samples.wo[batch.pair], samples.wi[batch.pair])
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-5)


@pytest.mark.long
def test_a_refined_height_that_diverges_is_set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "KEEP_EVERY", 10)
    poisoned, found = list[float](), ReliefObjective.loss

    def loss(self: ReliefObjective, generator: torch.Generator, progress: float) -> Tensor:
        if progress >= 0.5 and not poisoned:
            assert self.height_shift is not None
            self.height_shift.data[0, 0] = torch.nan
            poisoned.append(progress)
        return found(self, generator, progress)

    monkeypatch.setattr(ReliefObjective, "loss", loss)
    codec, (btf, _) = Relief(steps=40, batch=64, bits=4), bumps()
    parts = codec.encode(btf, Fit())
    assert poisoned
    assert codec.decode(parts, torch.device("cpu")).slice(btf.wo[:1], btf.wi[:1]).isfinite().all()
