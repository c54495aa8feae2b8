"""Nouns: the frozen records that stages hand to each other."""
