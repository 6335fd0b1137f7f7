"""Runs one job in any process: opens its material, fits, writes the file, scores it, and returns a record.

A `Task` is what a worker gets of a job; an *earlier* record is one of an earlier run.

A job has two keys. The *fit key* names everything that the file depends on: see `Job.fit_key`. A job is not fitted
again if a file with its fit key exists, and its header and the facts of its fit, written beside it, agree on key and
hash. The *score key* names everything that the numbers depend on: see `bench.runs.evaluation`. A job is not scored
again if a record has its score key. Files contain no time and no place, so the same job may run twice, even at once.
"""

import errno
import hashlib
import json
import logging
import platform
import re
import traceback
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch

from bench.codec import Codec, Progress, TrainedNetwork, ended_bars, settings_dict, silent
from bench.codecs import container, loading, shared
from bench.codecs.command import Programs
from bench.codecs.encoding import fit_to_file, new_fit
from bench.codecs.registry import codec_entries, codec_in_words, from_outside, make_codec
from bench.codecs.seeds import seed_of
from bench.demand import fitting, require_demand
from bench.files import atomic
from bench.inputs.errors import NO_PLACE, CodecError, ContainerError, InputError, MissingDataError, unwritable
from bench.inputs.plugins import PluginError
from bench.machine.devices import is_gpu
from bench.machine.memory import forget_peak, peak_bytes
from bench.machine.process_state import restored_process_state
from bench.records import Facts, FitKey, Job, Point, fields
from bench.runs import lock
from bench.runs.drawing import sparse_truth
from bench.runs.evaluation import evaluate, score_key, store_drawing
from bench.runs.identity import identity
from bench.runs.provenance import machine, revision_and_time
from bench.runs.suite import Task
from bench.runs.workbench import Opening, Workbench, open_workbench
from bench.training import stored_texture

log = logging.getLogger(__name__)

MOST_WORDS = 180  # characters of a file name; systems allow 255 with the digest and every suffix
STATE, FRESH_STATE = ".state", ".fresh"  # checkpoints of an unfinished fit; `.fresh` is valid within one run only
FACTS = ".fit.json"  # beside a codec file


@dataclass(frozen=True)
class Outcome:
    """A job's record, and what was reused from earlier runs: "" (nothing), "file" or "record"."""

    record: Job
    cached: str = ""
    progress: str = ""  # the progress of the run after it, in words


def work(task: Task, show: Progress = silent) -> Outcome:
    """Run one job. A failure becomes a record with its error; an error that fails every job raises `InputError`.

    So does a material that cannot be opened, if the run has no other.
    """
    if not lock.can_use_folder(task.folder, task.run):  # the worker is on another host, which lacks the folder
        raise lock.error_of_unseen_folder(task.folder, f"the worker on {platform.node()}")
    try:
        opening = Opening(task.run, task.material, task.data, task.metrics, task.demand, scorers=task.scorers)
        with ExitStack() as opened:
            show_in_bars = opened.enter_context(ended_bars(show))  # ends a bar that an error leaves unfinished
            try:
                workbench = opened.enter_context(open_workbench(opening, show_in_bars))
            except MissingDataError:
                raise
            except InputError as error:
                if task.only_material:
                    raise
                return failed_outcome(task, str(error), {"fit_key": {}})  # never matches: the next run tries again
            opened.enter_context(restored_process_state())  # a codec may change the process, which the next job uses

            def show_of_job(label: str, done: int, total: int) -> None:
                """Show the progress of this job under its name."""
                show_in_bars(f"{task.name}: {label}", done, total)

            return Attempt(task, workbench, show_of_job).run()
    except MissingDataError as error:
        return Outcome({**task.base, "status": "unavailable", "error": str(error)})
    except OSError as error:  # while opening the material: the cache has no room, which is not the job's fault
        _raise_where_no_job_can_help(error)
        raise


