from typing import Any

import numpy as np
import pytest
import torch

from baselines.biplane import CHECKED_PAIRS, PAIRS, Biplane, BiplaneDecoder, BiplaneNetwork, BiplaneObjective, Pool
from bench.codec import Fit, TrainedNetwork
from bench.codecs import shared
from bench.conformance.check import others, tiny_btf
from bench.directions import hemisphere
from bench.training import Samples, gain_of, train
from bench.training.stored_network import load_network
from bench.training.stored_texture import load_texture
from tests.baselines.made import at_tiny_pairs, coded, dense, fetch, leaky, oracle_difference, split


def codec(**settings: Any) -> Biplane:
    return Biplane(**{"steps": 10, "batch": 256} | settings)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainedNetwork:
    """The file of a network that saw a few small materials."""
    path = tmp_path_factory.mktemp("shared") / "biplane.nbtf"
    ours = BiplaneNetwork(steps=60, batch=256)
    return shared.read(shared.make(ours, others(tiny_btf())[:2], Fit(), path).path)


@pytest.mark.parametrize("kind", ["rusinkiewicz", "nearest"])
def test_a_decoded_file_answers_as_the_equations(trained: TrainedNetwork, kind: str) -> None:
    parts, material = coded(codec(steps=40, bits=32, difference=kind), tiny_btf(), Fit(network=trained))
    gain = float(parts.other["gain"])
    wo, wi = (hemisphere.from_degrees(*at).astype(float) for at in ((50.0, 20.0), (35.0, 140.0)))
    found = material.slice(wo.tolist(), wi.tolist())
    h, d = oracle_difference(wo, wi, kind)
    half = fetch(parts.decoder["half"].double().numpy(), h[0], h[1])
    shapes = dense((256, 14), (128, 256), (256, 128), (128, 256), (256, 128), (3, 256))
    flat = split(trained.parts.decoder["weights"], *shapes)
    layers = list(zip(flat[::2], flat[1::2], strict=True))
    told = 0
    for row, col in np.ndindex(8, 8):
        texel = parts.texture["texels"][row, col].double().numpy()
        x = leaky(layers[0][0] @ np.concatenate([d[:2], half, texel[:6]]) + layers[0][1])
        for (narrow, first), (wide, second) in (layers[1:3], layers[3:5]):
            x = leaky(x + wide @ leaky(narrow @ x + first) + second)
        answer = 1 / (1 + np.exp(-(layers[5][0] @ x + layers[5][1])))
        level = answer @ texel[6:15].reshape(3, 3) + texel[15:]
        told += texel[6:15].any()
        # Float32 sums of hundreds of terms.
        np.testing.assert_allclose(found[row, col], np.expm1(level).clip(0) / gain, rtol=1e-3, atol=1e-5)
    assert told > 10


@pytest.mark.long
def test_a_material_comes_near_its_data_while_the_decoder_stays(trained: TrainedNetwork) -> None:
    fit, before = Fit(network=trained), trained.parts.decoder["weights"].clone()
    codec(steps=500).encode(tiny_btf(), fit)
    assert fit.history[-1]["psnr"] > 22
    assert torch.equal(trained.parts.decoder["weights"], before)


