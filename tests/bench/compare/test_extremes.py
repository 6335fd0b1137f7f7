"""Two stress tests: an extreme that held must hold, and must be tried."""

import pytest

from bench.cli import main
from bench.records import append


def stress(folder, **verdicts):
    folder.mkdir()
    for extreme, verdict in verdicts.items():
        record = {
            "kind": "stress",
            "subject": "pca",
            "extreme": extreme,
            "verdict": verdict,
            "group": "queries",
            "order": 0,
            "figure": "",
            "detail": "",
        }
        append(folder, record)
    return str(folder)


@pytest.mark.parametrize(
    ("after", "code", "said"),
    [
        ({"dark": "pass", "bright": "pass"}, 0, "2 cells hold, 0 got worse"),
        ({"dark": "pass", "bright": "fail"}, 1, "pca: bright held, and now fail"),
        ({"dark": "pass", "bright": "n/a"}, 1, "pca: bright held, and now n/a"),
        ({"dark": "pass"}, 1, "pca: bright is gone"),
    ],
)
def test_a_cell_that_held_must_hold(after, code, said, tmp_path, capsys):
    base, new = stress(tmp_path / "base", dark="pass", bright="pass"), stress(tmp_path / "new", **after)
    assert main(["compare", base, new]) == code
    assert said in capsys.readouterr().out


def test_what_is_allowed_may_go(tmp_path):
    base, new = stress(tmp_path / "base", dark="pass", bright="pass"), stress(tmp_path / "new", dark="pass")
    assert main(["compare", base, new, "--allow", "pca: bright"]) == 0
