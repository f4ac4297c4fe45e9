"""Files of run folders: arrays, tables, lists of what Polaris wrote, atomic replacement."""
