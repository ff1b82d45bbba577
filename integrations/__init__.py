"""For clients that are not Tutti's own: a package for each protocol or framework, each with its extra.

They import `tutti` and the library of their protocol, and nothing else: what they do with a fleet, any program can do.
"""
