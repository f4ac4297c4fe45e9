"""Run folders of missions, and attacks on them."""
