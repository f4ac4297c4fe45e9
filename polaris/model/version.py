"""The version, read from the one place that states it: the project file."""

from functools import cache
from importlib import metadata
from pathlib import Path

DISTRIBUTION = "polaris-rta"


@cache
def version() -> str:
    """Version of this package: a checkout's project file, else what was installed."""
    project = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if project.is_file():
        import tomllib

        declared = tomllib.loads(project.read_text(encoding="utf-8")).get("project", {})
        if declared.get("name") == DISTRIBUTION:
            return str(declared["version"])
    return metadata.version(DISTRIBUTION)


__version__ = version()
_installed = cache(metadata.version)


def versions() -> dict[str, str]:
    """Versions of everything a result depends on, by name; numba's where it compiles loops."""
    import platform

    from .compiled import wanted

    used = ("numba",) if wanted() else ()
    found = {"numba": "not used", "polaris": version(), "python": platform.python_version()}
    for name in ("numpy", "scipy", "control", "pulp", "highspy", "matplotlib", *used):
        try:
            found[name] = _installed(name)
        except metadata.PackageNotFoundError:  # vendored, or installed without its metadata
            found[name] = "unknown"
    return found
