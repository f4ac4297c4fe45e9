"""Scenario files: tables, reading, overrides, rules, builders."""
