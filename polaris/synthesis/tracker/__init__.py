"""Tracking loop of a sampled feedback law: its states, its uncertain inputs, and the bounds on its rows."""
