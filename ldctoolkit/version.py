"""The installed version, read from the package's metadata so that it stands in one place."""

import importlib.metadata

__version__ = importlib.metadata.version("ldctoolkit")
