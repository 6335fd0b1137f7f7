import copy
import importlib.util
import itertools
import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
import torch

from bench.inputs.errors import InputError
from bench.material import sample_texture
from bench.timing.execution import DTYPES, TOLERANCES
from bench.timing.fused import target
from bench.timing.fused.layers import layers_of
from bench.timing.fused.lean import Lean
from bench.training.decoder import Architecture, Decoder

ARCHITECTURES = {
    "NeuBTF": Architecture(18, (32, 32, 32), activation="sine", omega=2.0, norm=True, residual=True),
    "no norm": Architecture(7, (16, 16), activation="sine", omega=30.0, residual=True),
    "NeuMIP": Architecture(11, (25, 25, 25), 6),
    "smelu": Architecture(12, (16, 16), activation="smelu"),
    "silu": Architecture(12, (20, 20), activation="silu"),
    "leaky": Architecture(12, (20, 20), activation="leaky-relu", norm=True),
}


def fitted(name: str) -> Decoder:
    """A network whose norms are not those that it starts with."""
    network = Decoder(ARCHITECTURES[name], torch.Generator().manual_seed(0)).requires_grad_(False)
    for norm in network.norms or ():
        norm.weight.uniform_(0.3, 2.0)
        norm.bias.uniform_(-1.0, 1.0)
    return network


def inputs(network: Decoder, count: int, size: float) -> torch.Tensor:
    return size * torch.randn(count, network.architecture.inputs, generator=torch.Generator().manual_seed(1))


def assert_close(fast: Callable[[torch.Tensor], torch.Tensor], network: Decoder, precision: str = "float32") -> None:
    """Within the stated tolerance of the same weights in float64, for batches of several sizes and extreme latents."""
    absolute, relative = TOLERANCES[precision]
    exact = copy.deepcopy(network).double()
    for count, size in ((1, 1.0), (300, 1.0), (300, 100.0), (7, 0.0)):
        x = inputs(network, count, size)
        expected = exact(x.double())
        error = (fast(x) - expected).abs().max().item()
        assert error <= absolute + relative * expected.abs().max().item(), (count, size, error)


