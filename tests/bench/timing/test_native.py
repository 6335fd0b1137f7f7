import pytest
import torch

from bench.timing import native


@pytest.mark.parametrize(
    ("machine", "words", "capability", "expected"),
    [
        ("x86_64", {"avx2", "f16c"}, "AVX2", {"bfloat16", "float16"}),
        ("x86_64", {"avx2", "avx512f"}, "AVX512", {"bfloat16", "float16"}),
        ("x86_64", {"avx512f", "avx512_bf16"}, "AVX512", {"float16"}),
        ("x86_64", {"avx512f", "amx_bf16", "avx512_fp16"}, "AVX512", set()),
        ("x86_64", {"avx512f", "avx512_bf16"}, "AVX2", {"bfloat16", "float16"}),  # PyTorch was told to leave it
        ("x86_64", None, "AVX512", set()),  # nothing is known
        ("aarch64", {"asimdhp", "fphp"}, "DEFAULT", {"bfloat16"}),
        ("aarch64", {"asimdhp", "bf16"}, "SVE256", set()),
        ("arm64", None, "DEFAULT", set()),
    ],
)
def test_what_a_processor_emulates(monkeypatch, machine, words, capability, expected):
    monkeypatch.setattr(native.platform, "machine", lambda: machine)
    monkeypatch.setattr(native, "features", lambda: words)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: capability)
    precisions = ("float32", "tf32", "bfloat16", "float16")
    assert {precision for precision in precisions if native.emulated(precision, torch.device("cpu"))} == expected


def test_this_processor_tells_its_extensions_or_nothing(monkeypatch):
    assert native.features() is None or all(isinstance(word, str) for word in native.features())
    monkeypatch.setattr(native.Path, "read_text", lambda *_, **__: "processor\t: 0\nflags\t\t: fpu avx2 f16c\n")
    assert native.features() == {"fpu", "avx2", "f16c"}
