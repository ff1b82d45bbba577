"""Texts as people and other programs write them."""
