"""The order of the rooms: imports inside `bench` go down only, without a circle; no file or function grows too long."""

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
FLOORS = [  # from the ground up; a room may enter those of lower floors, and a word any word
    {"inputs", "files", "machine", "records", "material", "btf", "directions", "codec"},
    {"metrics", "program"},
    {"training"},
    {"data", "codecs"},
    {"timing", "compare"},
    {"demand"},
    {"runs"},
    {"conformance"},
    {""},
    {"cli"},
]
FILES = [path for part in ("bench", "baselines", "neubtf", "reports") for path in sorted((ROOT / part).rglob("*.py"))]


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def names_in(path: Path) -> set[str]:
    """Every module that a file names in an import, wherever it stands, or as the place of a class, "module:Class"."""
    names = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and re.fullmatch(r"[\w.]+:[A-Z]\w*", str(node.value)):
            names.add(node.value.partition(":")[0])
    return names


@cache
def imports() -> dict[str, set[str]]:
    """Each module of the project with those that it imports; of a package and a file in it, the file alone."""
    known = {name_of(path): names_in(path) for path in FILES}
    found = {}
    for name, names in known.items():
        inner = {other for other in names if other in known}
        packages = {other for other in inner if any(longer.startswith(f"{other}.") for longer in inner)}
        found[name] = inner - packages - {name}
    return found


def test_imports_inside_bench_go_down_only() -> None:
    floor = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
    wrong = []
    for module, imported in imports().items():
        for other in imported:
            (package, here), (room_of, there) = ([*name.split("."), ""][:2] for name in (module, other))
            if package == room_of == "bench" and here != there:
                both_on_the_ground = here in FLOORS[0] and there in FLOORS[0]
                if not both_on_the_ground and floor[there] >= floor[here]:
                    wrong.append(f"{module} imports {other}")
    assert wrong == []


def test_mitsuba_is_imported_in_its_own_folder_alone() -> None:
    users = {name_of(path) for path in FILES if "mitsuba" in names_in(path)}
    assert users
    assert all(name.startswith("bench.demand.mitsuba.") for name in users), users


def test_no_file_is_imported_in_a_circle() -> None:
    left = dict(imports())
    while left:
        ground = {name for name, imported in left.items() if not imported & left.keys()}
        assert ground, f"a circle among {sorted(left)}"
        left = {name: imported for name, imported in left.items() if name not in ground}


def test_codecs_import_what_is_public_and_reports_what_is_recorded() -> None:
    page = (ROOT / "docs" / "adding-a-codec.md").read_text(encoding="utf-8")
    public = set(re.findall(r"^\| `(bench\.[a-z_.]+)` \|", page, re.M))
    others = {"bench": {"bench"}, "baselines": {"bench", "baselines"}, "neubtf": {"bench", "neubtf"}}
    for module, imported in imports().items():
        package = module.split(".")[0]
        if not module.startswith("bench.cli.commands"):  # they show what reports draws
            assert {other.split(".")[0] for other in imported} <= others.get(package, {"bench", "reports"}), module
        if package == "baselines":
            assert {other for other in imported if other.startswith("bench")} <= public, module


def test_no_function_has_more_than_eight_parameters() -> None:
    crowded = []
    for path in FILES:
        for node in (node for node in ast.walk(tree(path)) if isinstance(node, ast.FunctionDef)):
            inputs = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            if inputs[:1] in (["self"], ["cls"]):
                inputs = inputs[1:]
            # A kernel of a GPU is given what its launch passes, one by one.
            kernel = any(ast.unparse(decorator) == "triton.jit" for decorator in node.decorator_list)
            if len(inputs) > 8 and not kernel:
                crowded.append(f"{name_of(path)}: {node.name}")
    assert crowded == []
