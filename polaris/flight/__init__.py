"""Flight code of a proven run: S, the schedule and the reference on board."""
