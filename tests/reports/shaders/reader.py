"""Runs the straight-line GLSL that the generator writes, statement by statement: a second reading of its text."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np

from reports.shaders.generator import Shader

Array = np.ndarray


class Vector(np.ndarray):
    """Some floats with the swizzles of GLSL; its operators are those of NumPy."""

    def __getattr__(self, name: str) -> Any:
        if name not in "xyzw":
            raise AttributeError(name)
        return self["xyzw".index(name)]


def _vector(*parts: Any) -> Any:
    return np.hstack(parts).astype(np.float32).view(Vector)


def _vec4(*parts: Any) -> Any:
    return _vector(*parts) if len(parts) > 1 else _vector(*parts * 4)


class Matrix:
    def __init__(self, *columns: Array):
        self.columns = np.stack(columns, 1)

    def __mul__(self, vector: Array) -> Any:
        return _vector(self.columns @ vector)


def _each(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *arguments: function(*(a if isinstance(a, Vector) else np.float32(a) for a in arguments))


def _least(function: Callable[..., Any], first: Any, second: Any) -> Any:
    whole = isinstance(first, int) and isinstance(second, int)
    return int(function(first, second)) if whole else _each(function)(first, second)


def answer(shader: Shader, uv: Array, wo: Array, wi: Array, footprint: float) -> Array:
    """RGB (3,) of one query, by running the shader's text."""
    words: dict[str, Any] = {
        name: _each(getattr(np, name)) for name in ("exp", "log", "log2", "sin", "cos", "floor", "tanh")
    }
    words |= {"sqrt": _each(np.sqrt), "abs": _each(np.abs), "inversesqrt": _each(lambda x: 1 / np.sqrt(x))}
    words |= {"min": lambda a, b: _least(np.minimum, a, b), "max": lambda a, b: _least(np.maximum, a, b)}
    words |= {"vec4": _vec4, "mat4": Matrix, "vec3": lambda *parts: np.array(parts), "pow": _each(np.power)}
    words |= {"dot": lambda a, b: np.float32(a @ b), "int": int, "float": np.float32}
    for name, table in (("exactRow", shader.exact), ("halfRow", shader.half)):
        rows = table.reshape(-1, 4)
        words[name] = lambda i, rows=rows: _vector(rows[int(i)])
    words["exactOne"] = lambda i: shader.exact.reshape(-1)[int(i)]
    words |= {"uv": _vector(uv), "wo": _vector(wo), "wi": _vector(wi), "footprint": np.float32(footprint)}
    body = shader.text[shader.text.index("vec3 material(") :].splitlines()[1:-1]
    for line in body:
        text = line.strip().removesuffix(";")
        text = re.sub(r"\((\w+|true|false) \? (.+) : (.+)\)$", r"((\2) if (\1) else (\3))", text)
        for theirs, pythons in (("true", "True"), ("false", "False"), ("&&", "and"), ("||", "or"), ("!(", "not (")):
            text = text.replace(theirs, pythons)
        if text.startswith("return "):
            return np.asarray(eval(text.removeprefix("return "), words), np.float32)
        name, expression = re.sub(r"^(float|int|bool|vec4) ", "", text).split(" = ", 1)
        words[name] = eval(expression, words)
    raise AssertionError("the shader returns nothing")
