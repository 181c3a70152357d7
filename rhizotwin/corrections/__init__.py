"""A person's corrections of a result.

What was done, kept as a log beside it, and what shape, volume and traits become by it.
"""
