from bench.cache import cache_dir, clear


def test_the_folder_follows_the_environment_and_is_emptied_on_request(tmp_path, monkeypatch):
    monkeypatch.setenv("NEUBTF_CACHE", str(tmp_path / "here"))
    assert cache_dir() == tmp_path / "here"
    (cache_dir() / "scratch").mkdir()
    (cache_dir() / "scratch" / "a.npy").write_bytes(b"12345")
    assert clear() == (1, 5)
    assert list(cache_dir().iterdir()) == []
    monkeypatch.delenv("NEUBTF_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_dir() == tmp_path / "xdg" / "neubtf-bench"
