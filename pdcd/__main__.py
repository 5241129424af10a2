"""`python -m pdcd` is `pdcd`."""

import sys

from pdcd.cli import main

sys.exit(main())
