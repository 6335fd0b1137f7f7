"""Fits a codec and writes its file: the one way for a run, a command, a script, a search for a scene, and the checks.

A codec's `encode` may be anyone's code. So its threads are limited, what it changes of the process can be restored, and
what it does wrong can be turned into one error that names it.
"""

import inspect
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import NamedTuple

import torch

from bench.btf import BTF
from bench.codec import Codec, Fit, Parts, Progress, TrainedNetwork, silent
from bench.codecs import container, shared
from bench.codecs.seeds import seed_of
from bench.inputs.errors import CodecError, ContainerError, EncodeError, InputError, said_by, shown, unwritable
from bench.machine.process_state import restored_process_state
from bench.machine.threads import processor_seconds, torch_threads

Encode = Callable[[BTF, Fit], Parts]  # a codec's own `encode`, or another that makes the parts of its file
_STANDARD_LIBRARY = sysconfig.get_path("stdlib")


class Fitted(NamedTuple):
    """The tensors that a fit made, and its processor time in s."""

    parts: Parts
    seconds: float


class FittedFile(NamedTuple):
    """The header of the file that a fit wrote, and the processor time of the fit in s."""

    header: container.Header
    seconds: float


def new_fit(
    codec: Codec,
    btf: BTF,
    repetition: int,
    network: TrainedNetwork | None,
    *,
    device: str = "cpu",
    threads: int = 1,
    show: Progress = silent,
    checkpoint: Path | None = None,
) -> Fit:
    """The context of one fit of a codec to a BTF; its seed follows from both names and the repetition.

    `network` is the one that the codec shares over materials; None if it shares none. `InputError` if it was trained on
    this material.
    """
    shared.refuse_training_material(network, btf)
    seed = seed_of(btf.name, codec.name, repetition)
    return Fit(torch.device(device), threads, seed, show, checkpoint, network=network)


def fit_codec(codec: Codec, btf: BTF, fit: Fit, encode: Encode | None = None) -> Fitted:
    """Fit a codec to all pairs of a BTF on the threads of `fit`, by its own `encode` or by another.

    It raises what the codec raises, and what the codec changes of the process stays changed, except for the number of
    threads. The time of a fit that was resumed includes the time before its interruption.
    """
    with torch_threads(fit.threads):
        start = processor_seconds()
        parts = (encode or codec.encode)(btf, fit)
        seconds = processor_seconds() - start
    if isinstance(parts, Parts):  # what is none is refused when it is written
        lowest = max(0.0, float(btf.wi[:, 2].min()))  # data may have lights below the horizon
        parts = replace(parts, lowest_light=round(lowest, 4))
    if fit.history:  # the fit's own clock, which continues when an interrupted fit is resumed
        seconds = max(seconds, fit.history[-1].get("seconds", 0.0))
    return Fitted(parts, seconds)


def fit_to_file(codec: Codec, btf: BTF, fit: Fit, path: Path, encode: Encode | None = None) -> FittedFile:
    """Fit a codec as `fit_codec` does, restore the state of the process, and write the codec file to `path`.

    `EncodeError` if no file can hold the parts. An error of the codec is raised as it is: see `naming_faults`.
    """
    place = path.absolute()  # a codec may remove the working directory
    with restored_process_state():
        parts, seconds = fit_codec(codec, btf, fit, encode)
    return FittedFile(container.save(place, codec, parts), seconds)


def naming_faults(codec: Codec, encode: Encode | None = None) -> Encode:
    """The codec's own `encode` or another, which raises one error that names codec, BTF and line.

    `EncodeError` if the codec raises an error or tries to end the process. An `InputError`, an interruption, and an
    `OSError` of a place that cannot be written or used (`unwritable`) are raised as they are.
    """

    def encode_naming_faults(btf: BTF, fit: Fit) -> Parts:
        """Make the parts of a file as the codec does, or raise the error that names it."""
        try:
            return (encode or codec.encode)(btf, fit)
        except (InputError, KeyboardInterrupt):
            raise
        except BaseException as error:  # also `sys.exit` and a cancelled task of asyncio
            if isinstance(error, OSError) and unwritable(error):  # a full disk is not its fault
                raise
            what = error_in_words(error, codec)
            raise EncodeError(f"codec {codec.name} failed to encode {btf.name}: {what}") from error

    return encode_naming_faults


def error_in_words(error: BaseException, codec: Codec) -> str:
    """An error that a codec raised, in one line, with the last line of its author's own files in the trace."""
    # The file was written just now, so it is not damaged: what the decoder raised counts.
    raised = error.__cause__ if isinstance(error, ContainerError) and error.__cause__ else error
    if isinstance(raised, CodecError):
        return str(raised)  # names the author's line itself
    what = _exit_in_words(raised) if isinstance(raised, SystemExit) else said_by(raised)
    # PyTorch's error where a product mixes the two dtypes: networks and tables have the material's, queries do not.
    if "Half" in what and "float" in what.lower():
        what += ": queries are at least float32; convert what meets them by .to(wi.dtype)"
    frames = list(own_frames(raised, codec))
    if frames:
        frame, line = frames[-1]  # the innermost
        what += f" ({frame.f_code.co_filename}:{line})"
    return what


def _exit_in_words(error: SystemExit) -> str:
    """That a codec ends the process, in one line, with what it gave to `sys.exit`: a number, a message, or nothing."""
    code = 0 if error.code is None else error.code
    how = f"exit code {code}" if isinstance(code, int) else f"the message {shown(code)}"
    return f"it ends the process with {how}: raise an error instead"


def own_frames(error: BaseException, codec: Codec) -> Iterator[tuple[FrameType, int]]:
    """The frames of a codec's own package in the trace of an error, each with its line, the innermost last.

    A virtual environment often lies beside a codec: what is installed there is not its author's.
    """
    try:
        folder_of_codec = Path(inspect.getfile(type(codec))).parent
    except (TypeError, OSError):  # a class typed into a shell has no file
        return
    folder_of_suite = Path(__file__).parents[1]  # `bench`
    for frame, line in traceback.walk_tb(error.__traceback__):
        file = Path(frame.f_code.co_filename)
        if not file.is_relative_to(folder_of_codec) or file.is_relative_to(folder_of_suite):
            continue
        installed = {"site-packages", "dist-packages"} & {*file.relative_to(folder_of_codec).parts}
        if not installed and not file.is_relative_to(_STANDARD_LIBRARY):
            yield frame, line
