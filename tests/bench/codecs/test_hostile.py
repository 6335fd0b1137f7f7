import pytest
import torch
from fuzz_codec_files import rehashed, resealed

from bench.codec import Fit, Parts
from bench.codecs import container, loading
from bench.codecs.registry import load_codec
from bench.conformance.check import tiny_btf
from bench.inputs.errors import ContainerError


def mean_colour_file(folder):
    parts = Parts(texture={"mean": torch.ones(2, 2, 3)})
    return container.save(folder / "a.nbtf", load_codec("mean-colour")(), parts).path


WRONG = [("codec", ["pca"]), ("version", "1"), ("version", 1e300), ("kind", 3), ("shared", 5), ("scene", "satin")]
WRONG += [("provenance", [1]), *(("settings", value) for value in ([1], {"half": {"deep": 1}}, {"half": float("nan")}))]


@pytest.mark.parametrize(("field", "value"), WRONG)
def test_a_field_of_the_wrong_type_is_named(field, value, tmp_path):
    path = mean_colour_file(tmp_path)
    resealed(path, lambda fields, tensors: fields.update({field: value}))
    with pytest.raises(ContainerError, match=rf"a\.nbtf.*{field}"):
        loading.load(path)


HUGE = torch.tensor([2**30, 2**30], dtype=torch.int32)


def two_stages(parts):
    parts.other["size"] = torch.tensor([4096, 4096], dtype=torch.int32)
    parts.other["codes"] = torch.tensor([1, 1], dtype=torch.int32)
    parts.texture["index1"] = parts.texture["index0"].clone()


@pytest.mark.parametrize(
    ("name", "settings", "change", "message"),
    [
        ("vq", {"codes": 5}, lambda p: p.texture.update(index0=p.texture["index0"][:-1]), "a texture"),
        ("vq", {"codes": 1}, lambda p: p.other.update(size=HUGE), "index"),
        ("vq", {"codes": 1}, two_stages, "index.* 4096 .*2 stages"),
        ("neumip", {"steps": 1, "batch": 16}, lambda p: p.other.update(size=HUGE), "codec neumip"),
        ("pca", {"components": 2}, lambda p: p.other.update(views=p.other["views"][:-1]), "pairs"),
    ],
)
def test_parts_that_do_not_agree_are_refused_before_memory_is_taken(name, settings, change, message, tmp_path):
    codec = load_codec(name)(**settings)
    parts = codec.encode(tiny_btf(5, 3, 3), Fit(seed=1))
    change(parts)
    with pytest.raises(ContainerError, match=message):
        loading.load(container.save(tmp_path / "a.nbtf", codec, parts).path)


def test_numbers_that_are_not_finite_are_refused(tmp_path):
    path = mean_colour_file(tmp_path)
    content = path.read_bytes()
    path.write_bytes(rehashed(content[:-48] + torch.full((12,), torch.nan).numpy().tobytes()))
    with pytest.raises(ContainerError, match=r"texture/mean.*finite"):
        loading.load(path)


@pytest.mark.parametrize("setting", ["unheard", "zstd"])  # the second compressed the tensors of older files
def test_a_setting_that_the_codec_does_not_have_is_named_and_not_called_a_wrong_tensor(tmp_path, setting):
    path = mean_colour_file(tmp_path)
    resealed(path, lambda fields, tensors: fields["settings"].update({setting: True}))
    with pytest.raises(ContainerError, match=rf"a\.nbtf: cannot be decoded: .*no setting '{setting}'.*encode it again"):
        loading.load(path)
