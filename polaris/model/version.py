"""The version, read from the one place that states it: the project file."""

from functools import cache
from importlib import metadata

from reach.numerics.packages import project


def version() -> str:
    """Return the version of this package."""
    return str(project()["version"])


__version__ = version()
_installed = cache(metadata.version)


def versions() -> dict[str, str]:
    """Return the versions of everything a result depends on, by name; numba's where it compiles loops."""
    import platform

    from .compiled import is_enabled

    used = ("numba",) if is_enabled() else ()
    by_name = {"numba": "not used", "polaris": version(), "python": platform.python_version()}
    for name in ("numpy", "scipy", "control", "pulp", "highspy", "matplotlib", *used):
        try:
            by_name[name] = _installed(name)
        except metadata.PackageNotFoundError:  # vendored, or installed without its metadata
            by_name[name] = "unknown"
    return by_name
