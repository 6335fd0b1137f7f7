"""Terminal output of the command line: progress bars, one line per job, and the text of `info`."""

import sys
import time
from collections import Counter
from typing import TYPE_CHECKING, cast

import numpy as np
from rich.console import Console as RichConsole
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from bench.codecs.container import Header
from bench.inputs.errors import visible
from bench.metrics import stats_of
from bench.records import MOST_DB, PSNR

SILENCE = 10.0  # without a terminal, seconds between two lines of progress

if TYPE_CHECKING:
    from bench.btf import BTF
    from bench.data.portrait import Look
    from bench.runs.job import Outcome


class _TimeLeft(ProgressColumn):
    """The time left at the mean pace so far; empty before the first step, and if the remark already says it."""

    def render(self, task: Task) -> Text:
        """`MINUTES:SECONDS left`. `Console.show` gives the task its fields: `start_at`, the steps done at first, and
        `moved_at`, when the latest ended."""
        steps = task.completed - task.fields["start_at"]
        if task.description.endswith(" left") or steps <= 0 or task.elapsed is None or task.total is None:
            return Text("")
        idle = time.monotonic() - task.fields["moved_at"]  # seconds since the last step ended
        pace = (task.elapsed - idle) / steps  # seconds a step
        remaining = task.total - task.completed  # steps, with the one that runs now
        # The running step may take longer than those before; never show less than the steps after it need.
        seconds_left = max(pace * remaining - idle, pace * (remaining - 1))
        minutes, seconds = divmod(round(seconds_left), 60)
        return Text(f"{minutes}:{seconds:02} left")


class Console:
    """Progress bars that vanish when done, and lines that stay; without a terminal, a line of progress now and then."""

    def __init__(self) -> None:
        """No bar is shown yet; without a terminal there are none at all."""
        self.out = RichConsole(highlight=False)
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _TimeLeft())
        self.bars = Progress(*columns, console=self.out, transient=True, disable=not self.out.is_terminal)
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
            self.tasks[bar] = self.bars.add_task(label, total=total, start_at=done)
            self.passes[bar] += 1
            self.tenths[bar] = -1  # none yet
        task = self.tasks[bar]
        self.bars.update(task, description=label, completed=done, total=total, moved_at=time.monotonic())
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
        self.say(file_lines(header))

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


def file_lines(header: Header) -> str:
    """Describe a codec file: codec, settings, parts with bytes, tensors, and the cost of its decoder."""
    from bench.codecs.container import SHARED
    from bench.codecs.shared import read

    settings = ", ".join(f"{key} = {value}" for key, value in header.settings.items())
    sizes = ", ".join(f"{part} {size:,}" for part, size in header.part_bytes().items())
    lines = [
        f"{header.path}: codec {header.codec}, version {header.version}, {header.file_bytes:,} bytes",
        f"settings: {settings or 'none'}",
        f"bytes: {sizes}",
    ]
    if header.kind == SHARED:
        lines.append("this file holds no material, but the network that the codec shares over materials")
        lines.append(f"trained on: {len(read(header.path).origins)} materials")
    else:
        lines += _material_lines(header)
    scene = header.scene
    if scene:
        top, left, height, width = scene["window"]
        across = scene["factor"]
        sides = " × ".join(map(str, scene["size"]))
        lines.append(
            f"fitted to the scene {scene['name']}, demand {scene['demand'][:12]}: {height} × {width} texels of {sides} "
            f"from row {top}, column {left}, in boxes of {across} × {across}; {scene['pairs']:,} pairs; "
            f"{scene['uniform']:.0%} of samples spread evenly"
        )
    lines += [f"provenance: {key} = {value}" for key, value in header.provenance.items()]
    for name, (dtype, shape, size) in sorted(header.tensors.items()):
        form = " × ".join(map(str, shape)) or "scalar"
        lines.append(f"  {name}  {dtype} {form}  {size:,} bytes")
    lines.append(f"sha256: {header.sha256}")
    return "\n".join(visible(line) for line in lines)


