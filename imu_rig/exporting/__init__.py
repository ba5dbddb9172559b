"""Trials as files of other programs; what each holds and loses is in docs/export-trials.md."""
