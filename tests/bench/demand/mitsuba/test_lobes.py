import math

import numpy as np
import pytest
import torch

import bench
from bench import cli
from bench.codecs import container
from bench.demand.mitsuba.lobes import NAME, Lobe, checked, fitted, noise
from bench.directions.hemisphere import uniform
from bench.inputs.errors import ContainerError
from bench.material import DecoderCost, Material


class Plastic(Material):
    """White paper under a coat: a cosine and a narrow lobe around the mirror direction."""

    def __init__(self, width):
        super().__init__((4, 4), DecoderCost())
        self.width = width

    def evaluate(self, uv, wo, wi, footprint):
        mirror = wo * torch.tensor([-1.0, -1.0, 1.0])
        lobe = (((wi * mirror).sum(1) - 1) / self.width).exp() / self.width
        return (wi[:, 2] * (0.1 + 0.1 * lobe))[:, None].expand(-1, 3)


def directions(n, seed=0, most=89.9):
    return torch.from_numpy(uniform(np.random.default_rng(seed), n, most)).float()


@pytest.mark.parametrize(
    "raw", [(0, -1, -1, 0, 0), (2, -3, 0.5, 0, 0), (1, -1, -2, 0.4, -0.3), (9, 3, 3, 0, 0), (-9, 0, 0, 3, 3)]
)
def test_a_density_integrates_to_what_stays_above_the_horizon(raw):
    """No more than 1, and 1 but for what a lobe throws below the horizon."""
    lobe = Lobe.from_stored(torch.tensor([raw], dtype=torch.float32).expand(200_000, -1))
    for seed, cosine in ((1, 0.95), (2, 0.4)):
        wo = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine]).expand(200_000, -1)
        total = float(lobe.density(wo, directions(200_000, seed)).mean()) * 2 * math.pi
        assert total < 1.02
        if raw[0] < 0 or (raw[3:] == (0, 0) and cosine > 0.9 and max(raw[1:3]) < 0):
            assert total > 0.9


def test_a_fit_finds_a_highlight_and_lessens_the_noise():
    before = torch.tensor([0.0, -1.0, -1.0, 0.0, 0.0]).expand(2, 2, -1)
    narrow = Plastic(0.01)
    lobes = fitted(narrow, cells=2, steps=120).float()
    assert torch.equal(fitted(narrow, 1, 5), fitted(narrow, 1, 5))
    roughness = Lobe.from_stored(lobes.reshape(4, -1))
    assert float(roughness.along.max()) < 0.2
    measured = noise(narrow, lobes)
    assert measured.total < 0.5 * noise(narrow, before).total
    assert measured.total < 0.1
    rough = Plastic(1.0)  # never much noisier than by the cosine
    assert noise(rough, fitted(rough, cells=1, steps=150).float()).total <= 1.2


@pytest.mark.long
def test_the_command_adds_a_part_and_changes_no_answer(tmp_path, capsys):
    file, out = tmp_path / "a.nbtf", tmp_path / "b.nbtf"
    bench.encode(bench.open("satin", size=8, views=9, lights=9, heldout=4), "pca", file, components=2)
    assert cli.main(["export", str(file), "--lobes", "-o", str(out)]) == 0
    assert "variance" in capsys.readouterr().out
    before, after = container.read_header(file), container.read_header(out)
    assert after.part_bytes()["sampling"] == 8 * 8 * 5 * 2
    assert {k: v for k, v in after.part_bytes().items() if k not in ("sampling", "header")} == {
        k: v for k, v in before.part_bytes().items() if k != "header"
    }
    uv, wo, wi = torch.rand(50, 2), directions(50, most=80), directions(50, 1, most=80)
    assert torch.equal(bench.load(file).query(uv, wo, wi), bench.load(out).query(uv, wo, wi))
    with pytest.raises(ContainerError, match=r"a\.nbtf: its lobes are \(2, 3, 5\), .* `export --lobes`"):
        checked(file, {NAME: torch.zeros(2, 3, 5)})
