from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from bench.btf import BTF, ArraySource
from bench.codec import Fit
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.codecs.slices_material import SlicesMaterial
from bench.conformance.check import tiny_btf, tiny_radiance
from bench.data.joined import appended
from bench.data.materials import load, recipe
from bench.data.materials.renderer import render
from bench.directions.hemisphere import from_degrees
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material
from bench.metrics.display import to_display
from bench.metrics.scoring import footprint_errors
from bench.records import MOST_DB
from bench.runs.drawing import sparse_truth
from bench.runs.evaluation import Slices, conditions, evaluate, record_of_scores, score_key, store_drawing
from bench.runs.workbench import MOST_STORED, SHEET_ANGLES, Workbench

WAVES = torch.tensor([3.0, 2.0])  # of the picture, across and down


class Exact(Material):
    """Radiance 1/2 + 1/4 · cos(2π a u) cos(2π b v), and its integral over any box: the mean of a cosine is a sinc."""

    def __init__(self, size):
        super().__init__(size, DecoderCost())

    def evaluate(self, uv, wo, wi, footprint):
        texels = footprint[:, None] * max(self.size)
        sides = texels / torch.tensor([self.size[1], self.size[0]])
        waves = torch.cos(2 * torch.pi * WAVES * uv) * torch.sinc(WAVES * sides)
        return (0.5 + 0.25 * waves.prod(1, keepdim=True)).expand(-1, 3)


@pytest.mark.parametrize("size", [(40, 48), (37, 41), (23, 46)])
def test_an_exact_material_is_exact_at_every_footprint_whatever_its_size(size):
    material = Exact(size)
    wo, wi = from_degrees([0, 40], [0, 70]), from_degrees([30, 10], [0, 0])
    values = np.stack([material.slice(o, i).numpy() for o, i in zip(wo, wi, strict=True)])
    btf = BTF("waves", wo, wi, ArraySource(values), periodic=True)
    decoder = Slices(SimpleNamespace(btf=btf, name="waves"), material, lambda *_: None)
    errors = footprint_errors(btf, [0, 1], decoder.boxes, 1.0)
    # Rounding of float32 leaves 130 dB and more; half a texel of misregistration 40.
    assert all((error < 1e-12).all() for error in errors.values())


def test_the_stored_pairs_are_many_held_out_and_spread_and_hold_those_of_the_sheet():
    bench = Workbench(tiny_btf(), "tiny")
    decides = bench.groups.get("heldout", bench.groups["all"])
    assert len(bench.shown) == min(MOST_STORED, len(decides)) == len(set(bench.shown.tolist()))
    assert set(bench.shown.tolist()) <= set(decides.tolist())
    assert set(bench.sheet.tolist()) <= set(bench.shown.tolist())
    assert 1 <= len(bench.sheet) <= len(SHEET_ANGLES)
    directions = np.concatenate([bench.btf.wo, bench.btf.wi], 1).astype(float)

    def nearest(pairs):
        apart = np.linalg.norm(directions[pairs][:, None] - directions[pairs], axis=2)
        return np.where(np.eye(len(pairs), dtype=bool), np.inf, apart).min()

    others = [np.random.default_rng(seed).choice(decides, len(bench.shown), replace=False) for seed in range(20)]
    assert all(nearest(bench.shown) >= nearest(other) for other in others)


def test_of_many_training_pairs_a_few_tell_and_every_held_out_pair_counts(tmp_path):
    btf = tiny_btf(16, 12, 12)
    btf.heldout = np.isin(np.arange(len(btf)), btf.split().train, invert=True)
    codec = load_codec("mean-colour")()
    file = loading.load(container.save(tmp_path / "file", codec, codec.encode(btf, Fit())).path)
    stored = {}
    keep = lambda name, content: stored.update({name: content}) or name  # noqa: E731
    whole, some = (Workbench(btf, "tiny", most_scored=count) for count in (0, 5))
    every, few = (evaluate(bench, file, 1, keep, lambda *_: None) for bench in (whole, some))
    assert (few["scores"]["heldout"], few["footprints"]) == (every["scores"]["heldout"], every["footprints"])
    assert few["pairs"] == every["pairs"]
    assert few["scores"]["train"]["slices"] == 5 < every["scores"]["train"]["slices"]
    assert "all" in every["scores"]
    assert "all" not in few["scores"]
    slices = stored[few["slices"]]
    assert {len(values) for name, values in slices.items() if name != "abrdf"} == {5 + few["pairs"]["heldout"]}
    assert score_key(whole, file.header) != score_key(some, file.header)


