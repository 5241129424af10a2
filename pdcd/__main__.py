"""`python -m pdcd` is `pdcd`."""

import sys

from pdcd.cli.main import main

sys.exit(main())
