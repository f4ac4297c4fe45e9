"""Hook of MkDocs: leave the TeX of formulas out of what the search shows."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

FORMULA = re.compile(r"\\\(.*?\\\)|\\\[.*?\\\]", re.S)
"""A formula as `pymdownx.arithmatex` hands it to MathJax."""


def on_post_build(config: Mapping[str, Any]) -> None:
    """Replace every formula in the search index of the built pages by an ellipsis."""
    path = Path(config["site_dir"]) / "search" / "search_index.json"
    index = json.loads(path.read_text(encoding="utf-8"))
    for entry in index["docs"]:
        entry["text"] = FORMULA.sub("…", entry["text"])
    path.write_text(json.dumps(index, ensure_ascii=False), encoding="utf-8")
