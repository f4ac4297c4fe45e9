"""One file per run-time method: a module in this folder is found and its methods are registered by itself."""

from importlib import import_module
from pkgutil import iter_modules

from ..method import METHODS

__all__ = ["METHODS"]

for _found in iter_modules(__path__):
    import_module(f"{__name__}.{_found.name}")