def failed_outcome(task: Task, error: str, more: Job | None = None) -> Outcome:
    """The outcome of a job that failed, with the text of its error, and `more` fields of its record."""
    failure: Job = {"status": "failed", "error": error}
    return Outcome(task.base | failure | (more or Job()))


def error_with_origin(task: Task, error: str) -> str:
    """An error in words; begins with codec and distribution if they are not of this suite: users see whose it is."""
    name = task.codec.codec
    if not from_outside(name):
        return error
    return f"{codec_in_words(codec_entries()[name])}: {error}"


@dataclass
class Attempt:
    """A task with its material opened."""

    task: Task
    workbench: Workbench
    show: Progress

    @cached_property
    def codec(self) -> Codec:
        """The codec with the job's settings. `InputError` if it cannot be made."""
        return make_codec(self.task.codec.codec, self.task.codec.settings)

    @property
    def seed(self) -> int:
        """The seed of the fit, which differs by material, codec and repetition."""
        return seed_of(self.workbench.btf.name, self.codec.name, self.task.repetition)

    @cached_property
    def network(self) -> TrainedNetwork | None:
        """The network that the codec shares over materials, read from its file beside the codec files; None if it
        shares none. `MissingDataError` if the run has no such file."""
        if self.codec.network is None:
            return None
        if not self.task.network:
            raise shared.missing_network(self.codec.name)
        return shared.find(self.codec.name, self.task.folder / self.task.network)

    @cached_property
    def fit_key(self) -> FitKey:
        """Everything that the file depends on, by name. `InputError` if the codec's network or demand is missing."""
        settings = settings_dict(self.codec)
        key: FitKey = {
            "codec": self.codec.name,
            "version": self.codec.version_of(settings),
            "store": stored_texture.VERSION,
            "settings": settings,
            "training": self.workbench.training.fingerprint,
            "seed": self.seed,
            "device": torch.device(self.task.device).type,
            "threads": self.task.threads,
            "torch": torch.__version__,
        }
        key |= identity(self.codec)  # `code` and `libraries`
        # Absent where a codec has no such thing, so that the keys of all other codecs stay as they were.
        if self.network:
            key["shared"] = self.network.sha256
        if isinstance(self.codec, Programs):
            key["programs"] = self.codec.digest
        require_demand(self.codec, self.workbench.demand)
        if self.codec.scene and self.workbench.demand:
            key["demand"] = self.workbench.demand.fingerprint
            key["uniform"] = self.task.uniform
        return key

    @property
    def file(self) -> str:
        """The codec file's name in the run's folder: words of the job's name, and a digest of the fit key."""
        digest = hashlib.sha256(json.dumps(self.fit_key, sort_keys=True).encode()).hexdigest()
        words = re.sub("[^A-Za-z0-9.=_-]+", "-", self.task.name)[:MOST_WORDS]
        return f"files/{words}-{digest[:12]}{container.SUFFIX}"

    @property
    def checkpoint(self) -> Path:
        """Where an unfinished fit keeps its state, beside the codec file."""
        return (self.task.folder / self.file).with_suffix(FRESH_STATE if self.task.fresh else STATE)

    def store(self, name: str, content: dict[str, Any]) -> str:
        """Store content that is too large for the record in the run's folder; returns the name."""
        return store_content(self.task.folder, name, content)

    def run(self) -> Outcome:
        """Encode, decode and score, or find that this is done. `MissingDataError` if data are missing."""
        try:
            return self._outcome(self.task.earlier or Job())
        except (MissingDataError, KeyboardInterrupt):  # neither says that the job would fail again
            raise
        except BaseException as error:  # errors, even `sys.exit`, are recorded and shown, and decide the exit code
            _raise_where_no_job_can_help(error)
            return self._outcome_of_error(error)

    def _outcome_of_error(self, error: BaseException) -> Outcome:
        """The record of a job that an error ended."""
        more: Job = {"traceback": "".join(traceback.format_exception(error)), "machine": machine()}
        more["fit_key"] = {}  # never matches, so that the next run tries again
        with suppress(InputError):  # a codec that cannot be made has no key
            self.checkpoint.unlink(missing_ok=True)  # before the next try, the code that wrote it may be fixed
            if not isinstance(error, PluginError):  # the key does not cover metrics, which may be mended
                more["fit_key"] = self.fit_key
        if isinstance(error, CodecError | PluginError):  # its message names the codec or the plug-in already
            text = str(error)
        else:
            text = error_with_origin(self.task, f"{type(error).__name__}: {error}")
        return failed_outcome(self.task, text, more)

    def _outcome(self, earlier: Job) -> Outcome:
        """The record of an earlier run if it still holds; else a new one, of an earlier run's file or of a new fit."""
        if earlier.get("status") == "failed" and self._would_fail_again(earlier):
            return Outcome(earlier, "record")
        header, fit_facts = self._file_and_facts()
        key = score_key(self.workbench, header)
        if earlier.get("score_key") == key:  # nothing that its numbers depend on has changed
            if earlier.get("curve") == self.task.codec.curve:
                return Outcome(earlier, "record")
            return Outcome({**earlier, "curve": self.task.codec.curve}, "file")  # the suite sweeps other settings now
        record: Job = {**self.task.base, "fit_key": self.fit_key, "machine": machine()}
        record |= fit_facts
        record |= {"status": "ok", "score_key": key, "file": self.file, "scored": revision_and_time()}
        record |= self._scores_and_drawing(header)
        return Outcome(record, "file" if fit_facts["fit_cached"] else "")

    def _would_fail_again(self, earlier: Job) -> bool:
        """Whether nothing that a failed job depends on has changed since."""
        if "fit_key" not in earlier:  # its workers died, or it took too long: only `--retry-failed` tries it again
            return True
        return earlier["fit_key"] == self.fit_key

    def _scores_and_drawing(self, header: container.Header) -> Job:
        """The fields that scoring the file adds to the record; of the first seed also those of what a page draws."""
        file = loading.load(header.path, self.task.device, self.network)
        scores = evaluate(self.workbench, file, self.task.threads, self.store, self.show)
        if self.task.repetition:  # only the first seed has pictures
            return scores
        # A drawing is recorded on the CPU, whose results are the same on each machine.
        if is_gpu(self.task.device):
            file = loading.load(header.path, "cpu", self.network)
        self._store_truth()
        return scores | store_drawing(file, self.store)

    def _store_truth(self) -> None:
        """Store what a page needs to draw the material's truth live, once a material, if it is small enough."""
        name = f"drawings/truth-{self.workbench.btf.fingerprint[:16]}.npz"
        if (self.task.folder / name).exists():  # another job on this material has stored it
            return
        try:
            program = sparse_truth(self.workbench.btf)
        except Exception as error:  # a drawing for the report must not cost the job
            log.warning("%s: its truth is not drawn: %s", self.workbench.btf.name, error)
            return
        if program is not None:  # None: it is too large for a page
            self.store(name, program.arrays())

    def _file_and_facts(self) -> tuple[container.Header, Job]:
        """The codec file and the facts of its fit: from an earlier run with the same key, else encoded now."""
        path = self.task.folder / self.file
        reusable = None if self.task.fresh or not path.exists() else self._reusable_file(path)
        if reusable is not None:
            return reusable
        header, facts = self._fit(path)
        # The facts come after the file, and a file without its facts is never reused.
        self.store(str(Path(self.file).with_suffix(FACTS)), dict(facts))
        self.checkpoint.unlink(missing_ok=True)
        return header, _facts_of_record(facts, cached=False)

    def _reusable_file(self, path: Path) -> tuple[container.Header, Job] | None:
        """The header of an existing codec file and the facts of its fit; None, with a warning, if it is not from this
        job, which is then fitted again."""
        try:
            header = container.read_header(path)
            facts = json.loads(path.with_suffix(FACTS).read_text("utf-8"))
            fault = fields.fault_of(Facts, facts)
            if fault:
                raise ValueError(f"{path.with_suffix(FACTS)}: {fault}")
            same = facts["fit_key"] == json.loads(json.dumps(self.fit_key))
        except (ContainerError, OSError, ValueError, RecursionError) as error:
            log.warning("%s is fitted again: %s", self.task.name, error)
            return None
        stored = (header.codec, header.version, header.settings, header.sha256)
        wanted = (self.codec.name, self.fit_key["version"], self.fit_key["settings"], facts.get("sha256"))
        if same and stored == wanted:
            return header, _facts_of_record(facts, cached=True)
        log.warning("%s is fitted again: %s is not the file that was fitted for it", self.task.name, path)
        return None

    def _fit(self, path: Path) -> tuple[container.Header, Facts]:
        """Fit the codec and write its file to `path`; returns the file's header and the facts of the fit."""
        task = self.task
        training = self.workbench.training
        atomic.make_folder(path.parent)  # a codec of anyone may save its checkpoint there at once
        fit = new_fit(
            self.codec,
            training,
            task.repetition,
            self.network,
            device=task.device,
            threads=task.threads,
            show=self.show,
            checkpoint=self.checkpoint,
        )
        encode = fitting.encode_of(self.codec, self.workbench.demand, task.uniform)
        counted = forget_peak(fit.device)
        header, seconds = fit_to_file(self.codec, training, fit, path, encode)
        facts: Facts = {
            "fit_key": self.fit_key,
            "sha256": header.sha256,
            "fit_seconds": seconds,
            "history": cast(list[Point], fit.history),
            "faults": fit.faults,
            "fitted": revision_and_time(self.codec.name),
        }
        memory = peak_bytes(fit.device) if counted else None
        if memory is not None:
            facts["fit_memory"] = memory  # bytes; of a resumed fit, the most since it was resumed
        return header, facts


