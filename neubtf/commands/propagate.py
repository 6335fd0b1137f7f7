"""make a new neural texture of a NeuBTF material, from any picture

The file must be one of codec neubtf that was written with keep_encoder=true. JPEG and PNG pictures (8 or 16 bits) are
decoded as sRGB, EXR and Radiance .hdr are linear; grey is repeated, alpha is left out.

examples:
  neubtf-bench propagate brick.nbtf --guidance wall.jpg -o wall.nbtf
"""

import argparse
from pathlib import Path

from bench.codec import Terminal
from bench.codecs.loading import load
from bench.inputs.errors import FINE, InputError
from bench.machine.devices import require_present
from neubtf.guidance import Treatment
from neubtf.propagation import propagate
from neubtf.renderer import Decoded
from neubtf.seam import FRONTAL, seam_of

MARGIN = 1 / 6  # of a side: about what the built-in photographs lose


def arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command to its parser."""
    parser.add_argument("file", type=Path, help="a codec file of neubtf, with its encoder")
    parser.add_argument("--guidance", type=Path, required=True, metavar="PICTURE", help="a picture of the new texture")
    help_of_scale = "factor on the picture's size, before all else: below 1, a coarser level of detail (default: 1)"
    parser.add_argument("--scale", type=float, default=1.0, help=help_of_scale)
    parser.add_argument(
        "--make-tileable",
        type=float,
        nargs="?",
        const=MARGIN,
        default=0.0,
        metavar="MARGIN",
        help="blend the borders first, so that the picture wraps around; it loses this share of each side (1/6)",
    )
    parser.add_argument(
        "--exposure",
        default="match",
        help="match: make it as bright on average as the guidance of the file (default); radiance: the picture is a "
        "slice in the units of the BTF; or a factor on linear values",
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the codec file to write")


def run(options: argparse.Namespace, terminal: Terminal) -> int:
    """Write the new file, say how visible its seams are, and return the exit code. `InputError` for wrong options."""
    if not options.out.parent.is_dir():
        raise InputError(f"{options.out}: there is no folder {options.out.parent}: make it first")
    require_present(options.device, "--device")
    treatment = Treatment(options.scale, options.make_tileable, options.exposure)
    with terminal:
        header = propagate(options.file, options.guidance, options.out, treatment, terminal.show, options.device)
    terminal.say_file(header)
    material = load(header.path).material
    assert isinstance(material, Decoded)
    left_right, top_bottom = seam_of(material, FRONTAL)
    ratios = f"left–right {left_right.of_mean:.2f}, top–bottom {top_bottom.of_mean:.2f}"
    terminal.say(f"seam (gradient across the border, relative to those inside): {ratios}")
    return FINE
