"""Terminal output of the command line: progress bars, one line per job, and the text of `info`."""

import sys
import time
from collections import Counter
from typing import TYPE_CHECKING, Any, cast

from rich.console import Console as RichConsole
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from bench.codecs.container import Header
from bench.inputs.errors import visible
from bench.metrics import stats_of
from bench.records import MOST_DB, PSNR

SILENCE = 10.0  # without a terminal, seconds between two lines of progress
PACE = 600.0  # seconds before now, of which a bar's pace is the mean: a step may take minutes

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
        self.say(file_lines(file_fields(header)))

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
    if network:
        fields["network"] = {"path": str(network.path), "bytes": network.file_bytes, "sha256": network.sha256}
    return fields


def file_lines(file: dict[str, Any]) -> str:
    """Describe a codec file by its `file_fields`."""
    settings = ", ".join(f"{key} = {value}" for key, value in file["settings"].items())
    sizes = ", ".join(f"{part} {size:,}" for part, size in file["bytes"].items() if part != "total")
    lines = [
        f"{file['path']}: codec {file['codec']}, version {file['version']}, {file['bytes']['total']:,} bytes",
        f"settings: {settings or 'none'}",
        f"bytes: {sizes}",
    ]
    if "material" in file:
        lines += _material_lines(file["material"])
    else:
        lines.append("this file holds no material, but the network that the codec shares over materials")
        lines.append(f"trained on: {file['trained_on']} materials")
    if "scene" in file:
        lines.append(_scene_line(file["scene"]))
    lines += [f"provenance: {key} = {value}" for key, value in file["provenance"].items()]
    for name, tensor in file["tensors"].items():
        form = " × ".join(map(str, tensor["shape"])) or "scalar"
        lines.append(f"  {name}  {tensor['dtype']} {form}  {tensor['bytes']:,} bytes")
    lines.append(f"sha256 of its content: {file['sha256']}")
    return "\n".join(visible(line) for line in lines)


def _scene_line(scene: dict[str, Any]) -> str:
    """Describe the scene that a codec file was fitted to, by the facts in its header."""
    top, left, height, width = scene["window"]
    across = scene["factor"]
    sides = " × ".join(map(str, scene["size"]))
    return (
        f"fitted to the scene {scene['name']}, demand {scene['demand'][:12]}: {height} × {width} texels of {sides} "
        f"from row {top}, column {left}, in boxes of {across} × {across}; {scene['pairs']:,} pairs; "
        f"{scene['uniform']:.0%} of samples spread evenly"
    )


def _material_lines(material: dict[str, Any]) -> list[str]:
    """Describe the material that a codec file decodes to, with the layers of its decoder if there are any."""
    lines = [f"resolution: {material['size'][0]} × {material['size'][1]} texels"]
    if material["parameters"] is None:
        lines.append("decoder: another program, which does not tell its parameters and its cost")
    else:
        lines.append(
            f"decoder: {material['parameters']:,} parameters, {material['texture_channels']} texture channels, "
            f"{material['flops_per_sample']:,} FLOP and {material['bytes_per_sample']:,} bytes read a sample"
        )
    rows = [(layer["name"], layer["kind"], f"{layer['parameters']:,}") for layer in material["layers"]]
    if rows:
        lines.append("layers of the decoder and their trainable parameters, counted by torchinfo:")
        name_width = max(len(name) for name, _, _ in rows)
        kind_width = max(len(kind) for _, kind, _ in rows)
        count_width = max(len(count) for _, _, count in rows)
        for name, kind, count in rows:
            lines.append(f"  {name:<{name_width}}  {kind:<{kind_width}}  {count:>{count_width}}")
    network = material.get("network")
    if network:
        lines.append(f"shared network: {network['path']}, {network['bytes']:,} bytes, sha256 {network['sha256']}")
    return lines


