from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.rainer2020 import Pool, Rainer2020, Rainer2020Network, Rainer2020Objective, canonical_pairs
from bench.btf import BTF, ArraySource
from bench.codec import Fit, TrainedNetwork
from bench.codecs import shared
from bench.conformance.check import others, tiny_btf
from bench.directions.hemisphere import from_degrees
from bench.training import fitting as training
from tests.baselines.made import decoded


def network(**settings: Any) -> Rainer2020Network:
    return Rainer2020Network(**{"steps": 20, "texels": 8, "pairs": 8} | settings)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainedNetwork:
    """The file of a network that saw a few small materials."""
    path = tmp_path_factory.mktemp("shared") / "rainer2020.nbtf"
    ours = Rainer2020Network(steps=300, texels=8, rate=1e-2)
    return shared.read(shared.make(ours, others(tiny_btf()), Fit(), path).path)


@pytest.mark.long
def test_a_material_it_has_not_seen_comes_near_its_data(trained: TrainedNetwork) -> None:
    """Nearer than the mean colour of each texel comes, at the pairs it was given and at others."""
    seen, all_pairs = tiny_btf(), tiny_btf(views=20, lights=20)
    codec = Rainer2020()
    material = decoded(codec, seen, Fit(network=trained))
    mean = sum(seen) / len(seen)
    for btf in (seen, all_pairs):
        ours, floor = [], []
        for wo, wi, truth in zip(btf.wo, btf.wi, btf, strict=True):
            answer = material.slice(wo.tolist(), wi.tolist()).numpy()
            ours.append(np.square(answer - truth).mean())
            floor.append(np.square(mean - truth).mean())
        assert np.mean(ours) < 0.5 * np.mean(floor)


def test_the_further_channels_are_mean_and_deviation_at_the_canonical_pairs(trained: TrainedNetwork) -> None:
    btf = tiny_btf(views=25, lights=25)  # the canonical pairs
    parts = Rainer2020(bits=32).encode(btf, Fit(network=trained))
    logs = np.log1p(parts.other["gain"].numpy() * np.stack(list(btf)))
    mean, deviation = parts.texture["latents"][..., 32:].chunk(2, -1)
    told = (deviation > 0).numpy()  # else the network tells less than the mean
    assert told.mean() > 0.9
    np.testing.assert_allclose(mean, logs.mean(0), rtol=1e-3)
    np.testing.assert_allclose(deviation[told], logs.std(0)[told], rtol=5e-3)


def like(btf: BTF, wo: np.ndarray, wi: np.ndarray, radiance: Callable[[Any, Any], np.ndarray]) -> BTF:
    """A material of one colour: `radiance` of directions (n, 3)."""
    values = np.broadcast_to(radiance(wo, wi)[:, None, None], (len(wo), 2, 2, 3)).astype(np.float32)
    return BTF("one colour", wo, wi, ArraySource(values))


@pytest.mark.parametrize("product", [True, False])
def test_a_surface_at_other_directions_has_nearly_the_same_latents(trained: TrainedNetwork, product: bool) -> None:
    def smooth(wo: np.ndarray, wi: np.ndarray) -> np.ndarray:
        return (0.3 + 0.1 * wo[:, :1]) * wi[:, 2:]

    latents = []
    for views, lights in ((25, 25), (40, 35)):
        base = tiny_btf(views=views, lights=lights)
        keep = np.arange(len(base)) if product else np.random.default_rng(0).permutation(len(base))[:-1]
        btf = like(base, base.wo[keep], base.wi[keep], smooth)
        texture = Rainer2020(bits=32).encode(btf, Fit(network=trained)).texture["latents"]
        latents.append(texture[..., :32])  # the others follow the exposure, which follows the directions
    spread = latents[0].std()
    assert (latents[0] - latents[1]).abs().max() < (0.01 if product else 0.2) * spread


