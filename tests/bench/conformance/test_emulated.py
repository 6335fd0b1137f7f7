import re
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from bench import timing
from bench.btf import BTF
from bench.codec import Fit, settings_dict
from bench.codecs import container, loading, shared
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.conformance.emulated import counted
from bench.data.materials import load
from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError
from bench.machine.devices import require_present
from bench.training import fitting, optimiser, replay
from bench.training.decoder import Architecture, Decoder
from tests.tiers import short_for

PROJECT = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CODECS = sorted(PROJECT["entry-points"]["neubtf_bench.codecs"])
# Few kernels: each takes long on an emulated GPU. Textures are rounded from half of the steps on, channel by channel.
SMALL = {"steps": 4, "batch": 32, "patch": 2, "channels": 2, "latents": 2, "components": 2, "fine": 2, "coarse": 2}
SMALL |= {"slices": 2}
# Every recipe of every codec; the word after the name is the recipe.
RECIPES = []
for _name in CODECS:
    RECIPES += [_name, *(f"{_name} {recipe}" for recipe in load_codec(_name).recipes)]


def test_it_refuses_what_cuda_refuses(gpu: torch.device) -> None:
    ours, theirs = torch.ones(3, device=gpu), torch.ones(3)
    for mistake in (lambda: ours + theirs, lambda: torch.cat([ours, theirs]), lambda: theirs[ours.long()]):
        with pytest.raises(RuntimeError, match=r"device|on gpu|cpu"):
            mistake()
    with pytest.raises(RuntimeError, match="generator"):
        torch.rand(3, device=gpu, generator=torch.Generator())
    with pytest.raises(TypeError):
        ours.numpy()
    assert (ours + torch.tensor(1.0)).sum().item() == 6  # a number may stay on the CPU


def test_a_gpu_beyond_those_that_are_there_is_refused(gpu: torch.device) -> None:
    require_present(str(gpu), "--device")
    require_present(gpu.type, "--device")
    with pytest.raises(InputError, match=f"--device {gpu.type}:7"):
        require_present(f"{gpu.type}:7", "--device")


def test_it_counts_kernels_waits_and_bytes(gpu: torch.device) -> None:
    with counted() as traffic:
        ours = torch.ones(3).to(gpu)  # 12 bytes up
        total = (ours * 2)[1:].sum()
    assert (traffic.kernels.total(), traffic.waits, traffic.copied) == (2, {"up": 1}, 12)
    with counted() as traffic:
        float(total)
        ours[ours > 0]
        ours.to("cpu")
    assert traffic.waits == {"aten::_local_scalar_dense": 1, "aten::nonzero": 1, "down": 1}
    with counted() as outer:
        with counted() as inner:  # equal to the outer one when it ends
            torch.ones(3).to(gpu)
        torch.ones(3).to(gpu)
    assert (inner.copied, outer.copied) == (12, 24)


def material_for(name: str) -> BTF:
    return load("cable-knit", 16, views=9, lights=5, heldout=0) if name == "relief" else tiny_btf()


def test_every_codec_has_its_recipes_tried() -> None:
    assert {"neubtf paper", "neumip paper", "pca"} <= {*RECIPES}


