"""Backup laws of the implicit filters."""
