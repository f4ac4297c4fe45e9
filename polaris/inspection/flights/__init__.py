"""Flights under a filter, and their judge."""
