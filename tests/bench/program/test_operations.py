from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from bench.directions.hemisphere import uniform
from bench.inputs.errors import InputError
from bench.material import DecoderCost, Material
from bench.program import llvm
from bench.program.operations import OPERATIONS, REMAINDER_BY_POSITIVE
from bench.program.recording import program_of
from reports.shaders.dialects import GLSL
from reports.shaders.generator import shader
from tests.reports.shaders.reader import answer

Evaluate = Callable[[Tensor, Tensor, Tensor], Tensor]


SQUARE = torch.arange(16.0).reshape(4, 4)


def whole(uv: Tensor) -> Tensor:
    return (9 * uv).long()


def places(uv: Tensor) -> tuple[Tensor, Tensor]:
    """A row and a column of `SQUARE` for each query."""
    row, column = (4 * uv).long().clamp(0, 3).unbind(1)
    return row, column


MATERIALS: dict[str, Evaluate] = {
    "all": lambda uv, wo, wi: torch.where((wo > wi).all(1, keepdim=True), wo, wi),
    "any": lambda uv, wo, wi: torch.where((wo > wi).any(1, keepdim=True), wo, wi),
    "mean": lambda uv, wo, wi: wo * torch.cat([wo, wi], 1).mean(1, keepdim=True).abs(),
    "a sum of whole numbers": lambda uv, wo, wi: wi.abs() * whole(uv).sum(1, keepdim=True),
    "whole numbers without sign": lambda uv, wo, wi: wo.abs() * (whole(uv)[:, :1] - 4).abs(),
    "whole numbers and truths": lambda uv, wo, wi: 0.1 * (whole(uv)[:, :1] + (wo > wi)),
    "a remainder by a number of a tensor": lambda uv, wo, wi: wi.abs() * (whole(uv)[:, :1] % torch.tensor(4)),
    "a remainder by what may be 1": lambda uv, wo, wi: wi.abs() * (whole(uv)[:, :1] % (whole(uv)[:, 1:] + 1)),
    "a product and a sum of truths": lambda uv, wo, wi: (
        wo.abs() * ((wo > wi) * (wi > 0.2)) + wi.abs() * ((wo > 0.9) + (wi > 0.5))
    ),
    "a remainder of what may be negative": lambda uv, wo, wi: wi.abs() * ((whole(uv)[:, :1] - 7) % 4),
    "a remainder by a negative number": lambda uv, wo, wi: 5 + wi.abs() * (whole(uv)[:, :1] % -4),
    "the greatest of some numbers": lambda uv, wo, wi: torch.cat([wo, wi], 1).abs().topk(3).values,
    "the least of some numbers, and their places": lambda uv, wo, wi: (
        wo.abs() * torch.cat([wo, wi], 1).topk(3, largest=False).indices
    ),
    "a table and its transpose": lambda uv, wo, wi: (
        wo.abs() + SQUARE[places(uv)[0]][:, :3] + 100 * SQUARE.T[places(uv)[1]][:, :3]
    ),
    "indices that count from the end": lambda uv, wo, wi: (
        wo.abs() + SQUARE[places(uv)[0] - 2, places(uv)[1] - 2][:, None]
    ),
    "whole powers of what may be negative": lambda uv, wo, wi: 1 + (wo - 0.5) ** 3 + 0.01 * (wo - 2) ** -1,
    "a sum of no numbers": lambda uv, wo, wi: wo.abs() + (2 * (wi @ torch.zeros(3, 0))).sum(1, keepdim=True),
    "distances": lambda uv, wo, wi: torch.cdist(wo, torch.eye(3)),
    "a look-up of one whole number in few": lambda uv, wo, wi: (
        wo.abs() * torch.tensor([0.5, 2.0])[torch.tensor([1, 0])[whole(uv)[:, :1] % 2]]
    ),
}


class Made(Material):
    def __init__(self, formula: Evaluate):
        super().__init__((2, 2), DecoderCost())
        self.formula = formula

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        return self.formula(uv, wo, wi)


def queries(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    sides = [uniform(rng, count, 85.0).astype(np.float32) for _ in range(2)]
    return [rng.random((count, 2)).astype(np.float32), *sides, np.zeros(count, np.float32)]


def truth(material: Material, given: list[np.ndarray]) -> np.ndarray:
    return material.query(*(torch.from_numpy(x) for x in given)).numpy()


@pytest.mark.parametrize("name", MATERIALS)
def test_a_shader_does_it(name: str) -> None:
    material, given = Made(MATERIALS[name]), queries(20)
    code = shader(program_of(material), GLSL)
    ours = np.stack([answer(code, *query) for query in zip(*given, strict=True)])
    np.testing.assert_allclose(np.maximum(ours, 0), truth(material, given), rtol=1e-5, atol=1e-6)


def test_an_answer_that_depends_on_no_input_is_a_constant() -> None:
    program = program_of(Made(lambda uv, wo, wi: torch.tensor([0.25, 0.5, 1.0]).expand(len(uv), 3)))
    assert not program.steps
    np.testing.assert_array_equal(answer(shader(program, GLSL), *(each[0] for each in queries(1))), [0.25, 0.5, 1.0])


def test_a_shader_asks_for_no_whole_power_of_what_may_be_negative() -> None:
    """GLSL leaves `pow` undefined there."""
    code = shader(program_of(Made(MATERIALS["whole powers of what may be negative"])), GLSL)
    assert "pow(" not in code.text


class Whole(int):
    """A whole number that has a remainder only where GLSL and HLSL define it."""

    def __add__(self, other: int) -> "Whole":
        return Whole(int(self) + other)

    def __sub__(self, other: int) -> "Whole":
        return Whole(int(self) - other)

    def __mod__(self, other: int) -> "Whole":
        assert self >= 0
        assert other > 0
        return Whole(int(self) % int(other))


def larger(first: int, second: int) -> Whole:
    return Whole(max(int(first), int(second)))


def test_a_remainder_by_a_positive_number_asks_for_none_of_a_negative_one() -> None:
    code = REMAINDER_BY_POSITIVE.format("a", "b").replace("max(", "larger(")
    for a in range(-20, 21):
        for b in range(1, 8):
            assert eval(code, {"a": Whole(a), "b": Whole(b), "larger": larger}) == a % b


@pytest.mark.parametrize("name", MATERIALS)
def test_a_kernel_does_it(name: str) -> None:
    pytest.importorskip("drjit", reason="Dr.Jit is not installed (the extra mitsuba)")
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    import drjit.llvm as kind

    from bench.program.kernel import Kernel

    material, given = Made(MATERIALS[name]), queries(200)
    uv, wo, wi = ([kind.Float(column) for column in each.T] for each in given[:3])
    ours = np.stack([np.asarray(x) for x in Kernel(program_of(material), kind)(uv, wo, wi, kind.Float(given[3]))], 1)
    np.testing.assert_allclose(np.maximum(ours, 0), truth(material, given), rtol=1e-5, atol=1e-6)


def test_a_leaky_rectifier_that_is_steeper_below_0_is_refused() -> None:
    """The formula, the larger of x and slope times x, holds for slopes up to 1 alone."""
    asked: Any = SimpleNamespace(cannot=InputError)
    with pytest.raises(InputError, match="do a leaky_relu of slope 2"):
        OPERATIONS["leaky_relu"](asked, asked, asked, 2.0)
