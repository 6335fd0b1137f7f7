from dataclasses import dataclass

import numpy as np
import pytest
import torch

import bench
from baselines.mean_colour import MeanColourMaterial
from bench import cli
from bench.btf import BAKED, BTF, ArraySource
from bench.btf.npz import write_npz
from bench.codec import Codec, Fit, Parts, SharedNetwork
from bench.codecs import container, loading, shared
from bench.conformance.check import others, tiny_btf
from bench.data import materials
from bench.data.readers import open_btf
from bench.data.spec import MaterialSpec
from bench.inputs.errors import ContainerError, InputError, MissingDataError
from bench.records import Record
from bench.runs import library
from bench.runs.library import MATERIALS, UNSEEN, pretrain
from bench.runs.runner import Options, run
from bench.runs.suite import CodecSpec, Suite


class Tint(SharedNetwork):
    name, version = "tinted", 1

    @dataclass(frozen=True)
    class Settings:
        bright: float = 1.0

    def train(self, btfs, fit):
        colour = np.mean([np.mean(list(btf), (0, 1, 2)) for btf in btfs], 0) * self.settings.bright
        return Parts(decoder={"colour": torch.from_numpy(colour)})


class Tinted(Codec):
    name, version = "tinted", 1
    network = Tint

    def encode(self, btf, fit):
        return Parts(texture={"mean": torch.from_numpy(sum(btf) / len(btf))}, network=fit.shared(self.name))

    def decode(self, parts, device):
        return MeanColourMaterial((parts.texture["mean"] * parts.network.parts.decoder["colour"]).float())


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_SHARED", str(tmp_path / "shared"))
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "cache"))
    # The registry last: a module that is imported here for the first time must not keep the replaced functions.
    for module in ("runs.job", "runs.runner", "runs.suite", "cli.commands.encode", "codecs.registry"):
        monkeypatch.setattr(f"bench.{module}.make_codec", lambda name, settings: Tinted(**settings))
    monkeypatch.setattr("bench.codecs.registry.load_codec", lambda name, wanted_by="": Tinted)


def make(**settings):
    return shared.make(Tint(**settings), others(tiny_btf(4, 3, 3)), Fit(), shared.place("tinted"))


def encoded(path):
    codec = Tinted()
    return container.save(path, codec, codec.encode(tiny_btf(4, 3, 3), Fit(network=shared.find_for(codec))))


def test_a_material_is_two_files_and_the_second_is_found_by_its_hash(tmp_path):
    network, header = make(), encoded(tmp_path / "file.nbtf")
    assert (network.kind, header.kind) == ("shared", "material")
    assert (header.network, sum(header.part_bytes().values())) == (network.sha256, header.path.stat().st_size)
    material = loading.load(header.path)[1]
    hashed = tmp_path / shared.hashed_name(network.codec, network.sha256)
    shared.place("tinted").rename(hashed)
    assert loading.load(header.path)[1].texture.equal(material.texture)


def test_a_network_that_is_replaced_while_another_trains_stays_under_its_own_hash():
    class Overtaken(Tint):
        def train(self, btfs, fit):
            self.meanwhile = make(bright=2.0)
            return super().train(btfs, fit)

    make()
    slower = Overtaken(bright=3.0)
    path = shared.make(slower, others(tiny_btf(4, 3, 3)), Fit(), shared.place("tinted")).path
    kept = path.with_name(shared.hashed_name("tinted", slower.meanwhile.sha256))
    assert container.read_header(kept).sha256 == slower.meanwhile.sha256


def test_a_missing_network_is_explained_when_encoding_and_when_decoding(tmp_path):
    with pytest.raises(MissingDataError, match=r"missing.*pretrain tinted"):
        encoded(tmp_path / "file.nbtf")
    with pytest.raises(MissingDataError, match=r"Fit\(network=.*pretrain tinted"):
        Tinted().encode(tiny_btf(4, 3, 3), Fit())
    make()
    header = encoded(tmp_path / "file.nbtf")
    shared.place("tinted").unlink()
    wanted = f"{header.network}.*as tinted-{header.network[:12]}.nbtf.*pretrain tinted"
    with pytest.raises(ContainerError, match=wanted):
        loading.load(header.path)
    make(bright=2.0)
    with pytest.raises(ContainerError, match=f"{header.network}.*another"):
        loading.load(header.path)


def test_a_network_is_no_material_and_a_material_no_network(tmp_path):
    network, header = make(), encoded(tmp_path / "file.nbtf")
    with pytest.raises(ContainerError, match=r"network.*codec tinted"):
        loading.load(network.path)
    with pytest.raises(ContainerError, match="shared network"):
        shared.read(header.path)


def test_a_damaged_network_is_refused_by_name_and_not_written_over(tmp_path):
    path = make().path
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    for use in (lambda: encoded(tmp_path / "file.nbtf"), make):
        with pytest.raises(ContainerError, match=r"tinted\.nbtf: .*damaged"):
            use()
    assert path.read_bytes() == data


def test_it_refuses_what_it_was_trained_on_at_any_size_and_directions():
    trained = materials.load("leather", size=4, views=4, lights=4, heldout=0)
    network = shared.read(shared.make(Tint(), [trained], Fit(), shared.place("tinted")).path)
    for same in (trained, trained.subset([1, 2]), materials.load("leather", 6, views=5, lights=3, heldout=2)):
        with pytest.raises(InputError, match=r"leather: .*tinted"):
            shared.refuse_training_material(network, same)
    shared.refuse_training_material(network, materials.load("leather", size=4, views=4, lights=4, heldout=0, seed=1))
    shared.refuse_training_material(network, tiny_btf(4, 3, 3))