def _material_lines(header: Header) -> list[str]:
    """Describe the material that a codec file decodes to, with the layers of its decoder if there are any."""
    from bench.codecs.loading import load
    from bench.material import layers, parameters

    _, material, network = load(header.path)
    lines = [
        f"resolution: {material.size[0]} × {material.size[1]} texels",
        f"decoder: {parameters(material):,} parameters, {material.cost.texture_channels} texture channels, "
        f"{material.cost.flops_per_sample:,} FLOP and {material.cost.bytes_per_sample:,} bytes read a sample",
    ]
    rows = [(name, kind, f"{count:,}") for name, kind, count in layers(material)]
    if rows:
        lines.append("layers of the decoder and their trainable parameters, counted by torchinfo:")
        name_width, kind_width, count_width = (max(map(len, column)) for column in zip(*rows, strict=True))
        for name, kind, count in rows:
            lines.append(f"  {name:<{name_width}}  {kind:<{kind_width}}  {count:>{count_width}}")
    if network:
        lines.append(f"shared network: {network.path}, {network.file_bytes:,} bytes, sha256 {network.sha256}")
    return lines


def btf_lines(portrait: "Look") -> str:
    """Describe a BTF: size, directions, split, range of values, its reader's notes, and warnings."""
    btf = portrait.btf
    values = portrait.values
    split = btf.split()
    repeats = "periodic" if btf.periodic else "not periodic"
    lines = [
        f"{btf.name}: {btf.shape[0]} × {btf.shape[1]} texels, {len(btf):,} pairs, {repeats}",
        f"training: {_pairs_line(btf, split.train)}",
    ]
    for name, pairs in split.heldout.items():
        title = "held out" if name == "heldout" else f"held out, {name}"
        lines.append(f"{title}: {_pairs_line(btf, pairs)}")
    if not split.heldout:
        lines.append("held out: no pairs")
    low, high = portrait.extremes
    of_which = "of all slices"
    if portrait.read < len(btf):
        of_which = f"of {portrait.read:,} of {len(btf):,} slices; others may hold more, or NaN"
    lines.append(f"values ({of_which}): minimum {low:.4g}, median {np.median(values):.4g}, maximum {high:.4g}")
    lines += _frame_lines(portrait)
    lines.append(f"fingerprint: {btf.fingerprint}")
    for key, value in btf.provenance.items():
        words = value
        if isinstance(value, dict):
            words = ", ".join(f"{name} = {entry}" for name, entry in value.items())
        lines.append(f"  {key}: {words}")
    lines += [f"warning: {text}" for text in portrait.warnings()]
    return "\n".join(visible(line) for line in lines)


def _frame_lines(portrait: "Look") -> list[str]:
    """Say whether the azimuths of views and lights seem to be right, or why that is not known.

    Around the normal, a surface reflects most toward the mirror direction, 180° away from the light. So its mean lobe,
    the mean radiance over texels by azimuth, should follow the difference φ_i − φ_o. If it follows the sum instead, the
    azimuths of views or of lights are mirrored.
    """
    if len(portrait.layout.views) < 2:
        return ["one view: a codec's answers from other views are not measured"]
    if portrait.half_vectors:
        shares = [f"{share:.0%} {frame}" for frame, share in portrait.half_vectors.shares.items()]
        return [f"frame: half vectors of {portrait.half_vectors.count} pairs explain {', '.join(shares)}"]
    if not portrait.lobe:
        return ["frame: not checked: views and lights share no ring of azimuths with all pairs, or all is dark there"]
    lobe = portrait.lobe
    return [
        f"frame: phi_i - phi_o explains {lobe.difference_share:.0%} of the mean lobe at theta {lobe.theta_deg:.0f}°, "
        f"most at {lobe.peak_deg:.0f}° (180°: mirror direction); phi_i + phi_o (if one side is mirrored) "
        f"{lobe.sum_share:.0%}"
    ]


def _pairs_line(btf: "BTF", pairs: np.ndarray) -> str:
    """Describe some pairs of a BTF: their number and directions."""
    from bench.btf import Layout
    from bench.directions.hemisphere import to_degrees

    if not len(pairs):
        return "no pairs"

    def in_words(directions: np.ndarray, word: str) -> str:
        """The number of some directions, and the largest angle from the normal."""
        theta, _ = to_degrees(directions)
        plural = "" if len(directions) == 1 else "s"
        return f"{len(directions):,} {word}{plural} up to {theta.max():.1f}°"

    layout = Layout.of(btf.wo[pairs], btf.wi[pairs])
    line = f"{len(pairs):,} pairs, {in_words(layout.views, 'view')}, {in_words(layout.lights, 'light')}"
    return line if layout.grid is None else f"{line} (their product)"
