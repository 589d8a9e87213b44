"""``python -m ldctoolkit``: the command ``ldc``."""

import importlib
import sys

if __name__ == "__main__":
    sys.exit(importlib.import_module("ldctoolkit.studies.cli").main())