def test_the_origin_of_baked_maps_is_that_of_their_files_and_of_measured_data_their_content():
    like = tiny_btf(4, 3, 3)

    def baked(name, depth):
        maps = {"height": f"stone_Height.png: bright is high, depth {depth}", "roughness": "stone_Roughness.png"}
        provenance = {"source": BAKED, "maps": maps}
        values = np.full((9, 2, 2, 3), depth, np.float32)
        return BTF(name, like.wo, like.wi, ArraySource(values), provenance=provenance)

    assert shared.origin(baked("stone", 0.1)) == shared.origin(baked("stone", 0.2)) != shared.origin(baked("sand", 0.1))
    assert shared.origin(like) == shared.origin(like.subset([3])) != shared.origin(others(like)[0])


def test_a_network_is_trained_on_variations_and_watched_on_others(monkeypatch):
    monkeypatch.setattr("bench.runs.library.load_variation", lambda number: others(tiny_btf(4, 3, 3))[number % 5])
    asked, path = [], shared.place("tinted")
    monkeypatch.setattr(Tint, "train", lambda self, btfs, fit: asked.append((len(btfs), len(fit.unseen))) or Parts())
    pretrain(Tint(), Fit(), path)
    assert asked == [(MATERIALS, len(UNSEEN))]
    assert not set(range(MATERIALS)) & set(UNSEEN)
    assert len(shared.read(path).parts.other["origins"]) == MATERIALS
    with pytest.raises(InputError, match=r"material.* 0$"):
        pretrain(Tint(), Fit(), path, materials=0)


def test_a_codec_encodes_with_the_network_that_it_ships_unless_there_is_another(tmp_path, monkeypatch):
    monkeypatch.setattr(Tint, "shipped", make().path.rename(tmp_path / "shipped.nbtf"))
    shipped, header = shared.read(Tint.shipped), encoded(tmp_path / "file.nbtf")
    assert header.network == shipped.sha256
    before = loading.load(header.path)[1]
    own = make(bright=0.5)
    assert own.sha256 == encoded(tmp_path / "other.nbtf").network != shipped.sha256
    assert loading.load(header.path)[1].texture.equal(before.texture)


SUITE = Suite("test", "", materials=(MaterialSpec("tiny"),), codecs=(CodecSpec("tinted"),))


@pytest.fixture
def tiny(monkeypatch, undrawn):
    monkeypatch.setattr("bench.runs.workbench.open_material", lambda *_: tiny_btf(12, 4, 4))
    monkeypatch.setattr("bench.timing.TURNS", 3)


def job(folder) -> Record:
    (outcome,) = run(SUITE, Options(folder))
    return outcome.record


@pytest.mark.usefixtures("tiny")
def test_a_run_without_the_network_says_how_to_get_it_and_takes_the_one_that_is_shipped(tmp_path, monkeypatch):
    missing = job(tmp_path / "run")
    assert missing["status"] == "unavailable"
    assert "pretrain tinted" in missing["error"]
    monkeypatch.setattr(Tint, "shipped", make().path.rename(tmp_path / "shipped.nbtf"))
    assert job(tmp_path / "run")["status"] == "ok"
    shared.make(Tint(), [tiny_btf(12, 4, 4)], Fit(), shared.place("tinted"))
    trained = job(tmp_path / "run")
    assert trained["status"] == "failed"
    assert "shared network" in trained["error"]


@pytest.mark.usefixtures("tiny")
def test_a_record_has_two_sizes_and_its_run_decodes_without_the_place_of_networks(tmp_path):
    network = make()
    record = job(tmp_path / "run")
    assert (record["fit_key"]["shared"], record["bytes"]["shared"]) == (network.sha256, network.path.stat().st_size)
    assert record["bytes"]["total"] == (tmp_path / "run" / record["file"]).stat().st_size
    network.path.unlink()
    loading.load(tmp_path / "run" / record["file"])


def test_a_network_that_was_trained_on_the_material_neither_encodes_nor_scores_it(tmp_path, monkeypatch, capsys):
    make()
    encoded(tmp_path / "before.nbtf")
    btf = tiny_btf(4, 3, 3)
    shared.make(Tint(), [btf], Fit(), shared.place("tinted"))
    monkeypatch.setattr(library, "make_codec", lambda name, settings: Tinted(**settings))
    with pytest.raises(InputError, match="shared network"):
        bench.encode(btf, "tinted", tmp_path / "a.nbtf")
    header = encoded(tmp_path / "after.nbtf")
    assert header.network == shared.find("tinted").sha256
    with pytest.raises(InputError, match="shared network"):
        bench.score(tmp_path / "after.nbtf", btf)
    assert bench.score(tmp_path / "before.nbtf", btf)["scores"]
    write_npz(btf, tmp_path / "btf.npz")
    shared.make(Tint(), [open_btf(tmp_path / "btf.npz")], Fit(), shared.place("tinted"))
    assert cli.main(["encode", str(tmp_path / "btf.npz"), "--codec", "tinted", "-o", str(tmp_path / "b.nbtf")]) == 2
    assert "shared network" in capsys.readouterr().err
    assert not (tmp_path / "a.nbtf").exists()
    assert not (tmp_path / "b.nbtf").exists()
