"""Files of a run folder, read without trust and compared with each other."""
