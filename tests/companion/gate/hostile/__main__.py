"""Start of `python -m tests.companion.gate.hostile`."""

import sys

from tests.companion.gate.hostile.campaign import main

sys.exit(main())