def test_what_it_would_tell_worse_than_the_mean_is_stored_as_the_mean(trained: TrainedNetwork) -> None:
    """Lights at the horizon alone: the canonical pairs have none there, and interpolation makes them far brighter."""
    base, low = tiny_btf(), from_degrees(np.full(9, 89.0), np.arange(9) * 40.0)
    wi = np.tile(low, (9, 1))
    btf = BTF("grazing", base.wo, wi, ArraySource(np.stack(list(base))), periodic=True)
    codec = Rainer2020(bits=32)
    parts = codec.encode(btf, Fit(network=trained))
    logs = np.log1p(parts.other["gain"].numpy() * np.stack(list(btf)))
    mean, deviation = parts.texture["latents"][..., 32:].chunk(2, -1)
    plain = (deviation == 0).numpy()
    assert plain.mean() > 0.5
    np.testing.assert_allclose(mean.numpy()[plain], logs.mean(0)[plain], rtol=1e-3)
    material = codec.decode(parts, torch.device("cpu"))
    slices = [material.slice(wo.tolist(), light.tolist()) for wo, light in zip(btf.wo, btf.wi, strict=True)]
    ours = np.log1p(parts.other["gain"].numpy() * torch.stack(slices).numpy())
    # Halves round the logs by 5e-4.
    assert (np.square(ours - logs).mean(0) <= 1.01 * logs.var(0) + 1e-6).all()


def test_what_is_asked_in_training_are_the_pairs_declared_held_out() -> None:
    base = tiny_btf()
    heldout = np.zeros(len(base), bool)
    heldout[[3, 7, 50]] = True
    btf = BTF("split", base.wo, base.wi, base.source, heldout=heldout)
    pool = Pool([btf, base], canonical_pairs(), 10, Fit())
    assert (pool.texels, pool.pairs) == (20, 375)
    assert len(pool.coordinates[0].unique(dim=0)) == 3
    assert len(pool.coordinates[1].unique(dim=0)) == 81
    assert pool.inputs.shape == (20, 625, 3)


def test_without_a_declared_held_out_pair_training_pairs_are_asked() -> None:
    base = tiny_btf()
    validation = np.arange(len(base)) < 20
    btf = BTF("none", base.wo, base.wi, base.source, heldout=np.zeros(len(base), bool), validation=validation)
    assert len(Pool([btf], canonical_pairs(), 10, Fit()).coordinates[0].unique(dim=0)) == len(base) - 20


def test_the_training_is_watched_on_what_it_does_not_see() -> None:
    seen, unseen = others(tiny_btf())[:2]
    pool = Pool([seen], canonical_pairs(), 10, Fit(unseen=[unseen]))
    assert (pool.texels, pool.trained_texels) == (20, 10)
    generator = torch.Generator().manual_seed(0)
    assert pool.draw_unseen(100, generator).texel.min() == 10
    objective = Rainer2020Objective(pool, network().settings, Fit())
    taken = []
    objective.latents = lambda texel: taken.append(texel) or torch.zeros(len(texel), 32)  # type: ignore[func-returns-value,method-assign]
    objective.loss(generator, 0)
    assert int(torch.cat(taken).max()) < 10


@pytest.mark.long
def test_a_killed_pretraining_gives_the_same_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "KEEP_EVERY", 10)
    monkeypatch.setattr(training, "SAVE_SECONDS", 0.0)
    ours, btfs, path = network(steps=30), others(tiny_btf()), tmp_path / "rainer2020.nbtf"

    def halt(label: str, done: int, total: int) -> None:
        if label.startswith("fitting") and done == 20:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        shared.make(ours, btfs, Fit(show=halt), path)
    assert [left.suffix for left in tmp_path.iterdir()] == [".state"]
    asked: list[int] = []
    resumed = shared.make(
        ours, btfs, Fit(show=lambda label, done, _: asked.append(done) if "fitting" in label else None), path
    )
    assert min(asked) == 10  # the state on disk when it was killed
    assert resumed.sha256 == shared.make(ours, btfs, Fit(), tmp_path / "alone.nbtf").sha256
    assert not list(tmp_path.glob("*.state"))
