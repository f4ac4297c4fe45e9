"""Data from outside, read within limits: whoever wrote a file can neither exhaust the reader nor crash it.

All raise `OSError` for what is no regular file or is too large, and `ValueError` for what is malformed.
"""

import json
import re
import tomllib
from pathlib import Path
from typing import Any

from reach.numerics.files import LARGEST, read_regular

MOST_DOTS = 50  # most dots in a key of TOML: the parser takes the square of their number; scenarios need two

_TEXTS = re.compile(
    r"#[^\n]*"
    r'|"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}'
    r'|"(?:[^"\\\n]|\\[^\n])*"|\'[^\'\n]*\'',
    re.DOTALL,
)
"""Comments and quoted texts of TOML, whose dots do not count."""


def read_text(path: str | Path, most: int = LARGEST) -> str:
    """Return the text of a file in UTF-8."""
    return read_regular(path, most).decode("utf-8")


def parse_json(text: str | bytes, **hooks: Any) -> Any:
    """Return the data of a JSON text; `hooks` as for `json.loads`."""
    try:
        return json.loads(text, **hooks)
    except RecursionError as error:
        raise ValueError("brackets are nested too deeply") from error


def load_json(path: str | Path, most: int = LARGEST) -> Any:
    """Return the data of a JSON file."""
    return parse_json(read_text(path, most))


def parse_toml(text: str) -> dict[str, Any]:
    """Return the data of a TOML text."""
    if max(part.count(".") for part in re.split(r"[=,{[\n]", _TEXTS.sub("", text))) > MOST_DOTS:
        raise ValueError(f"a key has more than {MOST_DOTS} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("brackets are nested too deeply") from error
