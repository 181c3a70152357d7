"""A result as one page that a person would send to a colleague: everything inside the file, nothing from a network."""