def test_pairs_of_low_light_are_a_group_of_their_own_and_change_nothing_else(tmp_path):
    few = tiny_btf(16, 5, 5)
    wo, wi = from_degrees([20, 40, 70], [0, 70, 200]), from_degrees([76, 82, 88], [0, 90, 300])
    row, col = np.mgrid[:16, :16] / 16
    dim = tiny_radiance(row, col, wo[:, None, None], wi[:, None, None]).astype(np.float32)
    declared = replace(few, heldout=np.arange(25) >= 20)
    low = appended(declared, BTF("low", wo, wi, ArraySource(dim), periodic=True), "low_light", "three")
    codec = load_codec("mean-colour")()
    file = loading.load(container.save(tmp_path / "file", codec, codec.encode(declared, Fit())).path)
    plain, lit = Workbench(declared, "tiny"), Workbench(low, "tiny")
    without, record = (evaluate(bench, file, 1, lambda name, _: name, lambda *_: None) for bench in (plain, lit))
    assert lit.groups["low light"].tolist() == [25, 26, 27]
    assert lit.groups["all"].tolist() == plain.groups["all"].tolist()
    assert lit.exposure == plain.exposure
    found = record["scores"].pop("low light")
    assert found["slices"] == record["pairs"].pop("low light") == 3
    errors = []
    for pair in (25, 26, 27):
        answer = file.material.slice(low.wo[pair].tolist(), low.wi[pair].tolist()).numpy()
        errors.append(np.square(to_display(low[pair], lit.exposure) - to_display(answer, lit.exposure)).mean())
    assert found["metrics"]["psnr_display"]["mean"] == pytest.approx(np.mean(-10 * np.log10(errors)), abs=1e-3)
    del record["provenance"], without["provenance"]
    assert record == without
    key, other = (score_key(bench, file.header) for bench in (lit, plain))
    assert key.pop("low_light") == 3
    assert key == other


class Finer(Material):
    """Leather at its drawn pairs, of a rendering twice as fine: the mean of the four fine texels around a place.

    `shift` texels further down and to the right, and with `added` radiance between texel centres.
    """

    def __init__(self, btf, shift=0.0, added=0.0):
        super().__init__(btf.shape, DecoderCost())
        self.shift, self.added = shift, added
        self.pairs = torch.from_numpy(np.concatenate([btf.wo, btf.wi], 1))
        fine = render(recipe("leather").maps(0), btf.wo, btf.wi, (2 * btf.shape[0], 2 * btf.shape[1]), 1)
        self.fine = torch.from_numpy(fine)

    def evaluate(self, uv, wo, wi, footprint):
        height, width = self.fine.shape[1:3]
        pair = (torch.cat([wo, wi], 1) @ self.pairs.T).argmax(1)
        row, col = (1 - uv[:, 1]) * height + 2 * self.shift, uv[:, 0] * width + 2 * self.shift
        rgb = 0
        for down in (-0.5, 0.5):
            for right in (-0.5, 0.5):
                rgb += self.fine[pair, (row + down).floor().long() % height, (col + right).floor().long() % width] / 4
        return rgb + self.added * torch.cos(torch.pi * uv[:, :1] * width / 2) ** 2


@pytest.mark.long
def test_between_texels_an_exact_material_is_exact_and_what_a_codec_adds_there_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path))
    btf = load("leather", size=8, views=3, lights=3, heldout=7, between=3)
    bench = Workbench(btf, "leather")
    assert bench.at_centres.tolist() == [9, 12, 15]

    def scored(material, bench=bench):
        return record_of_scores(bench, material, "leather", 1, lambda name, _: name, lambda *_: None)

    exact, opposite, added = (scored(Finer(btf, *how)) for how in ((), (-1.0,), (0.0, 0.5)))
    # Stored halves are accurate to 5e-4.
    assert exact["between"]["slices"] == 3
    assert min(exact["between"]["mean"], exact["between"]["centres"]) > MOST_DB - 1e-6
    assert opposite["between"]["mean"] < 35  # answers at half a texel the other way
    assert added["between"]["mean"] < 20
    assert added["between"]["centres"] == exact["between"]["centres"]
    # Nothing else changes.
    plain = Workbench(replace(btf, between=None), "leather")
    without = scored(Finer(btf), plain)
    del exact["between"]
    assert exact == without
    key, other = (conditions(workbench) for workbench in (bench, plain))
    assert key.pop("between") == 3
    assert key == other
    assert "between" not in scored(SlicesMaterial(btf, btf))  # stored slices answer nowhere else


def loaded(material):
    return SimpleNamespace(material=material, header=SimpleNamespace(path=Path("files/waves.nbtf")))


def test_a_drawing_is_stored_or_the_reason_why_not(monkeypatch):
    stored = {}
    keep = lambda name, content: stored.update({name: content}) or name  # noqa: E731
    assert store_drawing(loaded(Exact((8, 8))), keep) == {"drawing": "drawings/waves.npz"}
    assert "program" in stored.pop("drawings/waves.npz")

    def refuse(_):
        raise InputError("it branches")

    monkeypatch.setattr("bench.runs.evaluation.program_of", refuse)
    assert store_drawing(loaded(Exact((8, 8))), keep) == {"not_drawn": "it branches"}
    large = Exact((8, 8))
    large.cost = DecoderCost(texture_floats=10**7)
    assert "2,000,000" in store_drawing(loaded(large), keep)["not_drawn"]
    assert stored == {}


def test_a_truth_to_draw_has_few_pairs_and_is_none_where_those_are_too_large(monkeypatch):
    whole = tiny_btf(8, 16, 16)
    truth = sparse_truth(whole)
    assert max(len(each) for each in truth.constants.values() if each.shape[1:] == (3,)) == 81 * 64
    monkeypatch.setattr("bench.runs.drawing.SPARSE_FLOATS", 8 * 64 * 3)
    assert sparse_truth(whole) is None
