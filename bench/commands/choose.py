"""pick the codec and settings that meet a wish for quality, bytes or time"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from bench.arguments import usable_device
from bench.commands import trade
from bench.errors import InputError
from bench.exits import FAILED, FINE, NO

if TYPE_CHECKING:
    from bench.choose import Choice


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("material", help="a built-in material or the path of a BTF")
    parser.add_argument("--min-psnr", type=float, metavar="DB", help="the held-out PSNR to reach")
    parser.add_argument("--max-bytes", metavar="BYTES", help="what the file may take: 300k, 1.5M, 20000")
    parser.add_argument("--max-ns", type=float, metavar="NS", help="what a sample may take, as a whole query")
    parser.add_argument("--out", type=Path, help="the folder of a `trade` (default: runs/trade), extended if need be")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")


def run(options: argparse.Namespace) -> int:
    from bench.choose import Wishes, choose, described, nearest, parse_bytes
    from bench.suite import named

    size = None if options.max_bytes is None else parse_bytes(options.max_bytes)
    wishes = Wishes(options.min_psnr, size, options.max_ns)
    if wishes == Wishes():
        raise InputError("choose: give a wish: --min-psnr, --max-bytes or --max-ns")
    folder, material = options.out or Path("runs") / trade.SUITE, named(options.material).name
    rows = _measured(folder, material, options.device) or _measure(folder, options)
    if not rows:
        print(f"{material}: nothing could be measured; the reasons are in {folder}")
        return FAILED
    best = choose(rows, wishes)
    if best is None:
        print(f"{material}: no setting meets that; the nearest is {described(nearest(rows, wishes))}")
        return NO
    settings = "".join(f" --set {key}={value}" for key, value in best["settings"].items())
    print(f"{material}: {described(best)}")
    print(f"neubtf-bench encode {options.material} --codec {best['codec']}{settings} -o {material}.nbtf")
    return FINE


def _measured(folder: Path, material: str, device: str) -> list["Choice"]:
    """The choices of a material that an earlier trade measured on a device."""
    from bench.choose import usable
    from bench.records import load_trade

    found = load_trade(folder) or {"choices": []}
    return [row for row in usable(found["choices"], material) if row["device"] == device]


def _measure(folder: Path, options: argparse.Namespace) -> list["Choice"]:
    """The same, after a trade over that material."""
    from bench.console import Console
    from bench.suite import load_suite, named, with_changes

    suite = with_changes(load_suite(trade.SUITE), [options.material], [], {}, None)
    material = named(options.material).name
    with Console() as console:
        console.say(f"{material} on {options.device} is not in {folder}: its settings are fitted and measured first")
        trade.measure(suite, folder, usable_device(options.device), console)
    return _measured(folder, material, options.device)
