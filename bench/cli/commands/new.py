"""start a project of your own: a codec, a metric, a reader of data, or a check in CI

`new codec NAME` writes the folder NAME-codec: a small working codec for you to change, and its `pyproject.toml`; with
--neural a neural texture and a network, with a fit in a loop of its own. After `pip install ./NAME-codec`,
`neubtf-bench list` shows it and `neubtf-bench check NAME` passes. `new metric NAME` and `new reader NAME` write the
folders NAME-metric and NAME-reader: a small working one each, with a test that passes. `new ci NAME` writes
`tracking.toml`, a suite that measures the codec, and `.github/workflows/quality.yml`, which compares each push with
`reference.jsonl`; it installs the codec from NAME-codec if that folder is here, else from the current folder. The
command never overwrites a file.

examples:
  neubtf-bench new codec my-codec
  neubtf-bench new codec my-network --neural
  neubtf-bench new metric my-metric
  neubtf-bench new reader my-format
  neubtf-bench new ci my-codec
"""

import argparse
import keyword
import re
from importlib.resources import files
from pathlib import Path
from string import Template

from bench import metrics
from bench.cli.commands import write_text
from bench.codecs.registry import codec_entries
from bench.data import readers
from bench.inputs.errors import FINE, InputError

# For each kind: the place of each file, and its template.
_FILES = {
    "codec": {"{name}-codec/{module}.py": "codec", "{name}-codec/pyproject.toml": "pyproject"},
    "neural codec": {"{name}-codec/{module}.py": "neural", "{name}-codec/pyproject.toml": "pyproject"},
    "metric": {
        "{name}-metric/{module}.py": "metric",
        "{name}-metric/test_{module}.py": "metric-test",
        "{name}-metric/pyproject.toml": "pyproject",
    },
    "reader": {
        "{name}-reader/{module}.py": "reader",
        "{name}-reader/test_{module}.py": "reader-test",
        "{name}-reader/pyproject.toml": "pyproject",
    },
    "ci": {"tracking.toml": "suite", ".github/workflows/quality.yml": "workflow"},
}
_NEXT = {
    "codec": "pip install ./{name}-codec\nneubtf-bench check {name}",
    "metric": "pip install ./{name}-metric\npytest {name}-metric\nneubtf-bench run quick --metric {entry}",
    "reader": "pip install ./{name}-reader\npytest {name}-reader\nneubtf-bench run quick --material PATH",
    "ci": "git submodule add URL-OF-THE-SUITE neubtf-bench\n"
    "neubtf-bench run tracking.toml --fresh --out runs/tracking\n"
    "neubtf-bench compare runs/tracking --update --out reference.jsonl\n"
    "neubtf-bench compare reference.jsonl runs/tracking",
}
# What the entry point of each kind names.
_PLACES = {"codec": "{module}:{class_name}", "metric": "{module}:METRIC", "reader": "{module}"}


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("what", choices=sorted(_NEXT))
    parser.add_argument("name", metavar="NAME", help="the name of the codec, metric or format, such as my-codec")
    parser.add_argument("--neural", action="store_true", help="codec: a neural texture, fitted in a loop of its own")
    parser.add_argument("--out", type=Path, default=Path(), metavar="FOLDER", help="where (default: here)")


def run(options: argparse.Namespace) -> int:
    """Write the files of a new project, and print what to do next; returns the exit code."""
    name = options.name
    what = options.what
    if not re.fullmatch("[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"new {name}: a name has small letters, digits and single hyphens, such as my-codec")
    entry = name.replace("-", "_") if what == "metric" else name  # names of metrics have underscores
    if _is_taken(what, entry):
        raise InputError(f"new {what} {name}: a {what} of this name is installed: choose another")
    if options.neural and what != "codec":
        raise InputError("--neural: only `new codec` has it")
    words = _words(what, name, entry, options.out)
    # The text of each file, with its open words. Nothing is written if one of the places is taken.
    templates = _FILES["neural codec" if options.neural else what]
    texts = {options.out / place.format(**words): _template(file) for place, file in templates.items()}
    for path in texts:
        if path.exists():
            raise InputError(f"{path}: it exists already: remove it, or choose another --out")
    class_name = words["class_name"]
    if what == "codec" and _is_in_use(class_name, "\n".join(texts.values())):
        raise InputError(f"new codec {name}: its class cannot be called {class_name}, a word in use: choose another")
    for path, text in texts.items():
        write_text(path, Template(text).substitute(words), "choose another --out")
    if what == "ci" and not (options.out / words["package"] / "pyproject.toml").exists():
        print(f"The workflow installs the codec from {words['package']}, which has no pyproject.toml yet.")
    print(f"next:\n{_NEXT[what].format(**words)}")
    return FINE


def _template(name: str) -> str:
    """The text of a template, which ships with the suite."""
    return (files("bench.cli") / "templates" / f"{name}.txt").read_text("utf-8")


def _words(what: str, name: str, entry: str, out: Path) -> dict[str, str]:
    """The words that the templates and the names of their files leave open."""
    words = {"name": name, "what": what, "entry": entry, "module": f"{name.replace('-', '_')}_{what}"}
    words["class_name"] = "".join(part.capitalize() for part in name.split("-"))
    words["group"] = f"neubtf_bench.{what}s"
    words["place"] = _PLACES.get(what, "").format(**words)
    folder = f"{name}-codec"  # where `new codec` puts the package
    words["package"] = f"./{folder}" if (out / folder / "pyproject.toml").is_file() else "."
    return words


def _is_in_use(class_name: str, text: str) -> bool:
    """Whether a name of a class is a word of Python, or a name that a text of Python imports."""
    imported = re.findall(r"^(?:from .* )?import (.*)$", text, re.MULTILINE)  # names with commas between, a line each
    return keyword.iskeyword(class_name) or class_name in ", ".join(imported).split(", ")


def _is_taken(what: str, name: str) -> bool:
    """Whether a codec, a metric or a reader of this name is installed."""
    if what == "metric":
        return metrics.find(name) is not None
    if what == "reader":
        return name in readers.listed()
    return what == "codec" and name in codec_entries()
