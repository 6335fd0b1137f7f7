"""One cell of a suite as a worker gets it: plain data."""

from dataclasses import dataclass
from pathlib import Path

from bench.data.spec import MaterialSpec, Preparation
from bench.demand import UNIFORM
from bench.metrics import DEFAULTS
from bench.records import Record
from bench.runs.suite import CodecSpec


@dataclass(frozen=True)
class Task:
    """Everything that a worker needs to know of one cell of a suite."""

    run: str
    folder: Path  # of the run
    material: MaterialSpec
    data: Preparation
    codec: CodecSpec
    repetition: int
    threads: int
    demand: str = ""  # path of the demand to score with
    uniform: float = UNIFORM
    metrics: tuple[str, ...] = DEFAULTS  # as the suite names them
    device: str = "cpu"
    scorers: int | None = None  # threads that score; None: one a core
    fresh: bool = False
    earlier: Record | None = None  # the job's latest record, if it may still hold
    network: str = ""  # the file, in the run's folder, of the network that the codec shares over materials
    losses: int = 0  # workers that died while they ran this job

    @property
    def name(self) -> str:
        return f"{self.material.name}/{self.codec.label}/{self.repetition}"

    @property
    def base(self) -> Record:
        """The fields with which each record of this job begins."""
        row = {"kind": "job", "job": self.name, "run": self.run, "material": self.material.name}
        row |= {"codec": self.codec.codec, "label": self.codec.label, "curve": self.codec.curve}
        return row | {"seed": self.repetition, "split": self.data.split}
