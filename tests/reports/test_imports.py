"""Compute, record, render are three places: who may import reports, and what reports may import."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
HEAVY = {"torch", "baselines", "neubtf", "scipy", "sklearn", "skimage"}


def imported(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module


def files(*folders):
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize("folder", ["bench", "baselines", "neubtf"])
def test_only_commands_import_reports_and_draw_tables(folder):
    drawing = {"reports", "tabulate"}
    found = [path for path in files(folder) if {name.split(".")[0] for name in imported(path)} & drawing]
    assert {path.parent.name for path in found} <= {"commands"}


def test_reports_import_neither_codecs_nor_what_computes():
    names = "btf codecs.alike compare files inputs.errors metrics records"
    allowed = {f"bench.{name}" for name in names.split()}
    program = {"bench.program", "bench.program.backend", "bench.program.operations"}  # the rest of it imports more
    for path in files("reports"):
        for name in imported(path):
            assert name.split(".")[0] not in HEAVY, path
            fine = name in program or any(name == a or name.startswith(f"{a}.") for a in allowed)
            assert fine or not name.startswith("bench"), path
