"""Tables of scenario files: one class per table, one field per key, units in the names."""
