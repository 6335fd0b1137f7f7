"""The codec `command`: any programs behind the interface, for codecs that cannot become a Python package.

A suite names two programs. `encode` reads the training pairs from `{btf}`, an uncompressed `.npz` (docs/datasets.md),
and writes any files into the folder `{files}`; these bytes are stored in the codec file and counted. `decode` is
started once with a folder `{files}` of the same content. Each line of its input names two files, with a tab between:
queries, a float32 `.npy` (n, 9) of u, v, ω_o, ω_i and footprint (see `bench.btf`), and answers. It writes the answers,
a float32 `.npy` (n, 3) of linear RGB, to the second file, and prints a line. It ends when its input does.

A file of this codec names a program. The program is started only if the user allows it: by the suite that names it, or
by the environment variable `NEUBTF_PERMIT`.
"""

import hashlib
import json
import os
import select
import shlex
import shutil
import subprocess
import tempfile
import time
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from bench.btf import BTF
from bench.btf.npz import write_npz
from bench.codec import Codec, Fit, Parts
from bench.files.atomic import make_folder
from bench.inputs.errors import CodecError, ContainerError, InputError
from bench.inputs.settings import Positive
from bench.material import DecoderCost, Material

PERMIT = "NEUBTF_PERMIT"  # decode programs that may be started, one a line
NAMES = "names"
SIZE = "size"
BATCH = 1 << 16  # queries a line
MESSAGE_LENGTH = 400  # characters of a program's output in an error
LINE = 4_096  # the most bytes of a program's line that are read at once


class Programs(Codec):
    """Two programs of any kind: one that encodes, one that answers queries."""

    name, version = "command", 1

    @dataclass(frozen=True)
    class Settings:
        called: str = "command"  # the name of its rows, one word
        encode: str = ""  # the program that encodes, with {btf} and {files}, and optionally {seed} and {threads}
        decode: str = ""  # the program that answers, with {files}
        seconds: Positive = 3600.0  # the longest that it may take to encode, or for an answer

        def __post_init__(self) -> None:
            """`InputError` if the name is not one word, or a program is no command line of one line."""
            # Tables take the first word of a label for the codec, and this name begins the label.
            if self.called.split() != [self.called]:
                raise InputError(
                    f"setting called of codec command must be one word without blanks, the name of its rows; "
                    f"{self.called!r} is none: write one such as 'my-codec'"
                )
            for name in ("encode", "decode"):
                line = getattr(self, name)
                if "\n" in line:
                    raise InputError(f"setting {name} of codec command must be one line: write it without line breaks")
                try:
                    shlex.split(line)
                except ValueError as error:
                    raise InputError(f"setting {name} of codec command is no command line: {error}") from error

    @property
    def digest(self) -> str:
        """A hash of the programs and of every file that their command lines name: their files depend on these."""
        digest = hashlib.sha256()
        # Words of a command line may be names of files, or of programs that the system finds; others count by name.
        for word in shlex.split(f"{self.settings.encode} {self.settings.decode}"):
            digest.update(word.encode() + b"\0")
            program = shutil.which(word)  # None if the word names no program
            place = Path(word) if program is None else Path(program)
            with suppress(OSError, ValueError):  # a word that can be no name, such as a whole script, is no file
                if place.is_file():
                    digest.update(place.read_bytes())
        return digest.hexdigest()

    def encode(self, btf: BTF, fit: Fit) -> Parts:
        """Run the program that encodes, and store the files that it wrote.

        `InputError` if a command line lacks a placeholder; `CodecError` says how the program failed.
        """
        self._require_placeholders("encode", "{btf}", "{files}")
        self._require_placeholders("decode", "{files}")
        with tempfile.TemporaryDirectory(prefix="neubtf-command-") as scratch:
            btf_file = Path(scratch) / "training.npz"
            files = Path(scratch) / "files"
            make_folder(files)
            write_npz(btf, btf_file)
            # 31 bits of the seed, because many programs keep a seed in a signed int32.
            values = {"btf": btf_file, "files": files, "seed": fit.seed % 2**31, "threads": fit.threads}
            self._run(_words(self.settings.encode, values))
            return _parts_of_folder(files, btf.shape, self.settings.encode)

    def _require_placeholders(self, setting: str, *needed: str) -> None:
        """Raise `InputError` if the command line of a setting lacks one of the needed placeholders."""
        command = getattr(self.settings, setting)
        absent = [word for word in needed if word not in command]
        if absent:
            raise InputError(
                f"setting {setting} of codec command must be a program's command line with {' and '.join(needed)}; "
                f"{command!r} has no {absent[0]}"
            )

    def _run(self, words: list[str]) -> None:
        """Run a command line to its end. `CodecError` if it fails, or takes longer than the setting `seconds`."""
        try:
            subprocess.run(words, check=True, capture_output=True, timeout=self.settings.seconds)
        except subprocess.CalledProcessError as error:
            message = _end_of_output(error.stderr.decode(errors="replace"))
            raise CodecError(f"{words[0]}: ended with code {error.returncode}: {message}") from error
        except subprocess.TimeoutExpired as error:
            limit = f"seconds = {self.settings.seconds:g}"
            raise CodecError(f"{words[0]}: took longer than {limit}: raise that setting") from error
        except OSError as error:
            raise CodecError(f"{words[0]}: cannot be started ({error.strerror}): check its path") from error

    def decode(self, parts: Parts, device: torch.device) -> Material:
        """A material that asks the program. `ContainerError` if it is not permitted, or a file is named as a path."""
        if self.settings.decode not in permitted_programs():
            raise ContainerError(
                f"to decode this file, the program `{self.settings.decode}` would be started: if you trust it, set "
                f"{PERMIT} to that command line"
            )
        names = json.loads(parts.other[NAMES].numpy().tobytes())
        if any(Path(name).name != name for name in names):  # they could lead out of the program's folder
            raise ContainerError("it holds files whose names are paths: encode it again")
        height, width = map(int, parts.other[SIZE])
        contents = {}  # the bytes of each file by name; its tensor is named by its number: see `_parts_of_folder`
        for number, name in enumerate(names):
            contents[name] = parts.texture[f"{number:04d}"].numpy().tobytes()
        return ProgramMaterial((height, width), contents, self.settings.decode, self.settings.seconds)


