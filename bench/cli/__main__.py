"""`python -m bench.cli` is `neubtf-bench`."""

import sys

from bench.cli import main

sys.exit(main())
