"""Sequences of microscopes (useq-schema) as jobs: `tutti job from-useq`."""
