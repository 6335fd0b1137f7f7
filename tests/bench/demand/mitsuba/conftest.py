import pytest

from bench.program import llvm


@pytest.fixture(scope="module")
def plugin():
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    from bench.demand.mitsuba.bsdf import register

    register()
