import re
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from bench import cli, encode, from_arrays, load
from bench.codec import Fit, setting_names
from bench.codecs.registry import codec_entries, load_codec
from bench.conformance.check import tiny_btf
from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material
from bench.program import Program
from bench.program.recording import program_of
from reports import artefacts
from reports.shaders.dialects import DIALECTS, GLSL, SLANG
from reports.shaders.export import LAYERS_TOLERANCE, TOLERANCE, Vectors, export
from reports.shaders.generator import shader
from reports.shaders.writer import Tables, literal
from reports.viewer.page import Shown, model_data, pack
from tests.baselines.surfaces import bumps
from tests.reports.shaders import slang
from tests.reports.shaders.reader import answer
from tests.tiers import short_for

CODECS = {
    "mean-colour": {},
    "pca": {"components": 5},
    "vq": {},
    "hsh": {},
    "ptm": {},
    "table": {},
    "neubtf-direct": {"steps": 5},
    "neumip": {"steps": 5},
    "neuralbtf": {"steps": 5, "width": 8},
    "zeltner2024": {"steps": 5},
    "relief": {"steps": 5, "batch": 64, "width": 32},
    "svbrdf": {"steps": 5, "batch": 64},
}

NO_VECTORS = Vectors(*(np.zeros((0, 3), np.float32) for _ in Vectors._fields))
NOT_DRAWN = {"hierarchical", "local-pca", "ntc"}  # they use operations that no shader has, which the export says


def decoded(codec: str, settings: dict[str, Any]) -> Material:
    instance = load_codec(codec)(**settings)
    btf = bumps()[0] if codec == "relief" else tiny_btf()
    material = instance.decode(instance.encode(btf, Fit()), torch.device("cpu"))
    assert codec != "relief" or vars(material)["relief"] is not None  # there is a height to march
    return material


def stored(material: Material, folder: Path) -> Program:
    np.savez(folder / "program.npz", **program_of(material).arrays())
    return artefacts.program(folder / "program.npz")


@pytest.mark.parametrize("codec", short_for(CODECS, "relief"))
def test_a_shader_answers_as_the_material_does(codec: str, tmp_path: Path) -> None:
    """Within what textures of halves round, 1e-3 of the brightest answer."""
    material = decoded(codec, CODECS[codec])
    code = shader(stored(material, tmp_path), GLSL)
    rng = np.random.default_rng(0)
    uv = rng.random((12, 2)).astype(np.float32)
    wo, wi = (uniform(rng, 12, 85.0).astype(np.float32) for _ in range(2))
    footprints = np.array([0.001, 0.2] * 6, np.float32)
    queries = [torch.from_numpy(x) for x in (uv, wo, wi, footprints)]
    truth = material.query(*queries).numpy()
    ours = np.stack([answer(code, *query) for query in zip(uv, wo, wi, footprints.tolist(), strict=True)])
    np.testing.assert_allclose(np.maximum(ours, 0), truth, atol=1e-3 * truth.max(), rtol=1e-3)


class Branching(Material):
    def __init__(self) -> None:
        super().__init__((2, 2), DecoderCost())

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return wo if wo[0, 2] > 0.5 else wi


class Sorting(Branching):
    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return wo.cumsum(1)


def test_whole_numbers_are_no_floats_of_the_same_bytes() -> None:
    tables, floats = Tables(), np.array([[1.0, 2.0]], np.float32)
    assert tables.place(floats) == tables.place(floats.astype(np.int32)) == ("exactRow", 0, 1)
    assert tables.place(floats.view(np.int32)) == ("exactRow", 1, 1)


class Layered(Material):
    """The product of two layers, plus one of matrices without a number."""

    def __init__(self) -> None:
        super().__init__((2, 2), DecoderCost())
        self.layers = torch.nn.ModuleList(torch.nn.Linear(3, 3) for _ in range(2))

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        nothing = 2 * (wo @ torch.zeros(3, 0))
        return self.layers[0](wo) * self.layers[1](wi) + nothing @ torch.zeros(0, 3)


def test_a_product_of_layers_is_computed_in_floats() -> None:
    """The range of halves may not hold it."""
    code = shader(program_of(Layered()), SLANG)
    assert len(re.findall(r"CoopVec<half, 3> t\d+ = coopVecMatMulAdd", code.text)) == 2
    assert len(re.findall(r"CoopVec<half, 3> t\d+ =", code.text)) == 4  # the inputs and outputs of both, no product


def test_what_no_shader_can_do_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be recorded"):
        program_of(Branching())
    with pytest.raises(InputError, match="'cumsum'"):
        shader(stored(Sorting(), tmp_path), GLSL)


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan])
def test_a_number_without_a_text_is_refused(number: float) -> None:
    with pytest.raises(InputError, match=f"no shader can hold the number {number}"):
        literal(number)


