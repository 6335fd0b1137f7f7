"""Compiles Slang with `slangc`, and runs it on the CPU, where Slang computes cooperative vectors by loops."""

import ctypes
import importlib.util
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from reports.shaders.generator import Shader

Array = np.ndarray

# One query a thread, as nine floats, and its answer as three.
KERNEL = """
StructuredBuffer<float> queries;
RWStructuredBuffer<float> answers;

[shader("compute")]
[numthreads(1, 1, 1)]
void ask(uint3 thread : SV_DispatchThreadID) {
  float q[9];
  for (int i = 0; i < 9; i++) q[i] = queries[thread.x * 9 + i];
  float3 rgb = material(float2(q[0], q[1]), float3(q[2], q[3], q[4]), float3(q[5], q[6], q[7]), q[8]);
  for (int k = 0; k < 3; k++) answers[thread.x * 3 + k] = rgb[k];
}
"""


def compiled(text: str, folder: Path, *flags: str) -> Path:
    """The file that `slangc` makes of a text with these flags; skips the test without it."""
    package = importlib.util.find_spec("slangtorch")
    in_package = Path(package.origin).with_name("bin") / "slangc" if package and package.origin else None
    compiler = in_package if in_package and in_package.is_file() else shutil.which("slangc")
    if not compiler:
        pytest.skip("slangc is not installed (PyPI: slangtorch)")
    source, result = folder / "a.slang", folder / "a.out"
    source.write_text(text)
    done = subprocess.run([compiler, source, *flags, "-o", result], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return result


def answers(code: Shader, queries: Array, folder: Path) -> Array:
    """RGB (n, 3) of queries (n, 9), by the shader as C++, for which its textures become buffers."""
    text = code.text.replace("Texture2D<float4>", "StructuredBuffer<float4>")
    text = text.replace(".Load(int3(i % 1024, i / 1024, 0))", "[i]")
    cpp = folder / "a.cpp"
    compiled(text + KERNEL, folder, "-target", "cpp").rename(cpp)
    compiler = shutil.which("g++")
    if not compiler:
        pytest.skip("g++ is not installed")
    subprocess.run([compiler, "-w", "-std=c++17", "-shared", "-fPIC", cpp, "-o", folder / "a.so"], check=True)
    rgb = np.zeros((len(queries), 3), np.float32)
    arrays = [code.exact, code.half.astype(np.float32), *([code.layers] if code.layers.size else []), queries, rgb]
    held = [np.ascontiguousarray(array) for array in arrays]
    buffers = []  # each a pointer and a count
    for array in held:
        buffers += [array.ctypes.data, array.nbytes]
    parameters = (ctypes.c_size_t * len(buffers))(*buffers)
    threads = (ctypes.c_uint32 * 6)(0, 0, 0, len(queries), 1, 1)  # from, and to before
    ctypes.CDLL(str(folder / "a.so")).ask(threads, None, parameters)
    return rgb
