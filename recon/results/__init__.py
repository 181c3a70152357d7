"""A result as a folder: numbers, traits, files, its pictures (beside the truth where there is one) and the page for people."""