def permit_program(command: str) -> None:
    """Allow this process, and those that it starts, to start a decode program, given its command line.

    Adds it to the environment variable `PERMIT`.
    """
    os.environ[PERMIT] = "\n".join(dict.fromkeys([*permitted_programs(), command]))


def permitted_programs() -> list[str]:
    """The command lines of the decode programs that may be started."""
    return [line for line in os.environ.get(PERMIT, "").split("\n") if line]


def _end_of_output(text: str) -> str:
    """The end of what a program printed, for a message: that is where it says what is wrong."""
    return text.strip()[-MESSAGE_LENGTH:] or "no message"


def _words(command: str, values: dict[str, object]) -> list[str]:
    """The words of a command line, in which `{name}` is replaced by the value of that name.

    The line is split first, so a value with spaces, such as a path, stays one word.
    """
    words = shlex.split(command)
    for name, value in values.items():
        words = [word.replace(f"{{{name}}}", str(value)) for word in words]
    return words


def _parts_of_folder(folder: Path, size: tuple[int, int], command: str) -> Parts:
    """The files of a folder as parts: the bytes of each as one tensor (bytes,) uint8 of `texture`.

    A tensor is named by the number of its file in the order of the files' names; `other` lists these names as JSON,
    and holds the `size` (H, W) of the texture. `CodecError`, which names the `command`, if there is no file, or one
    that is not plain.
    """
    files = sorted(folder.iterdir())
    if not files:
        raise CodecError(f"{command}: it wrote no file into {{files}}: write what is to be stored there")
    for file in files:
        if file.is_symlink() or not file.is_file():
            raise CodecError(f"{command}: {file.name} in {{files}} is not a regular file: write plain files there")
    texture = {}
    for number, file in enumerate(files):
        texture[f"{number:04d}"] = torch.from_numpy(np.fromfile(file, np.uint8))
    names = json.dumps([file.name for file in files]).encode()
    other = {NAMES: torch.frombuffer(bytearray(names), dtype=torch.uint8), SIZE: torch.tensor(size)}
    return Parts(texture=texture, other=other)


