"""A result as a folder: numbers, traits, files, its pictures, and the page for people.

The pictures show the truth beside it where there is one.
"""
