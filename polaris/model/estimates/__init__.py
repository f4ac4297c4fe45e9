"""Bounds on errors of estimates: an observer's, and of predictions from them."""
