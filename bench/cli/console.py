"""Terminal output of the command line: progress bars, one line per job, and the text of `info`."""

import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from textwrap import indent
from typing import TYPE_CHECKING, Any, cast

from rich.console import Console as RichConsole
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from bench.codecs.container import Header
from bench.inputs.errors import visible
from bench.metrics import stats_of
from bench.records import MOST_DB, PSNR

SILENCE = 10.0  # without a terminal, seconds between two lines of progress
PACE = 600.0  # seconds before now, of which a bar's pace is the mean: a step may take minutes

# What a number means where its name does not say it, by the names of the fields that lead to it.
_MEANINGS = {
    "slices_read": "values are of these alone",
    "exposed/code": "of 255, the mean of the median slice as displayed",
    "exposed/black": "dB, what black scores",
    "half_vectors/shares": "of the variation of brightness, which half vectors explain, by frame",
    "half_vectors/likely": "as given, if no other frame is clearly better",
    "lobe/difference_share": "of the mean lobe, which phi_i - phi_o explains",
    "lobe/sum_share": "which phi_i + phi_o explains; it does if one side is mirrored",
    "lobe/peak_deg": "of phi_i - phi_o, where the lobe is brightest; 180 is the mirror direction",
    "material/layers": "of the decoder, with trainable parameters, counted by torchinfo",
    "scene/window": "first row, first column, height, width in texels",
    "scene/factor": "texels along a box",
    "scene/uniform": "share of samples spread evenly",
    "trained_on": "materials; this file holds no material, but the network that the codec shares over them",
}

if TYPE_CHECKING:
    from bench.runs.job import Outcome