def test_a_foreign_file_is_no_program(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    np.savez(path, values=np.zeros(3))
    with pytest.raises(InputError, match=r"other\.npz"):
        artefacts.program(path)


@pytest.mark.parametrize("language", DIALECTS)
def test_an_export_holds_shader_textures_and_conventions(language: str, tmp_path: Path) -> None:
    program = stored(decoded("neubtf-direct", {"steps": 2}), tmp_path)
    files, held = export(program, "cloth", language, tmp_path / "out", "codec neubtf-direct, version 3", NO_VECTORS)
    more = {"glsl": {"cloth.frag"}, "slang": {"weights.bin"}}.get(language, set())
    names = {f"cloth.{language}", "exact.exr", "half.exr", "README.md"} | more
    assert {path.name for path in files} == {path.name for path in (tmp_path / "out").iterdir()} == names
    other = next(each for each in DIALECTS if each != language)
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "exact.exr").write_text("mine")
    for folder, wanted in (("out", other), ("own", language)):  # whose textures would be replaced
        with pytest.raises(InputError):
            export(program, "cloth", wanted, tmp_path / folder, "a codec", NO_VECTORS)
    assert held % 8 == 0 < held
    text = (tmp_path / "out" / f"cloth.{language}").read_text()
    assert all(bracket in text for bracket in "(){}")
    assert text.count("(") == text.count(")")
    height, width = program.size
    readme = (tmp_path / "out" / "README.md").read_text()
    assert f"{width} × {height} " in readme
    assert re.search(rf"neubtf-direct, version 3\b.* {re.escape(version('neubtf-bench'))}\.$", readme, re.M)


@pytest.mark.parametrize("codec", short_for(["pca", "neubtf-direct"], "pca"))
def test_the_test_vectors_of_an_export_are_the_decoded_files_answers(codec: str, tmp_path: Path) -> None:
    file = tmp_path / "cloth.nbtf"
    encode(tiny_btf(), load_codec(codec)(**CODECS[codec]), file)
    assert cli.main(["export", str(file), "-o", str(tmp_path / "out")]) == 0
    lines = (tmp_path / "out" / "README.md").read_text().partition("## Test vectors")[2].splitlines()
    rows = [line.strip("| ").split(" | ") for line in lines if line.startswith("| ")][2:]  # without the heading
    assert len(rows) == 5
    columns = [np.array([cell.split(", ") for cell in column], np.float32) for column in zip(*rows, strict=True)]
    uv, wo, wi, footprint, rgb = columns
    assert set(np.sign(footprint.ravel())) == {0, 1}
    material = load(file)
    truth = material.query(*(torch.from_numpy(each) for each in (uv, wo, wi, footprint[:, 0]))).numpy()
    np.testing.assert_array_equal(rgb, truth)
    code = shader(stored(material, tmp_path), GLSL)
    ours = [answer(code, *query) for query in zip(uv, wo, wi, footprint[:, 0].tolist(), strict=True)]
    np.testing.assert_allclose(np.maximum(ours, 0), truth, atol=TOLERANCE * truth.max())