@pytest.mark.long
@pytest.mark.parametrize("bits", [0, 2])
def test_a_texel_that_falls_back_to_its_mean_leaves_the_others_as_the_fit_saw_them(
    trained: TrainedNetwork, bits: int
) -> None:
    base = tiny_btf()
    values = np.stack(list(base))
    # No decoder answers noise, so the means of these two rows are nearer to it.
    values[:, 3:5] = np.random.default_rng(0).uniform(0, 0.3, values[:, 3:5].shape)
    btf = at_tiny_pairs(values).subset(np.arange(CHECKED_PAIRS))
    ours, fit = codec(steps=60, bits=bits), Fit(network=trained)
    parts = ours.encode(btf, fit)
    stored = load_texture("texels", parts.texture).flatten(0, 1)

    decoder = load_network(BiplaneDecoder(), trained.parts.decoder).requires_grad_(False)
    samples = Samples(btf, gain_of(btf, fit), fit)
    fitting = BiplaneObjective(samples, decoder, ours.settings, fit.generator())
    train(fitting, fit, 60)
    rounding = fitting.rounded_texels
    assert torch.equal(parts.texture["texels.low"], rounding.low)
    assert torch.equal(parts.texture["texels.step"], rounding.step)

    seen = rounding(torch.cat([fitting.texture, fitting.colours], 1)).detach()
    # The fit adds the rounding to values; the file multiplies codes.
    same = torch.isclose(stored, seen, rtol=1e-5, atol=1e-6).all(1)
    means = torch.nn.functional.pad(samples.abrdfs(torch.arange(64)).mean(1), (9, 0))
    plain = rounding(torch.cat([fitting.texture, means], 1)).detach()
    fallen = torch.isclose(stored, plain, rtol=1e-5, atol=1e-6).all(1)
    assert (same | fallen).all()
    assert (fallen & ~same).any()
    assert (same & ~fallen).sum() > 10

    errors = []
    for texels in (stored, seen, plain):
        with torch.no_grad():
            fitting.texture.copy_(texels[:, :6])
            fitting.colours.copy_(texels[:, 6:])
            texel = torch.arange(64).repeat_interleave(CHECKED_PAIRS)
            pair = torch.arange(CHECKED_PAIRS).repeat(64)
            batch = samples.at(texel, pair)
            squares = (fitting.predict(batch, 1.0) - batch.target).square().mean(1)
            error = squares.unflatten(0, (64, CHECKED_PAIRS)).mean(1)
        errors.append(error)
    torch.testing.assert_close(errors[0], torch.minimum(errors[1], errors[2]), rtol=1e-4, atol=1e-7)


def test_the_training_sees_each_material_at_its_own_pairs() -> None:
    base = tiny_btf()
    few = base.subset(np.arange(0, len(base), 5))
    pool = Pool([base, few], 10, Fit())
    assert (pool.texels, pool.pairs) == (20, PAIRS)
    assert pool.material.tolist() == [0] * 10 + [1] * 10
    assert [len(w.unique(dim=0)) for w in pool.wo.split(PAIRS)] == [9, len(np.unique(few.wo, axis=0))]
    # Whatever texel was drawn, its radiance at a pair is some texel's of the material at that pair.
    for number, btf in enumerate((base, few)):
        gain = gain_of(btf.subset(btf.split().train), Fit())
        for pair in (0, 77, 399):
            at = number * PAIRS + pair
            same = (btf.wo == pool.wo[at].numpy()).all(1) & (btf.wi == pool.wi[at].numpy()).all(1)
            truth = np.log1p(gain * btf[int(np.flatnonzero(same)[0])]).reshape(-1, 3)
            ours = pool.at(torch.tensor([10 * number + 3]), torch.tensor([pair])).target.numpy()
            assert np.abs(truth - ours).max(1).min() < 2e-3  # halves


def test_the_decoder_learns_nothing_from_what_is_kept_for_the_curve() -> None:
    seen, unseen = others(tiny_btf())[:2]
    pool, settings = Pool([seen], 10, Fit(unseen=[unseen])), BiplaneNetwork(batch=64).settings
    assert (pool.texels, pool.trained_texels) == (20, 10)
    gradients = []
    for scale in (1, 5):
        generator = torch.Generator().manual_seed(0)
        fitting = BiplaneObjective(pool, BiplaneDecoder(generator), settings, generator)
        assert pool.table is not None
        pool.table[10:] *= scale
        fitting.loss(generator, 0).backward()
        decoder = torch.cat([p.grad.flatten() for p in fitting.network.parameters() if p.grad is not None])
        assert len(decoder) == 136_451
        assert fitting.texture.grad is not None
        gradients.append((decoder, *fitting.texture.grad.split(10)))
    (decoder, trained, kept), (same, again, changed) = gradients
    assert decoder.equal(same)
    assert trained.equal(again)
    assert not kept.equal(changed)
