"""Scripts and styles that stand in a page: those of this package, and plotly.js."""

import re
from functools import cache
from importlib.resources import files

SCRIPTS = ("tables.js", "theme.js", "scene.js", "names.js", "timelines.js", "main.js")


def own_script() -> str:
    """Return the scripts of this package as one, with no names left in the page."""
    joined = "\n".join(resource(name) for name in SCRIPTS)
    return f'(function () {{\n"use strict";\n{joined}}})();'


def resource(name: str) -> str:
    """Return the text of a file that comes along with this package."""
    return (files(__package__) / "static" / name).read_text(encoding="utf-8")


@cache
def plotly() -> str:
    """Return plotly.js, safe inside ``<script>``."""
    from plotly.offline import get_plotlyjs

    # HTML ends a script at these letters wherever they stand, in a string of the script too.
    return re.sub(r"</(script)", r"<\\/\1", get_plotlyjs(), flags=re.IGNORECASE)