def assert_fetches(make: type[torch.nn.Module], size: tuple[int, int]) -> None:
    """What a network answers for a texture of a size: at places within, at its corners, and periods away."""
    network, generator = fitted("NeuBTF"), torch.Generator().manual_seed(2)
    texture, uv = torch.randn(*size, 14, generator=generator), 3 * torch.rand(200, 2, generator=generator) - 1
    uv[:4] = torch.tensor([[0.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    wo, wi = torch.randn(2, 200, 3, generator=generator).unbind()
    ours = make(network).at(texture, uv, wo[:, :2], wi[:, :2])
    expected = network(torch.cat([sample_texture(texture, uv), wo[:, :2], wi[:, :2]], 1))
    torch.testing.assert_close(ours, expected, atol=3e-5, rtol=1e-4)  # uv · width rounds at 1e-6 of a texel


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_the_folded_layers_are_the_network(name):
    network = fitted(name).double()
    x = inputs(network, 50, 1.0).double()
    y = x.numpy()
    for layer in layers_of(network):
        hidden = y @ layer.weight.T + layer.bias
        if layer.norm is not None:
            hidden = hidden / np.sqrt((hidden**2).mean(1, keepdims=True) + layer.norm.eps)
            hidden = hidden * layer.norm.gain + layer.norm.offset
        match layer.activation:
            case "sine":
                hidden = np.sin(2 * np.pi * hidden)
            case "relu" | "leaky-relu":
                hidden = np.where(hidden > 0, hidden, hidden * (0.01 if layer.activation == "leaky-relu" else 0))
            case "smelu":
                parabola = 0.495 * hidden**2 + 0.505 * hidden + 0.12375
                hidden = np.where(hidden < -0.5, 0.01 * hidden, np.where(hidden > 0.5, hidden, parabola))
            case "silu":
                hidden = hidden / (1 + np.exp(-hidden))
        y = y + hidden if layer.residual else hidden
    np.testing.assert_allclose(y, network(x).numpy(), rtol=1e-10, atol=1e-10)


HALVES = [pair for pair in itertools.product(ARCHITECTURES, ["bfloat16", "float16"]) if pair[0] != "no norm"]


@pytest.mark.parametrize(("name", "precision"), [*((name, "float32") for name in ARCHITECTURES), *HALVES])
def test_the_default_network_and_the_lean_one_stay_within_tolerance(name, precision):
    network = fitted(name).to(DTYPES[precision])
    assert_close(network, network, precision)
    assert_close(Lean(network), network, precision)


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_a_network_in_a_kernel_of_the_cpu_stays_within_tolerance(name):
    pytest.importorskip("drjit", reason="Dr.Jit is not installed (the extra mitsuba)")
    try:
        of_cpu = target.target_of(torch.device("cpu"))
    except InputError as error:
        pytest.skip(str(error))
    import drjit as dr

    from bench.timing.fused.with_drjit import DrJitNetwork, batched

    network = fitted(name)
    within = DrJitNetwork(network, of_cpu).within
    width = network.architecture.inputs

    def kernel(n, flat):
        row = dr.arange(of_cpu.arrays.UInt32, n)
        return within(row, [dr.gather(of_cpu.arrays.Float, flat, row * width + k) for k in range(width)])

    def fast(x):
        return batched(of_cpu, {}, kernel, (x,), [])

    assert_close(fast, network)
    assert fast(torch.zeros(0, width)).shape == (0, network.architecture.outputs)


def test_without_drjit_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "drjit", None)
    with pytest.raises(InputError, match=r"neubtf-bench\[mitsuba\]"):
        target.target_of(torch.device("cpu"))


@pytest.fixture
def triton_network():
    if importlib.util.find_spec("triton") is None:
        pytest.skip("Triton is not installed (pip install triton)")
    if os.environ.get("TRITON_INTERPRET") != "1":
        pytest.skip("Triton decides as it is imported whether it interprets: see the test below, which runs this one")
    from bench.timing.fused.with_triton import TritonNetwork

    return TritonNetwork


@pytest.mark.timeout(400)
def test_triton_passes_the_tests_below_in_a_process_that_interprets():
    if importlib.util.find_spec("triton") is None or os.environ.get("TRITON_INTERPRET") == "1":
        pytest.skip("Triton is not installed (pip install triton), or interprets already")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "kernel_for_a_gpu", __file__]
    done = subprocess.run(command, env=os.environ | {"TRITON_INTERPRET": "1"}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
    assert "skipped" not in done.stdout


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning")  # Triton's own
@pytest.mark.parametrize(
    ("name", "precision"),
    [*((name, "float32") for name in ARCHITECTURES), ("NeuBTF", "bfloat16"), ("NeuMIP", "bfloat16")],
)
def test_one_kernel_for_a_gpu_stays_within_tolerance(name, precision, triton_network):
    network = fitted(name).to(DTYPES[precision])
    assert_close(triton_network(network), network, precision)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning")
def test_the_kernel_for_a_gpu_fetches_the_texture(triton_network):
    assert_fetches(triton_network, (5, 7))


def test_the_kernel_for_a_gpu_refuses_what_it_cannot_compute(triton_network):
    with pytest.raises(InputError, match="one width"):
        triton_network(Decoder(Architecture(4, (8, 16))))
    with pytest.raises(InputError, match=r"residuals .* as wide as the inputs"):
        triton_network(Decoder(Architecture(8, (8, 8), residual=True)))
    with pytest.raises(InputError, match=r"float16.*compiled"):
        triton_network(Decoder(Architecture(4, (8,))).half())
    with pytest.raises(InputError, match=r"64 .*65"):
        triton_network(Decoder(Architecture(65, (8,))).bfloat16())