@pytest.mark.parametrize("called", short_for(RECIPES, "bcf", "pca"))
def test_a_codec_fits_and_answers_on_a_gpu_as_on_the_cpu(
    called: str, gpu: torch.device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, *recipe = called.split()
    kind, btf = load_codec(name), material_for(name)
    settings = {key: value for key, value in SMALL.items() if key in settings_dict(kind())}
    codec = kind(**settings, **({"recipe": recipe[0]} if recipe else {}))
    network, state = shared.find_for(codec), tmp_path / "state"
    parts = codec.encode(btf, Fit(network=network))
    assert ("height" in parts.texture) == (name == "relief")

    def halt(label: str, done: int, total: int) -> None:
        if label.startswith("fitting") and done == SMALL["steps"]:
            raise KeyboardInterrupt

    monkeypatch.setattr(fitting, "KEEP_EVERY", 3)  # past half of the steps
    monkeypatch.setattr(fitting, "SAVE_SECONDS", 0.0)
    try:
        found = codec.encode(btf, Fit(network=network, device=gpu, checkpoint=state, show=halt))
    except KeyboardInterrupt:
        assert state.exists() or name == "svbrdf"  # which keeps none
        found = codec.encode(btf, Fit(network=network, device=gpu, checkpoint=state))
    path = container.save(tmp_path / "a.nbtf", codec, found).path
    of_cpu = container.save(tmp_path / "cpu.nbtf", codec, parts).path

    rng = np.random.default_rng(0)
    uv = torch.from_numpy(rng.uniform(-1, 2, (64, 2)).astype(np.float32))
    wo, wi = (torch.from_numpy(uniform(rng, 64, 89)) for _ in range(2))
    queries = uv, wo, wi, torch.linspace(0, 0.5, 64)
    # The same fit but for rounding: products of matrices may be summed in another order where they lie otherwise.
    answers = [loading.load(each, "cpu", network).material.query(*queries) for each in (path, of_cpu)]
    torch.testing.assert_close(*answers, rtol=1e-4, atol=1e-5)
    within = [q.to(gpu) for q in (uv - uv.floor(), *queries[1:])]
    for dtype in (torch.float32, torch.float16, torch.bfloat16):
        theirs = loading.load(path, "cpu", network).material.to(dtype=dtype)
        ours = loading.load(path, gpu, network).material.to(dtype=dtype)
        assert ours.device == gpu
        answers = ours.query(*(q.to(gpu) for q in queries))
        assert answers.device == gpu
        torch.testing.assert_close(answers.cpu(), theirs.query(*queries))
        with counted() as traffic, torch.no_grad():  # a CUDA graph can capture it
            ours.evaluate(*within)
        assert traffic.waits.total() == traffic.copied == 0, traffic.waits
        directions = btf.wo[0].tolist(), btf.wi[0].tolist()
        torch.testing.assert_close(ours.slice(*directions), theirs.slice(*directions))


# The most kernels of a step in the first half of a fit and of one after it, bytes up a step, and kernels of a query.
# A step has no wait; a chunk of a query has one, of its checks. A GPU is slow where these numbers are high, not where
# its kernels are. Some kernels of a step read and set what lies in memory, where a graph reads it: its learning rates,
# and the bounds of a height that moves.
MOST = {
    "neubtf-direct": (128, 200, 256, 130),
    "neumip": (398, 632, 256, 183),
    "neubtf": (136, 920, 1284, 130),  # three stages; the last of them every time with a random input
    "relief": (524, 1082, 256, 410),  # three grids, and a height, whose refinement begins at half of the steps
    "triple-plane": (121, 204, 256, 190),
    "pca": (0, 0, 0, 259),
}


@pytest.mark.parametrize("name", short_for(MOST, "pca"))
def test_kernels_waits_and_bytes_do_not_grow(
    name: str, gpu: torch.device, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    totals, step = list[tuple[int, ...]](), optimiser.Optimisers.step

    def noted(self: optimiser.Optimisers) -> None:
        step(self)
        totals.append((traffic.kernels.total(), traffic.waits.total(), traffic.copied))

    monkeypatch.setattr(optimiser.Optimisers, "step", noted)
    monkeypatch.setattr(replay, "records_graphs", lambda device: False)  # a replay is one kernel to this count
    kind, btf = load_codec(name), material_for(name)
    few = {"steps": 8, "batch": 32, "explore": 1.0}  # a guided step of neubtf shows a slice, whose picture is made anew
    codec = kind(**{key: value for key, value in few.items() if key in settings_dict(kind())})
    with counted() as traffic:
        parts = codec.encode(btf, Fit(device=gpu))
    steps = [[now - before for before, now in zip(*pair, strict=True)] for pair in pairwise(totals)] or [[0, 0, 0]]
    material = loading.load(container.save(tmp_path / "a.nbtf", codec, parts).path, gpu).material
    uv, up = torch.rand(64, 2).to(gpu), torch.tensor([0.6, 0.0, 0.8]).repeat(64, 1).to(gpu)
    footprint = torch.full((64,), 0.3 / max(btf.shape)).to(gpu)
    with counted() as query:
        material.query(uv, up, up, footprint)
    found = steps[0][0], steps[-1][0], max(steps[0][2], steps[-1][2]), query.kernels.total()
    assert all(ours <= most for ours, most in zip(found, MOST[name], strict=True)), found
    assert [steps[0][1], steps[-1][1], query.waits.total(), query.copied] == [0, 0, 1, 0]


def test_a_time_on_a_gpu_names_it_and_is_of_many_queries(gpu: torch.device) -> None:
    assert timing.conditions(1, "cpu")["batch"] == timing.BATCH
    assert "gpu" not in timing.conditions(1, "cpu")
    found = timing.conditions(1, str(gpu))
    assert found["batch"] == 1 << 20
    assert re.search("driver.*CUDA", found["gpu"])


def test_a_network_that_no_gpu_has_room_for_is_refused(gpu: torch.device) -> None:
    triton = pytest.importorskip("bench.timing.fused.with_triton", exc_type=ImportError)
    with pytest.raises(InputError, match="512 channels"):
        triton.TritonNetwork(Decoder(Architecture(20, (512, 512))).to(gpu))
