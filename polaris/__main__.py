"""``python -m polaris``: the same as the command ``polaris``."""

from .cli.app import app

app()
