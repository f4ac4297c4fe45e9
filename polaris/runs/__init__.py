"""Run folders of every kind: running a scenario into one, what each holds, reading it back."""
