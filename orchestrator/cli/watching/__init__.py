"""The screen of `tutti watch`."""
