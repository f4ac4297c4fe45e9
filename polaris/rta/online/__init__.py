"""The monitor in flight."""
