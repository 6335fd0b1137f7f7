"""What tests of the plug-in for Mitsuba share."""

import pytest

from bench.program import llvm


@pytest.fixture(scope="module")
def plugin():
    """The plug-in, known to Mitsuba's variant that runs it; without an LLVM that compiles it the test is skipped."""
    if reason := llvm.unusable(plugins=True):
        pytest.skip(reason)
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    from bench.demand.mitsuba.bsdf import register

    register()
