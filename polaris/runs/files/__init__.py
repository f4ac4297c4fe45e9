"""Files of run folders: arrays, tables, lists of files that Polaris wrote, atomic replacement."""
