"""The records of a run: their fields (`schema`), the meaning of fields (`meaning`), and their storage (`lines`).

Imports neither PyTorch nor pandas.
"""

from bench.records.fields import field_names, kept, require, shown_columns
from bench.records.lines import FILE, STRESS, TRADE, Records, Run, append, load_run, load_together, load_trade, view
from bench.records.meaning import (
    CONDITIONS,
    FLIP,
    MOST_DB,
    OUTSIDE,
    PSNR,
    RMSE,
    SCENE_HELDOUT,
    SSIM,
    VALIDATION,
    by_kind,
    by_row,
    deciding_group,
    fitted_to_scene,
    flattened,
    grouped,
    kind_of,
    kind_order,
    metrics_of,
    pictures_are_free,
    scored_unlike,
    shown_label,
)
from bench.records.schema import (
    ARTEFACT,
    CLAIM,
    NAMES,
    REFERENCE,
    RESULTS,
    Bytes,
    Ceiling,
    Facts,
    FitKey,
    Group,
    Job,
    Machine,
    MetricFacts,
    Point,
    Profile,
    Provenance,
    Record,
    RunStart,
    Scene,
    SceneModel,
    ScoreKey,
    Statistics,
    Stress,
    Timing,
    Trade,
    TradeChoice,
)
