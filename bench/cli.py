"""The command line, `neubtf-bench`: the one place that prints. A command imports what it needs, when it runs.

Exit codes: 0 fine · 1 the verdict is no · 2 bad usage or input · 3 some or all jobs failed · 4 nothing was measured ·
70 internal error · 130 interrupted.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from bench.errors import InputError

TABLES = ("main", "angular", "radiance", "footprints", "rate", "unfinished")
FINE, NO, USAGE, FAILED, NOTHING, INTERNAL, INTERRUPTED = 0, 1, 2, 3, 4, 70, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    options = _parser().parse_args(argv)
    command: Callable[[argparse.Namespace], int] = options.command
    try:
        return command(options)
    except InputError as error:
        print(f"neubtf-bench: {error}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        print("\nneubtf-bench: interrupted; what is finished is recorded", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return FINE
    except Exception:
        import traceback

        traceback.print_exc()
        print("neubtf-bench: internal error: please report the lines above", file=sys.stderr)
        return INTERNAL


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="neubtf-bench",
        description="Compares neural codecs of bidirectional texture functions: real bytes, error, time per sample.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands)
    _add_files(commands)
    _add_reports(commands)
    return parser


def _add(commands: Any, name: str, command: Callable[[argparse.Namespace], int], text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(command=command)
    return parser


def _add_run(commands: Any) -> None:
    run = _add(commands, "run", _run, "run a suite: encode, write, decode, score, time, record, report")
    run.add_argument("suite", nargs="?", default="quick", help="a built-in suite or a TOML file (default: quick)")
    run.add_argument("--out", type=Path, help="the run's folder (default: runs/SUITE)")
    run.add_argument("--material", action="append", default=[], help="only this material, by name or path; repeatable")
    run.add_argument("--codec", action="append", default=[], help="only this codec; repeatable")
    run.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="codec setting, or data.KEY")
    run.add_argument("--all-pairs", action="store_true", help="use measured data whole, however many pairs it has")
    run.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    run.add_argument("--seed", type=int, help="run this one seed instead of the suite's")
    run.add_argument("--fresh", action="store_true", help="fit and score again what is already there")
    run.add_argument("--retry-failed", action="store_true", help="try jobs again that failed before")
    listing = _add(commands, "list", _list, "list codecs, materials, suites and metrics")
    listing.add_argument("what", nargs="?", choices=["codecs", "materials", "suites", "metrics"])
    check = _add(commands, "check", _check, "the conformance test of a codec, yours or ours")
    check.add_argument("codec")
    check.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting")
    cache = _add(commands, "cache", _cache, "show the cache of rendered materials and scratch files, or remove it")
    cache.add_argument("--clear", action="store_true", help="remove every cached file")


def _add_files(commands: Any) -> None:
    encode = _add(commands, "encode", _encode, "encode one BTF, all its training pairs, into a codec file")
    encode.add_argument("btf", help="a built-in material or the path of a BTF")
    encode.add_argument("--codec", required=True)
    encode.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a codec setting, or data.KEY")
    encode.add_argument("--seed", type=int, default=0)
    encode.add_argument("--threads", type=int, default=1)
    encode.add_argument("--device", default="cpu")
    encode.add_argument("-o", "--out", type=Path, required=True, help="the codec file to write")
    decode = _add(
        commands, "decode", _decode, "decode a codec file into slices: a folder of EXR pictures with pairs.csv"
    )
    decode.add_argument("file", type=Path)
    decode.add_argument("--like", help="decode the pairs of this BTF (a built-in material or a path)")
    decode.add_argument("--directions", default="ubo2003", help="else the product of this set's directions …")
    decode.add_argument("--count", type=int, default=9, help="… thinned to this many a side (default: 9)")
    decode.add_argument("--device", default="cpu")
    decode.add_argument("-o", "--out", type=Path, required=True, help="the folder to write")
    _add_makers(commands)
    info = _add(commands, "info", _info, "what a codec file or a BTF holds")
    info.add_argument("path")
    info.add_argument("--picture", type=Path, metavar="OUT.png", help="draw a BTF: directions, values, contact sheet")


def _add_makers(commands: Any) -> None:
    bake = _add(
        commands, "bake", _bake, "render a folder of PBR maps (ambientCG, Poly Haven, glTF, Substance) as a BTF"
    )
    bake.add_argument("folder", type=Path)
    bake.add_argument("--size", type=int, default=64, help="texels of the longer side (default: 64)")
    bake.add_argument("--directions", default="ubo2003", help="the published direction set (default: ubo2003) …")
    bake.add_argument("--views", type=int, default=25, help="… thinned to this many views (default: 25)")
    bake.add_argument("--lights", type=int, default=25, help="… and to this many lights (default: 25)")
    bake.add_argument("--heldout", type=int, default=150, help="random pairs besides, held out (default: 150)")
    bake.add_argument("--depth", type=float, help="white over black of the displacement, in widths of the picture")
    bake.add_argument("--seed", type=int, default=0, help="of the held-out pairs, and of Mitsuba's paths (default: 0)")
    bake.add_argument(
        "--renderer",
        default="builtin",
        choices=["builtin", "mitsuba"],
        help="builtin: direct light (default); mitsuba: path-traced with inter-reflections, resumed when killed",
    )
    bake.add_argument("-o", "--out", type=Path, required=True, help="an .npz file, or a folder of EXR pictures")
    convert = _add(commands, "convert", _convert, "write a BTF anew, cut, shrunk or thinned, as .npz or EXR pictures")
    convert.add_argument("btf", help="a built-in material or the path of a BTF")
    convert.add_argument("--thin", type=int, default=0, metavar="COUNT", help="keep about COUNT pairs, evenly in angle")
    convert.add_argument("--crop", type=_window, metavar="ROW,COL,HEIGHT,WIDTH", help="keep this window of texels")
    convert.add_argument("--downsample", type=int, default=1, metavar="FACTOR", help="average FACTOR² texels into one")
    convert.add_argument("-o", "--out", type=Path, required=True, help="an .npz file, or a folder of EXR pictures")


def _window(text: str) -> tuple[int, int, int, int]:
    row, col, height, width = (int(number) for number in text.split(","))
    return row, col, height, width


def _add_reports(commands: Any) -> None:
    table = _add(commands, "table", _table, "print a run's tables")
    table.add_argument(
        "what",
        nargs="*",
        metavar="KIND|RUN",
        help=f"one kind of table ({', '.join(TABLES)}; default: "
        "all) and the folder of a run (default: the newest under runs/)",
    )
    table.add_argument("--format", default="text", choices=["text", "markdown", "latex", "csv"])
    report = _add(commands, "report", _report, "write a run's tables and pictures again from its records")
    report.add_argument("run", type=Path, help="the folder of a run")


def _pairs(assignments: list[str]) -> dict[str, str]:
    for assignment in assignments:
        if "=" not in assignment:
            raise InputError(f"--set {assignment}: write KEY=VALUE")
    return dict(a.split("=", 1) for a in assignments)


def _run(options: argparse.Namespace) -> int:
    from bench.console import Console, job_line
    from bench.suite import load_suite, with_changes

    suite = with_changes(load_suite(options.suite), options.material, options.codec, _pairs(options.set), options.seed)
    folder = options.out or Path("runs") / suite.name
    from bench.runner import Options, run

    outcomes = []
    with Console() as console:
        settings = Options(folder, _device(options.device), options.fresh, options.retry_failed, console.show)
        for outcome in run(suite, settings):
            outcomes.append(outcome)
            console.say(job_line(outcome.record, outcome.cached))
    from reports import write_report

    written = write_report(folder)
    console.say(written.text)
    console.say(_summary(outcomes))
    console.say(f"records, files, tables and pictures: {folder}")
    return _verdict([outcome.record["status"] for outcome in outcomes])


def _summary(outcomes: list[Any]) -> str:
    cached = [outcome.cached for outcome in outcomes]
    status = [outcome.record["status"] for outcome in outcomes]
    words = [f"{len(outcomes)} jobs: {status.count('ok')} ok"]
    words += [f"{status.count(word)} {text}" for word, text in _WORDS.items() if word in status]
    if any(cached):
        words += [f"{cached.count('record')} cached whole, {cached.count('file')} scored again from cached files"]
    return "; ".join(words) + ("" if not any(cached) else " (--fresh runs them anew); timings are new")


_WORDS = {"failed": "failed (see the records; --retry-failed tries again)", "unavailable": "not available"}


def _verdict(status: list[str]) -> int:
    if "failed" in status:
        return FAILED
    return FINE if "ok" in status else NOTHING


def _device(name: str) -> str:
    import torch

    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"--device {name}: no such device; cpu or cuda") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"--device {name}: PyTorch finds no CUDA device here; use cpu")
    return name


def _list(options: argparse.Namespace) -> int:
    from bench import materials, metrics, registry, suite

    listings: dict[str, dict[str, str]] = {
        "codecs": {name: registry.describe(entry) for name, entry in sorted(registry.codec_entries().items())},
        "materials": materials.describe(),
        "suites": {name: suite.parse_suite(name, text).description for name, text in suite.builtin_suites().items()},
        "metrics": {
            m.name: f"{m.unit}, {m.direction} is better, {m.space}, version {m.version}" for m in metrics.registered()
        },
    }
    for title, entries in listings.items():
        if options.what in (None, title):
            width = max(map(len, entries))
            print(f"{title}:")
            print("\n".join(f"  {name:<{width}}  {text}" for name, text in entries.items()))
    return FINE


def _check(options: argparse.Namespace) -> int:
    from bench.check import check
    from bench.registry import load_codec

    failed = 0
    for result in check(load_codec(options.codec)(**_pairs(options.set))):
        failed += bool(result.failure)
        print(f"{'FAIL' if result.failure else 'pass'}  {result.name}" + (f": {result.failure}" * bool(result.failure)))
    print(f"{options.codec}: " + (f"{failed} checks failed" if failed else "every check passed"))
    return NO if failed else FINE


def _cache(options: argparse.Namespace) -> int:
    from bench import cache

    if options.clear:
        count, size = cache.clear()
        print(f"removed {count} files, {size / 1e6:.1f} MB, from {cache.cache_dir()}")
        return FINE
    files = [path for path in cache.cache_dir().rglob("*") if path.is_file()]
    print(f"{cache.cache_dir()}: {len(files)} files, {sum(path.stat().st_size for path in files) / 1e6:.1f} MB")
    return FINE


def _open(name: str, changes: dict[str, str], show: Any) -> Any:
    from bench.open import open_material
    from bench.suite import Suite, named, with_changes

    data = with_changes(Suite("", ""), [], [], {k: v for k, v in changes.items() if k.startswith("data.")}, None).data
    return open_material(named(name), data, show)


def _encode(options: argparse.Namespace) -> int:
    import torch

    from bench import container
    from bench.codec import Fit
    from bench.console import Console, file_lines
    from bench.registry import load_codec
    from bench.timing import torch_threads

    changes = _pairs(options.set)
    settings = {k: v for k, v in changes.items() if not k.startswith("data.")}
    codec = load_codec(options.codec)(**settings)
    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: its folder is not there: make it first")
    device = torch.device(_device(options.device))
    with Console() as console, torch_threads(options.threads):
        btf = _open(options.btf, changes, console.show)
        fit = Fit(device, options.threads, options.seed, console.show)
        header = container.save(options.out, codec, codec.encode(btf.subset(btf.split().train), fit))
    console.say(file_lines(header))
    return FINE


def _decode(options: argparse.Namespace) -> int:
    import numpy as np

    from bench import container
    from bench.btf import BTF
    from bench.console import Console
    from bench.decoded import DecodedSource
    from bench.hemisphere import DIRECTION_SETS, thin
    from bench.readers.folder import write_folder
    from bench.suggest import did_you_mean

    header, material = container.load(options.file, _device(options.device))
    with Console() as console:
        if options.like:
            like = _open(options.like, {}, console.show)
            wo, wi = like.wo, like.wi
        else:
            if options.directions not in DIRECTION_SETS:
                hint = did_you_mean(options.directions, DIRECTION_SETS)
                raise InputError(f"--directions {options.directions}: no such set{hint}")
            directions = DIRECTION_SETS[options.directions]()
            if not 1 <= options.count <= len(directions):
                raise InputError(f"--count {options.count}: must be between 1 and {len(directions)}")
            side = directions[thin(directions, options.count)]
            wo, wi = np.repeat(side, len(side), 0), np.tile(side, (len(side), 1))
        source = DecodedSource(material, wo, wi, header.sha256)
        write_folder(BTF(options.file.stem, wo, wi, source), options.out)
    console.say(f"{len(wo)} slices of {material.size[0]} × {material.size[1]} in {options.out}")
    return FINE


def _bake(options: argparse.Namespace) -> int:
    from bench.bake import bake, read_surface, recognise, table
    from bench.console import Console
    from bench.suite import Data

    data = Data(options.size, options.directions, options.views, options.lights, options.heldout)
    with Console() as console:
        surface = read_surface(recognise(options.folder), data.size, options.depth)
        console.say(f"{options.folder}:\n{table(surface)}")
        bake(
            surface,
            data,
            options.out,
            lambda done, total: console.show("baking", done, total),
            options.seed,
            options.renderer,
        )
    pairs = data.views * data.lights + data.heldout
    console.say(f"{pairs} slices of {surface.shape[0]} × {surface.shape[1]} in {options.out}")
    return FINE


def _convert(options: argparse.Namespace) -> int:
    from bench.console import Console
    from bench.convert import changed, check_place, write_btf

    check_place(options.out)
    with Console() as console:
        btf = changed(_open(options.btf, {}, console.show), options.crop, options.downsample, options.thin)
        write_btf(btf, options.out, lambda done, total: console.show("writing", done, total))
    console.say(f"{len(btf)} slices of {btf.shape[0]} × {btf.shape[1]} in {options.out}")
    return FINE


def _info(options: argparse.Namespace) -> int:
    from bench.console import btf_lines, file_lines

    path = Path(options.path)
    if path.is_file() and _is_codec_file(path):
        if options.picture:
            raise InputError(f"{path}: a codec file: decode it, and draw what it decodes to")
        from bench.container import read_header

        print(file_lines(read_header(path)))
        return FINE
    from bench.codec import silent
    from bench.portrait import draw, look

    seen = look(_open(options.path, {}, silent))
    print(btf_lines(seen))
    if options.picture:
        draw(seen, options.picture)
        print(f"wrote {options.picture}")
    return FINE


def _is_codec_file(path: Path) -> bool:
    """A safetensors file begins with its header's length and an opening brace."""
    with open(path, "rb") as file:
        start = file.read(9)
    return path.suffix == ".nbtf" or (len(start) == 9 and start[8:] == b"{" and start[4:8] == b"\0" * 4)


def _table(options: argparse.Namespace) -> int:
    kinds = [word for word in options.what if word in TABLES]
    folders = [Path(word) for word in options.what if word not in TABLES]
    if len(kinds) > 1 or len(folders) > 1:
        raise InputError("table: give one kind of table and one folder of a run at most")
    from reports import table_text

    print(table_text(folders[0] if folders else _newest_run(), options.format, kinds[0] if kinds else None))
    return FINE


def _newest_run() -> Path:
    from bench.records import FILE

    found = sorted(Path("runs").glob(f"*/{FILE}"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise InputError("table: there is no run under runs/: give the folder that `neubtf-bench run` wrote")
    return found[-1].parent


def _report(options: argparse.Namespace) -> int:
    from reports import write_report

    written = write_report(options.run)
    print(written.text)
    print("\n".join(f"wrote {path}" for path in written.files))
    return FINE


if __name__ == "__main__":
    sys.exit(main())
