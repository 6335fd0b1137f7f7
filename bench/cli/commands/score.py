"""score a codec file, or a folder of decoded slices, against its BTF

The file may come from `neubtf-bench encode`, from a run, or from elsewhere. A folder holds slices that any program
decoded, one for each pair of the BTF, and `pairs.csv`, as `neubtf-bench decode` and `convert` write them. BTF is the
encoded material, built-in or a path, with the same `--set data.KEY=VALUE`. A run records the same numbers. All pairs
are scored: `--set data.pairs=500` keeps about so many of a measurement, `data.heldout=20` draws fewer test pairs.

examples:
  neubtf-bench score satin.nbtf satin
  neubtf-bench score slices satin
  neubtf-bench score small.nbtf satin --set data.size=32 --json small.json
  neubtf-bench score satin.nbtf satin --set data.seed=1      # at another draw of test pairs
"""

import argparse
from dataclasses import replace
from pathlib import Path

from bench.cli.commands import assignments, json_option, json_writer, read_as, reading_options, threads, usable_device
from bench.cli.commands._scene import demand_file, scene_options
from bench.cli.console import Console
from bench.codecs.container import read_header
from bench.data.open import open_named
from bench.inputs.errors import FINE, InputError
from bench.records import Job
from bench.runs.library import score
from bench.runs.suite import CodecSpec, changed_settings
from reports import score_text


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("file", metavar="FILE|FOLDER", type=Path, help="the codec file, or the folder of slices")
    parser.add_argument("btf", metavar="BTF", help="the encoded BTF: a built-in material or a path")
    parser.add_argument("--set", action="append", default=[], metavar="data.KEY=VALUE", help="how the BTF is prepared")
    reading_options(parser)
    scene_options(parser, "score in a scene too, whose queries are written beside FILE")
    parser.add_argument("--threads", type=threads, default=1, help="CPU threads of the decoder (default: 1)")
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    json_option(parser)


def run(options: argparse.Namespace) -> int:
    """Print the scores of a codec file, or of decoded slices, against a BTF; returns the exit code."""
    changes = assignments(options.set)
    for key in changes:
        if not key.startswith("data."):
            raise InputError(f"--set {key}: the file has its codec's settings already; only data.KEY can be set here")
    changes |= read_as(options)
    write_json = json_writer(options.json)
    if not options.file.is_dir():
        read_header(options.file)  # report a wrong file before anything is rendered
    with Console() as console:
        demand = demand_file(options, options.file.parent, console)
        btf = open_named(options.btf, changes, console.show)
        place = {"threads": options.threads, "device": usable_device(options.device)}
        scores = score(options.file, btf, demand=demand, show=console.show, **place)
    spec = CodecSpec(scores["codec"], scores["settings"])
    label = spec.label
    if spec.settings:  # as a run writes it: only the settings that differ from the codec's defaults
        label = replace(spec, settings=changed_settings(spec)).label
    job: Job = {
        "kind": "job",
        "job": str(options.file),
        "material": btf.name,
        "label": label,
        "status": "ok",
        "run": "",
    }
    print(score_text(job | scores))
    write_json(scores)
    return FINE
