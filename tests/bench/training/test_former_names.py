"""The former names of parts of `bench.training` work for one version, and say where they went."""

import importlib

import pytest

from bench import training


@pytest.mark.parametrize(("module", "name"), [("decoder", "Decoder"), ("quantise", "pack")])
def test_a_former_name_warns_and_gives_the_same(module, name):
    with pytest.warns(DeprecationWarning, match=f"bench.{module} is bench.training now: import {name} from there"):
        assert getattr(importlib.import_module(f"bench.{module}"), name) is getattr(training, name)
