"""Run folders of the inspection problem."""
