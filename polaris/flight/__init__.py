"""Flight code of a proven run: what S, the schedule and the reference become on board."""
