"""The settings of Matplotlib under which every picture of the suite is drawn."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def default_settings() -> Iterator[None]:
    """Within it, or within a function that it decorates, Matplotlib has its own defaults.

    A user's matplotlibrc may ask for LaTeX, which may be missing, or for other fonts and sizes.
    """
    import matplotlib  # here, since it is slow, and most of what may draw does not

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        yield
