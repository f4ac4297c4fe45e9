"""Ball arithmetic, sets and linear motions; knows nothing of scenarios."""
