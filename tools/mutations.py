"""How well the tests guard: planted mistakes, and the share of them that the short tier notices.

    python tools/mutations.py [--count 80] [--seed 0]

Each mistake is one change in one module of `GUARDED`: another operator, another constant, a dropped line, two
arguments swapped. The tests of its room run in a copy of the repository until the first failure; a hang is one.
Prints the mistakes that no test noticed, and the share.
"""

import argparse
import ast
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
GUARDED = {  # by pattern of modules: paths under tests/
    "bench/metrics/*.py": ["bench/metrics"],
    "bench/codecs/container.py": [
        "bench/codecs/test_container.py",
        "bench/codecs/test_bounds.py",
        "bench/test_codec.py",
    ],
    "bench/training/stored_texture.py": ["bench/training"],
    "bench/training/quantise.py": ["bench/training"],
    "bench/records/*.py": [
        "bench/test_records.py",
        "bench/test_record_fields.py",
        "bench/compare",
        "bench/cli/commands/test_history.py",
    ],
    "bench/compare/*.py": ["bench/compare", "reports/test_tables.py"],
    "bench/runs/identity.py": ["bench/runs/test_identity.py"],
    "bench/runs/runner.py": ["bench/runs/test_runner.py"],
    "bench/runs/job.py": ["bench/runs/test_runner.py"],
    "bench/compare/choosing.py": ["bench/compare/test_choosing.py", "bench/cli/commands/test_choose.py"],
    "reports/rungs.py": ["reports/test_rungs.py", "reports/test_front.py"],
    "bench/data/readers/*.py": ["bench/data/readers"],
}
# By operator: the one that a mistake puts in its place.
OTHER = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And}
OTHER |= {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
OTHER |= {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}


def changed(node: ast.AST) -> str:
    """Change one node in place, and return how in words; "" for a node that no mistake is made of."""
    before = ast.unparse(node)
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in OTHER:
            node.op = OTHER[type(op)]()
        case ast.Compare(ops=[op]) if type(op) in OTHER:
            node.ops = [OTHER[type(op)]()]
        case ast.Constant(value=bool(value)):
            node.value = not value
        case ast.Constant(value=int(value) | float(value)):
            node.value = value + 1
        case ast.Call(args=[first, second, *rest]) if not isinstance(first, ast.Starred | ast.Constant):
            node.args = [second, first, *rest]
        case ast.FunctionDef(body=[_, *_, last]) if isinstance(last, ast.Expr | ast.Assign | ast.AugAssign | ast.If):
            node.body = [*node.body[:-1], ast.Pass()]
            return f"{node.name}: dropped {ast.unparse(last).splitlines()[0]}"
        case _:
            return ""
    after = ast.unparse(node)
    return "" if after == before else f"{before} -> {after}"  # equal for a call of two like arguments


def planted(path: Path, rng: random.Random) -> tuple[str, str] | None:
    """A module's text with a mistake drawn by `rng`, and what and where it is; None if no mistake can be made in it."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside: list[ast.AST] = []
    for scope in ast.walk(tree):
        if isinstance(scope, ast.FunctionDef):
            inside += ast.walk(scope)
    rng.shuffle(inside)
    for node in inside:
        what = changed(node)
        if what:
            return ast.unparse(tree), f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}: {what}"
    return None


def noticed(folder: Path, tests: list[str]) -> bool:
    """Whether a test of these paths under tests/ fails in a copy of the repository, or hangs for five minutes."""
    places = [f"tests/{each}" for each in tests]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *places]
    environment = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=300, check=False)
    except subprocess.TimeoutExpired:
        return True
    return done.returncode != 0


def main() -> None:
    """Plant the mistakes one after the other, and print those that no test noticed and the share of the others."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--count", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    rng = random.Random(chosen.seed)
    found: list[bool] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "copy"
        # What is staged or committed, with files that tests read, such as the workflow of CI.
        subprocess.run(["git", "checkout-index", "--all", f"--prefix={folder}/"], cwd=ROOT, check=True)
        assert not any(noticed(folder, tests) for tests in GUARDED.values()), "the tests fail without a mistake"
        while len(found) < chosen.count:
            pattern = rng.choice(list(GUARDED))
            path = rng.choice(sorted(ROOT.glob(pattern)))
            mistake = planted(path, rng)
            if mistake is None:
                continue
            text, what = mistake
            place = folder / path.relative_to(ROOT)
            sound = place.read_text(encoding="utf-8")
            place.write_text(text, encoding="utf-8")
            is_noticed = noticed(folder, GUARDED[pattern])
            found.append(is_noticed)
            place.write_text(sound, encoding="utf-8")
            print("noticed" if is_noticed else "MISSED ", what, flush=True)
    print(f"{sum(found)} of {len(found)} noticed")


if __name__ == "__main__":
    main()
