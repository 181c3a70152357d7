"""A result as a value in memory and as a folder: numbers, traits and files."""