class _Output(RichConsole):
    """Where bars and lines go. If nobody reads it any more, that is an error, as it is for `print`."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


class Console:
    """Progress bars that vanish when done, and lines that stay; without a terminal, a line of progress now and then."""

    def __init__(self) -> None:
        """No bar is shown yet; without a terminal there are none at all."""
        self.out = _Output(highlight=False)
        self.bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(compact=True),
            console=self.out,
            transient=True,
            disable=not self.out.is_terminal,
            speed_estimate_period=PACE,
        )
        self.tasks: dict[str, TaskID] = {}
        self.passes: Counter[str] = Counter()  # by bar: how often it began
        self.tenths: dict[str, int] = {}  # by bar: the last tenth of its pass that was printed, without a terminal
        self.spoke = time.monotonic()

    def __enter__(self) -> "Console":
        self.bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.bars.stop()

    def show(self, label: str, done: int, total: int) -> None:
        """Move the progress bar of that label, and remove it when it is full.

        Without a terminal a line is printed after some silence, at most one for each tenth of a pass. A bar that was
        full begins another pass, which the line names: data may be read several times. A label may end with a remark
        that changes, such as "wool/neumip: fitting · 28.1 dB"; what stands before it names the bar.
        """
        label = visible(label)
        from bench.codec import REMARK  # here, since `list` and `compare` start without PyTorch

        bar, _, _ = label.partition(REMARK)
        if bar not in self.tasks:
            self.tasks[bar] = self.bars.add_task(label, total=total, completed=done)
            self.passes[bar] += 1
            self.tenths[bar] = -1  # none yet
        task = self.tasks[bar]
        self.bars.update(task, description=label, completed=done, total=total)
        tenth = 10 * done // max(total, 1)
        if not self.out.is_terminal and tenth > self.tenths[bar] and time.monotonic() - self.spoke >= SILENCE:
            which = f" (pass {self.passes[bar]})" if self.passes[bar] > 1 else ""
            print(f"{label}{which}: {done} of {total}", file=sys.stderr, flush=True)
            self.tenths[bar] = tenth
            self.spoke = time.monotonic()
        if done >= total:
            self.bars.remove_task(self.tasks.pop(bar))

    def say(self, text: str) -> None:
        """Print lines above the bars, without control characters."""
        self.spoke = time.monotonic()
        lines = [visible(line) for line in text.split("\n")]
        self.out.print("\n".join(lines), markup=False, soft_wrap=True)

    def say_file(self, header: Header) -> None:
        """Print what a codec file is: its codec, settings, bytes and cost."""
        self.say(fields_text(file_fields(header)))

    def ended(self, outcome: "Outcome") -> None:
        """Print a finished job in one line, with the progress of the run if no bar shows it."""
        record = outcome.record
        if record["status"] == "ok":
            psnr = cast(float, stats_of(record, PSNR)["mean"])
            quality = "exact" if psnr >= MOST_DB else f"{psnr:.2f} dB"
            reused = {"record": "cached", "file": "scored again from the cached file"}.get(outcome.cached)
            how = reused or f"fitted in {record['fit_seconds']:.1f} processor s"
            line = f"{record['job']}: {quality}, {record['bytes']['total']:,} bytes, {how}"
        else:
            word = "not available" if record["status"] == "unavailable" else "FAILED"
            line = f"{record['job']}: {word}: {record['error']}"
        line = visible(line)  # a name or an error may have line breaks
        if outcome.progress and not self.out.is_terminal:
            line += f" ({outcome.progress})"
        self.say(line)


def file_fields(header: Header) -> dict[str, Any]:
    """Codec, settings, bytes by part and tensors of a codec file, with its `material` and the cost of its decoder, or
    the number of materials that a shared network was `trained_on`."""
    from bench.codecs.container import SHARED
    from bench.codecs.shared import read

    fields: dict[str, Any] = {
        "path": str(header.path),
        "codec": header.codec,
        "version": header.version,
        "settings": header.settings,
        "bytes": {"total": header.file_bytes} | header.part_bytes(),
    }
    if header.kind == SHARED:
        fields["trained_on"] = len(read(header.path).origins)
    else:
        fields["material"] = _material_fields(header)
    if header.scene:
        fields["scene"] = header.scene
    tensors = {}
    for name, (dtype, shape, size) in sorted(header.tensors.items()):
        tensors[name] = {"dtype": dtype, "shape": shape, "bytes": size}
    return fields | {"provenance": header.provenance, "tensors": tensors, "sha256": header.sha256}


def _material_fields(header: Header) -> dict[str, Any]:
    """The resolution of the material that a codec file decodes to, the cost and the layers of its decoder, and the
    shared network that it needs, if any."""
    from bench.codecs.loading import load
    from bench.material import layers, parameters

    _, material, network = load(header.path)
    fields: dict[str, Any] = {
        "size": material.size,
        "parameters": None if material.opaque else parameters(material),  # a program does not tell them
        "texture_channels": material.cost.texture_channels,
        "flops_per_sample": material.cost.flops_per_sample,
        "bytes_per_sample": material.cost.bytes_per_sample,
        "layers": [{"name": name, "kind": kind, "parameters": count} for name, kind, count in layers(material)],
    }
    if material.opaque:
        fields["decoder"] = "another program, which does not tell its parameters and its cost"
    if network:
        fields["network"] = {"path": str(network.path), "bytes": network.file_bytes, "sha256": network.sha256}
    return fields


def fields_text(fields: Mapping[str, Any], within: str = "") -> str:
    """Fields as lines such as "pairs: 6,561", without control characters.

    Nested fields are indented, records of the same fields are a table, and of sentences each has a line. `within` is
    the name of the field that holds these, with a slash: "lobe/".
    """
    lines = []
    for name, value in fields.items():
        title = visible(name)
        if within + name in _MEANINGS:
            title += f" ({_MEANINGS[within + name]})"
        records = _records(value)
        if records:
            block = _table(records)
        elif value and isinstance(value, Mapping):
            block = fields_text(value, f"{within}{name}/")
        elif value and name in ("notes", "warnings"):
            block = "\n".join(map(visible, value))
        else:
            lines.append(f"{title}: {_in_words(name, value)}")
            continue
        lines += [f"{title}:", indent(block, "  ")]
    return "\n".join(lines)


def _records(value: Any) -> list[dict[str, Any]]:
    """The records of a field that is a list of them, or has them by name, which becomes their first field; none if the
    field holds something else, or records of different fields."""
    entries = list(value.values()) if isinstance(value, Mapping) else value
    if not isinstance(entries, list) or not all(isinstance(each, Mapping) for each in entries):
        return []
    if any(each.keys() != entries[0].keys() for each in entries):
        return []
    if isinstance(value, Mapping):
        return [{"name": name, **each} for name, each in value.items()]
    return entries


def _table(records: Sequence[Mapping[str, Any]]) -> str:
    """Records of the same fields as a table with a line for each, numbers to the right."""
    columns = []
    for name, first in records[0].items():
        cells = [visible(name), *(_in_words(name, record[name]) for record in records)]
        width = max(map(len, cells))
        side = ">" if isinstance(first, int | float) else "<"
        columns.append([f"{cell:{side}{width}}" for cell in cells])
    return "\n".join("  ".join(line).rstrip() for line in zip(*columns, strict=True))


def _in_words(name: str, value: Any) -> str:
    """The value of a field on one line; sides, in texels or of a tensor, stand as "64 × 64"."""
    if value is None or value in ([], (), {}):
        return "none"
    if isinstance(value, list | tuple):
        between = " × " if name in ("shape", "size") else ", "
        return between.join(_in_words("", each) for each in value)
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return f"{value:.4g}" if isinstance(value, float) else visible(str(value))
