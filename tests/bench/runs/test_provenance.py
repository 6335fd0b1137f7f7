import subprocess

import pytest

from bench.runs import provenance
from tests.bench.outside import install


@pytest.fixture
def site(tmp_path, monkeypatch):
    """An installed codec of another distribution, `mine` of the module `mymodule`."""
    folder = install(tmp_path / "site", "mypackage", {"mine": "mymodule:Mine"}, {"mymodule": "raise SystemExit(3)\n"})
    monkeypatch.syspath_prepend(str(folder))
    provenance.codec_revision.cache_clear()
    yield folder
    provenance.codec_revision.cache_clear()


def git(folder, *words):
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def test_a_fit_is_stamped_with_the_revision_of_its_codec_s_own_repository(site):
    git(site, "init", "-q")
    git(site, "add", "mymodule.py")
    git(site, "commit", "-q", "-m", "one")
    own = git(site, "rev-parse", "HEAD")[:12]
    assert provenance.revision_and_time("mine")["codec"] == own
    assert provenance.revision_and_time("mine")["git"] == provenance.revision() != own
    assert "codec" not in provenance.revision_and_time("pca"), "it is of the suite's repository"
    assert "codec" not in provenance.revision_and_time("nobody's")
    (site / "mymodule.py").write_text("raise SystemExit(4)\n")
    provenance.codec_revision.cache_clear()
    assert provenance.revision_and_time("mine")["codec"] == f"{own}-dirty"


def test_a_copy_that_no_repository_tracks_has_no_revision(site):
    git(site.parent, "init", "-q")
    (site.parent / "other").write_text("")
    git(site.parent, "add", "other")
    git(site.parent, "commit", "-q", "-m", "one")
    assert "codec" not in provenance.revision_and_time("mine")