@pytest.mark.parametrize("codec", ["pca", "relief"])
def test_an_exported_fragment_shader_compiles_as_it_is(codec: str, tmp_path: Path) -> None:
    validator = shutil.which("glslangValidator")
    if not validator:
        pytest.skip("glslangValidator is not installed (Debian: glslang-tools)")
    export(stored(decoded(codec, CODECS[codec]), tmp_path), "cloth", "glsl", tmp_path / "out", "a test", NO_VECTORS)
    done = subprocess.run(
        [validator, str(tmp_path / "out" / "cloth.frag")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


class Levelled(Material):
    """Answers the level of detail of a footprint, from a texture of 8 texels a side."""

    def __init__(self) -> None:
        super().__init__((8, 8), DecoderCost())

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return (footprint * 8).log2().clamp(0, 3)[:, None] + 0 * wo


def test_a_point_has_a_level_of_detail(tmp_path: Path) -> None:
    code = shader(stored(Levelled(), tmp_path), GLSL)
    up = np.array([0, 0, 1], np.float32)
    with np.errstate(all="raise"):  # the logarithm of 0 is undefined in GLSL
        answers = [answer(code, np.array([0.5, 0.5], np.float32), up, up, side) for side in (0.0, 0.5)]
    np.testing.assert_allclose(answers, [[0, 0, 0], [2, 2, 2]], atol=1e-6)


FLAT = short_for(sorted(set(codec_entries()) - NOT_DRAWN), "pca", "tucker", "mean-colour")


@pytest.mark.parametrize("level", [0.5, 0.0])
@pytest.mark.parametrize("codec", FLAT)
def test_a_constant_and_a_black_material_are_drawn(codec: str, level: float, tmp_path: Path) -> None:
    """PCA then has no component, its tables no channel."""
    tiny, kind = tiny_btf(12, 6, 6), load_codec(codec)
    btf = from_arrays(np.full((len(tiny), 6, 6, 3), level, np.float32), tiny.wo, tiny.wi)
    settings = {"steps": 3} if "steps" in setting_names(kind) else {}
    encode(btf, kind(**settings), tmp_path / "flat.nbtf")
    material = load(tmp_path / "flat.nbtf")
    program = stored(material, tmp_path)
    pack(model_data(Shown(codec, program, 1.0, "")))
    for language in DIALECTS:
        export(program, "flat", language, tmp_path / language, codec, NO_VECTORS)
    query = np.array([0.3, 0.7], np.float32), *(np.array(w, np.float32) for w in ([0, 0.6, 0.8], [0.6, 0, 0.8]))
    truth = material.query(*(torch.from_numpy(each)[None] for each in query), torch.tensor([0.2]))[0].numpy()
    ours = answer(shader(program, GLSL, "literal"), *query, 0.2)  # the reader knows no loops
    np.testing.assert_allclose(np.maximum(ours, 0), truth, rtol=2e-3, atol=1e-3)


@pytest.mark.parametrize("codec", short_for(["neubtf-direct", "pca", "relief"], "neubtf-direct"))
def test_glsl_and_hlsl_compile(codec: str, tmp_path: Path) -> None:
    validator = shutil.which("glslangValidator")
    if not validator:
        pytest.skip("glslangValidator is not installed (Debian: glslang-tools)")
    program = stored(decoded(codec, CODECS[codec]), tmp_path)
    glsl, hlsl = (shader(program, DIALECTS[name]).text for name in ("glsl", "hlsl"))
    call = "material({two}(0.1, 0.2), {three}(0.0, 0.0, 1.0), {three}(0.0, 0.0, 1.0), 0.0)"
    head = "#version 300 es\nprecision highp float;\nprecision highp int;\nout vec4 c;\n"
    main = f"void main() {{ c = vec4({call.format(two='vec2', three='vec3')}, 1.0); }}"
    (tmp_path / "a.frag").write_text(head + glsl + main)
    main = f"float4 main() : SV_Target {{ return float4({call.format(two='float2', three='float3')}, 1.0); }}"
    (tmp_path / "a.hlsl").write_text(hlsl + main)
    hlsl_flags = ["-D", "-e", "main", "-S", "frag", "-V", "-o", str(tmp_path / "a.spv")]
    for flags, name in (([], "a.frag"), (hlsl_flags, "a.hlsl")):
        done = subprocess.run([validator, *flags, str(tmp_path / name)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("codec", short_for(CODECS, "zeltner2024"))
def test_slang_compiles_and_answers_as_the_material_does(codec: str, tmp_path: Path) -> None:
    """To SPIR-V, with cooperative vectors where there are layers; and as C++, where their products are loops."""
    material = decoded(codec, CODECS[codec])
    code = shader(stored(material, tmp_path), SLANG)
    # The package has no optimiser, which other levels than 0 call.
    flags = ["-target", "spirv", "-profile", "spirv_1_6", "-capability", "spvCooperativeVectorNV", "-O0"]
    spirv = slang.compiled(code.text + slang.KERNEL, tmp_path, *flags).read_bytes()
    assert (b"SPV_NV_cooperative_vector" in spirv) == (code.layers.size > 0)
    rng = np.random.default_rng(0)
    wo, wi = (uniform(rng, 12, 85.0) for _ in range(2))
    queries = np.hstack([rng.random((12, 2)), wo, wi, [[0.001], [0.2]] * 6]).astype(np.float32)
    uv, wo, wi, footprint = np.split(queries, [2, 5, 8], 1)
    truth = material.query(*(torch.from_numpy(each.copy()) for each in (uv, wo, wi, footprint[:, 0]))).numpy()
    ours = slang.answers(code, queries, tmp_path)
    tolerance = LAYERS_TOLERANCE if code.layers.size else TOLERANCE
    np.testing.assert_allclose(np.maximum(ours, 0), truth, atol=tolerance * truth.max(), rtol=TOLERANCE)


SAYS = """async (code) => {
  const adapter = await navigator.gpu.requestAdapter();
  const made = (await adapter.requestDevice()).createShaderModule({ code });
  return (await made.getCompilationInfo()).messages.map((message) => `${message.lineNum}: ${message.message}`);
}"""


@pytest.mark.timeout(300)
@pytest.mark.long
def test_wgsl_compiles(browser: Any, tmp_path: Path) -> None:
    (tmp_path / "empty.html").write_text("<!doctype html><title>compile</title>")
    tab = browser.new_page()
    tab.goto((tmp_path / "empty.html").as_uri())
    for codec in ("neubtf-direct", "pca", "relief"):
        text = shader(stored(decoded(codec, CODECS[codec]), tmp_path), DIALECTS["wgsl"]).text
        assert tab.evaluate(SAYS, text) == []
    assert "unresolved" in tab.evaluate(SAYS, text.replace("exactOne(", "missing(", 1))[0]
