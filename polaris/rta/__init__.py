"""Run-time assurance methods on the scenes of switching schedules: one protocol, one file per method."""
