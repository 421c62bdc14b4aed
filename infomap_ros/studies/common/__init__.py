"""What studies have in common: runs that go on, bands, the look of figures, the command line."""