class ProgramMaterial(Material):
    """Asks a running program. Neither its parameters nor its time can be measured from outside."""

    opaque = True

    def __init__(self, size: tuple[int, int], contents: dict[str, bytes], command: str, seconds: float):
        """Write the contents of a file, by name, into a scratch folder, and start the program, which finds them there.

        `command` is its command line, and `seconds` how long an answer may take. `CodecError` if it cannot be started.
        """
        super().__init__(size, DecoderCost())
        self.chunk = BATCH
        self.command = command
        self.seconds = seconds
        self.batches = 0
        self.queries = 0  # answered so far
        self.waited = 0.0  # seconds spent waiting for answers
        scratch = tempfile.TemporaryDirectory(prefix="neubtf-command-")
        self.folder = Path(scratch.name)
        make_folder(self.folder / "files")
        for name, content in contents.items():
            (self.folder / "files" / name).write_bytes(content)
        words = _words(command, {"files": self.folder / "files"})
        with open(self.folder / "log", "wb") as log:
            try:
                self.process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log)
            except OSError as error:
                raise CodecError(f"{words[0]}: cannot be started ({error.strerror}): check its path") from error
        assert self.process.stdin
        assert self.process.stdout
        self.asks = self.process.stdin  # pipes to the program and from it
        self.answers = self.process.stdout
        # The program ends when nothing refers to this material any more, or when Python ends.
        weakref.finalize(self, _end, self.process, scratch)

    def evaluate(self, uv: Tensor, wo: Tensor, wi: Tensor, footprint: Tensor) -> Tensor:
        """Write the queries to a file, ask the program, and read its answers (n, 3) from another file.

        `CodecError` if it gives none in time, or answers with anything else than (n, 3) finite numbers.
        """
        self.batches += 1
        queries = self.folder / f"queries-{self.batches}.npy"
        answers = self.folder / f"answers-{self.batches}.npy"
        rows = torch.cat([uv, wo, wi, footprint[:, None]], 1).float().cpu().numpy()  # (n, 9)
        np.save(queries, rows)
        start = time.perf_counter()
        self._ask(queries, answers)
        self.waited += time.perf_counter() - start
        self.queries += len(rows)
        values = self._read_answers(answers, len(rows))
        queries.unlink()
        answers.unlink()
        return torch.from_numpy(values).to(uv.device)

    def _read_answers(self, file: Path, count: int) -> np.ndarray:
        """The answers (count, 3) float32 in a file of the program. `CodecError` says what is wrong with them."""
        try:
            with np.errstate(over="ignore"):  # a larger number than float32 holds becomes infinite
                values = np.asarray(np.load(file, allow_pickle=False), np.float32)
        except (OSError, ValueError, TypeError, EOFError) as error:
            remedy = "write a float32 array in the format .npy"
            raise CodecError(f"{self.command}: its answers cannot be read ({error}): {remedy}") from error
        if values.shape != (count, 3):
            remedy = "write one row of linear RGB for each query"
            raise CodecError(f"{self.command}: it answered {values.shape} instead of ({count}, 3): {remedy}")
        if not np.isfinite(values).all():
            raise CodecError(f"{self.command}: it answered numbers that are not finite in float32: guard against them")
        return values

    def _ask(self, queries: Path, answers: Path) -> None:
        """Send the line that names the two files, and wait for the program's line. `CodecError` if none comes."""
        line = b""  # has no end if the program has ended: writing to it breaks the pipe, or it sends nothing more
        with suppress(BrokenPipeError):
            self.asks.write(f"{queries}\t{answers}\n".encode())
            self.asks.flush()
            end = time.perf_counter() + self.seconds
            while b"\n" not in line:  # part by part: a program may hang within its line
                ready, _, _ = select.select([self.answers], [], [], max(0.0, end - time.perf_counter()))
                if not ready:
                    limit = f"seconds = {self.seconds:g}"
                    raise CodecError(f"{self.command}: it gave no answer within {limit}: raise that setting")
                part = os.read(self.answers.fileno(), LINE)
                if not part:  # it has ended
                    break
                line += part
        if b"\n" not in line:
            message = _end_of_output((self.folder / "log").read_text(errors="replace"))
            raise CodecError(f"{self.command}: it ended without an answer: {message}")


def _end(process: "subprocess.Popen[bytes]", scratch: "tempfile.TemporaryDirectory[str]") -> None:
    """Kill a program whose material is gone, and remove its folder."""
    process.kill()
    with suppress(BrokenPipeError), process:
        pass  # closes its pipes, and waits for its end
    scratch.cleanup()
