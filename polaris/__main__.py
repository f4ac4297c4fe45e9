"""``python -m polaris``: the same as the command ``polaris``."""

from .cli import app

app()
