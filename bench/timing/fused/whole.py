"""A whole material as one kernel: its recorded program, and its networks as `with_drjit` computes them.

The work of a codec before and after its network (marches, fetches, frames) is recorded by `bench.program.recording`,
with each network as one operation. So nothing between the queries and RGB goes through memory.
"""

from typing import Any

import drjit as dr
import torch
from torch import Tensor

from bench.inputs.errors import InputError
from bench.material import Material, Wrapped
from bench.program.backend import Value
from bench.program.kernel import Kernel
from bench.program.recording import program_of
from bench.timing.fused.target import Target
from bench.timing.fused.with_drjit import DrJitNetwork, RecordedCalls, batched
from bench.training.decoder import Decoder, Network

WIDTHS = (2, 3, 3, 1)  # of uv, wo, wi, footprint
MOST_PRODUCTS = 10_000  # of matrices outside networks, whose code does not stay in registers


@torch.library.custom_op("neubtf::network", mutates_args=())
def _network(inputs: Tensor, number: int, outputs: int) -> Tensor:
    """The operation that stands for network `number` of a material in a program: zeros (n, outputs), in a recording."""
    return inputs.new_zeros(len(inputs), outputs)


_network.register_fake(lambda inputs, number, outputs: inputs.new_zeros(len(inputs), outputs))


class Placeholder(Network):
    """Stands for a decoder network while its material is recorded."""

    def __init__(self, number: int, outputs: int):
        super().__init__()
        self.number = number
        self.outputs = outputs

    def forward(self, inputs: Tensor) -> Tensor:
        return torch.ops.neubtf.network(inputs, self.number, self.outputs)


class Whole(Wrapped):
    """A material whose `evaluate` is one kernel. `InputError` if it cannot be recorded, or is too large."""

    def __init__(self, material: Material, marked: Material, decoders: list[Decoder], target: Target):
        """`marked` is a copy of the material on the CPU, with placeholders for its networks: number i stands for
        `decoders[i]`."""
        super().__init__(material)
        self.target = target
        self.arrays = target.arrays
        self.networks = [DrJitNetwork(decoder, target) for decoder in decoders]
        program = program_of(marked)
        count = program.products()
        if count > MOST_PRODUCTS:
            limit = f"up to {MOST_PRODUCTS:,} products outside networks"
            raise InputError(f"a kernel of Dr.Jit holds {limit}, but this codec needs {count:,}: use compiled")
        self.traced = Kernel(program, self.arrays, {"network": self._within_kernel})
        self.kernels: RecordedCalls = {}
        # Recorded once only to find the tables that the kernels need.
        self.row = dr.arange(self.arrays.UInt32, 1)
        half = self.arrays.Float(0.5)
        self.traced([half] * 2, [half] * 3, [half] * 3, half)
        self.tables = [table for _, table in self.traced.tables.values()]

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return batched(self.target, self.kernels, self._kernel, (uv, wo, wi, footprint[:, None]), self.tables)

    def _kernel(self, n: int, *flat: Any) -> list[Any]:
        """Arrays (n,) of red, green and blue for n queries of `WIDTHS` row-major numbers."""
        self.row = dr.arange(self.arrays.UInt32, n)
        uv, wo, wi, (footprint,) = (self._columns(each, width) for each, width in zip(flat, WIDTHS, strict=True))
        return self.traced(uv, wo, wi, footprint)

    def _columns(self, flat: Any, width: int) -> list[Any]:
        """The columns (n,) of row-major inputs (n · width,)."""
        return [dr.gather(self.arrays.Float, flat, self.row * width + k) for k in range(width)]

    def _within_kernel(self, _: Any, step: Any, inputs: Value, number: int, outputs: int) -> Any:
        """For `Kernel`: the outputs of a network for the inputs (n, D) of one query, one row, or one for each texel."""
        network = self.networks[number]
        answers = []
        for row in inputs.items:
            numbers = [self.arrays.Float(value) for value in row]
            answers.append(list(network.within(self.row, numbers)))
        return answers