def _facts_of_record(facts: Facts, cached: bool) -> Job:
    """The facts of a fit that the record of its job holds; `cached`: the fit is one of an earlier run.

    They are its seconds, the PSNR over its steps, its faults, when and by which revision it was made, and its memory.
    None is in the codec file, whose bytes must not change from one fit to the next.
    """
    record: Job = {"fit_seconds": facts["fit_seconds"], "history": facts["history"], "fit_cached": cached}
    if facts.get("faults"):
        record["faults"] = facts["faults"]
    record["fitted"] = facts["fitted"]
    if "fit_memory" in facts:
        record["fit_memory"] = facts["fit_memory"]
    return record


def store_content(folder: Path, name: str, content: dict[str, Any]) -> str:
    """Store content that is too large for a record in a run's folder; returns the name.

    The name's ending says how: .json for values of JSON, .npz for arrays by name.
    """
    with atomic.replacing(folder / name) as unfinished:
        if name.endswith(".json"):
            unfinished.write_text(json.dumps(content, allow_nan=False), encoding="utf-8")
        else:
            with open(unfinished, "wb") as file:
                np.savez_compressed(file, **content)
    return name


def _raise_where_no_job_can_help(error: BaseException) -> None:
    """Raise `InputError` if a disk is full or may not be written, or the cache may not be used: each further job would
    fail alike."""
    if not isinstance(error, OSError):
        return
    closed_cache = error.errno in (errno.EACCES, errno.EPERM) and _is_in_cache(error.filename)
    if error.errno in NO_PLACE or closed_cache:
        raise InputError(f"{unwritable(error)}; finished jobs are kept (on {platform.node()})") from error


def _is_in_cache(name: Any) -> bool:
    """Whether the file that an `OSError` names lies in the cache; False if it names none, or a descriptor's number."""
    return isinstance(name, str) and Path(name).is_relative_to(atomic.cache_dir())
