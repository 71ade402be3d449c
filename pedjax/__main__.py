"""`python -m pedjax`."""

import sys

from pedjax.cli import main

sys.exit(main())