def btf_lines(btf: dict[str, Any]) -> str:
    """Describe a BTF by its `bench.data.described.btf_fields`."""
    repeats = "periodic" if btf["periodic"] else "not periodic"
    lines = [
        f"{btf['name']}: {btf['shape'][0]} × {btf['shape'][1]} texels, {btf['pairs']:,} pairs, {repeats}",
        f"training: {_pairs_line(btf['training'])}",
    ]
    for name, pairs in btf["heldout"].items():
        title = "held out" if name == "heldout" else f"held out, {name}"
        lines.append(f"{title}: {_pairs_line(pairs)}")
    if not btf["heldout"]:
        lines.append("held out: no pairs")
    if btf["low_light"]["pairs"]:
        lines.append(f"low light: {_pairs_line(btf['low_light'])}")
    slices_read = "of all slices"
    if btf["slices_read"] < btf["pairs"]:
        slices_read = f"of {btf['slices_read']:,} of {btf['pairs']:,} slices; others may hold more, or NaN"
    values = ", ".join(f"{name} {value:.4g}" for name, value in btf["values"].items())
    lines.append(f"values ({slices_read}): {values}")
    exposed = btf["exposed"]
    shown = f"the median slice has a mean display code of {exposed['code']:.0f} of 255"
    lines.append(f"exposure: {exposed['exposure']:.4g}; {shown}, and black scores {exposed['black']:.1f} dB")
    lines += _frame_lines(btf)
    lines.append(f"fingerprint: {btf['fingerprint']}")
    for key, value in btf["provenance"].items():
        words = value
        if isinstance(value, dict):
            words = ", ".join(f"{name} = {entry}" for name, entry in value.items())
        lines.append(f"  {key}: {words}")
    lines += [f"warning: {text}" for text in btf["warnings"]]
    return "\n".join(visible(line) for line in lines)


def _frame_lines(btf: dict[str, Any]) -> list[str]:
    """Say whether the azimuths of views and lights seem to be right, or why that is not known.

    Around the normal, a surface reflects most toward the mirror direction, 180° away from the light. So its mean lobe,
    the mean radiance over texels by azimuth, should follow the difference φ_i − φ_o. If it follows the sum instead, the
    azimuths of views or of lights are mirrored.
    """
    if btf["views"] < 2:
        return ["one view: a codec's answers from other views are not measured"]
    half_vectors = btf["half_vectors"]
    if half_vectors:
        shares = [f"{share:.0%} {frame}" for frame, share in half_vectors["shares"].items()]
        none_better = "" if half_vectors["likely"] != "as given" else ": no other frame is clearly better"
        return [f"frame: half vectors of {half_vectors['count']} pairs explain {', '.join(shares)}{none_better}"]
    lobe = btf["lobe"]
    if not lobe:
        from bench.data.half_vectors import LEAST_PAIRS

        return [
            "frame: not checked: views and lights share no ring of azimuths with all pairs, or all is dark there, and "
            f"fewer than {LEAST_PAIRS} training pairs are lit"
        ]
    explained = f"{lobe['difference_share']:.0%} of the mean lobe at theta {lobe['theta_deg']:.0f}°"
    return [
        f"frame: phi_i - phi_o explains {explained}, most at {lobe['peak_deg']:.0f}° (180°: mirror direction); "
        f"phi_i + phi_o (if one side is mirrored) {lobe['sum_share']:.0%}"
    ]


def _pairs_line(pairs: dict[str, Any]) -> str:
    """Describe some pairs of a BTF by their fields in `bench.data.described`."""
    if not pairs["pairs"]:
        return "no pairs"
    line = f"{pairs['pairs']:,} pairs"
    for word in ("view", "light"):
        count = pairs[f"{word}s"]
        plural = "" if count == 1 else "s"
        line += f", {count:,} {word}{plural} up to {pairs[f'{word}_theta_deg']:.1f}°"
    return f"{line} (their product)" if pairs["product"] else line
